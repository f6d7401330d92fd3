"""The stages: one file a node, and the table that names them.

A stage is a declaration (`dag.stage.Stage`): what it reads, its parameters, how its blocks map, and the names of
the functions in `kernels/` that compute. It imports nothing that computes. Adding one is adding a file, a line
here, and its name in `pipeline.yaml`. The rig's own nodes lie in `calibration/`.
"""

from collections.abc import Mapping

from lightstage.stages.calibration import MEASURED, STEPS

TABLE: Mapping[str, str] = {
    "capture": "lightstage.stages.capture",
    "register": "lightstage.stages.register",
    "split": "lightstage.stages.split",
    "stack": "lightstage.stages.stack",
    "align": "lightstage.stages.align",
    "normals": "lightstage.stages.normals",
    "upsample": "lightstage.stages.upsample",
    "reflectance": "lightstage.stages.reflectance",
    "shape": "lightstage.stages.shape",
    "stimulus": "lightstage.stages.stimulus",
    "chromophores": "lightstage.stages.chromophores",
    "gloss": "lightstage.stages.gloss",
    **{name: f"lightstage.stages.calibration.{name}" for name in (*STEPS, *MEASURED)},
}

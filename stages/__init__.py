"""The stages: one file each, and the table that names them.

A stage is a pure kernel on numpy arrays plus what it reads and its parameters (`dag.stage.Stage`). Adding one
is adding a file, a line here, and its name in `pipeline.yaml`. Modules that are not in the table are kernels
that a stage calls; they count in its key.

    spherical_gradients.py   fused per-pixel kernels of the gradient methods
    one_light.py             photometric stereo from one light at a time
    band_fusion.py           one picture from all bands, weighted by noise
    resampling.py            dark, flat, and one cubic resampling
"""

from collections.abc import Mapping

TABLE: Mapping[str, str] = {
    "capture": "stages.capture",
    "register": "stages.register",
    "split": "stages.split",
    "stack": "stages.stack",
    "normals": "stages.normals",
}

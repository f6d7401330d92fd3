"""camera: intrinsics of the reference camera from pictures of a checkerboard.

Where the camera stands to the stage a board does not tell: the pose of the camera item that is bound is kept, or
the nominal one is written (straight before the stage, `distance_mm` away).

Must have run before: corners. Source: Zhang (2000), and those of `kernels/targets/camera_matrix.py`.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import Field

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Name, Needs, Output, Params, Stage
from lightstage.kernels.targets.labels import CAMERA_PARAMETERS
from lightstage.stages.calibration.session import need_target, reference, reference_camera, upright_shape


class CameraParams(Params):
    """Parameters of `camera`."""

    distance_mm: float = Field(890.0, gt=0, description="nominal way from the camera to the stage's centre")


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: CameraParams) -> Arrangement:
    (corners,) = grids
    need_target(facts, "checkerboard", "measuring the camera")
    which = reference(corners)
    frames = corners.sizes["frame"]
    sizes = {
        "all": 1, "picture": frames, "line": 3, "entry": 3, "coefficient": 5, "parameter": len(CAMERA_PARAMETERS),
        "row": corners.sizes["row"], "column": corners.sizes["column"], "xy": 2,
    }  # fmt: skip
    rows, columns = upright_shape(facts, reference_camera(facts))
    labels = {"parameter": (("parameter",), list(CAMERA_PARAMETERS))}
    boards: dict[Name, dict[str, int]] = {i: {"frame": i, "polarisation": which} for i in range(frames)}
    return Arrangement(Grid(sizes, labels, {"size_px": [columns, rows]}), (Group({"points": boards}),))


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: CameraParams
) -> Mapping[str, Any]:
    return {
        "square_mm": facts["target"]["square_mm"],
        "size": list(upright_shape(facts, reference_camera(facts))),
        "homography": items["homography"]["matrix"] if "homography" in items else None,
    }


STAGE = Stage(
    name="camera",
    version=1,
    summary="the reference camera from checkerboards",
    params=CameraParams,
    inputs={"points": Input("points", ("frame", "polarisation", "row", "column", "xy"), "group")},
    calibration={"homography": Needs(why="nothing is said of the other camera")},
    outputs={
        "matrix": Output(("all", "line", "entry"), "float64", ("line", "entry"), {"units": "pixel"}),
        "distortion": Output(("all", "coefficient"), "float64", ("coefficient",)),
        "deviation": Output(("all", "parameter"), "float64", ("parameter",)),
        "held": Output(("all", "parameter"), "bool", ("parameter",)),
        "points": Output(
            ("all", "picture", "row", "column", "xy"),
            "float64",
            ("picture", "row", "column", "xy"),
            {"units": "pixel"},
        ),
        "residual": Output(
            ("all", "picture", "row", "column", "xy"),
            "float64",
            ("picture", "row", "column", "xy"),
            {"units": "pixel"},
        ),
        "rms_px": Output(("all",), "float64", (), {"units": "pixel"}),
        "other_matrix": Output(("all", "line", "entry"), "float64", ("line", "entry"), {"units": "pixel"}),
    },
    blocks=("all",),
    arrange=_arrange,
    context=_context,
    prepared=("square_mm", "size", "homography"),
    kernel="lightstage.kernels.targets.camera:camera",
    item="lightstage.kernels.targets.camera:item",
    verdict="lightstage.kernels.targets.camera:verdict",
)

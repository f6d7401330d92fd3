"""homography: where a point of one camera's picture lies in the other's, from checkerboards.

Must have run before: corners. Sources: Hartley & Zisserman (2004), and those of
`kernels/targets/homography_fit.py`, `mount_check.py` and `residual_field.py`.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from pydantic import Field

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Name, Output, Params, Stage, StageError
from lightstage.stages.calibration.session import mount_of, need_target, upright_shape

_CAMERAS = ("parallel", "cross")


class HomographyParams(Params):
    """Parameters of `homography`."""

    method: Literal["sampson", "geometric"] = Field(
        "sampson", description="the error that is minimised; both end alike, Sampson's is cheaper"
    )


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: HomographyParams) -> Arrangement:
    (corners,) = grids
    need_target(facts, "checkerboard", "measuring the homography")
    cameras = tuple(corners.along("polarisation"))
    if cameras != _CAMERAS:
        raise StageError(
            f"measuring the homography needs boards seen by the parallel and the cross camera; this capture has "
            f"{', '.join(cameras)}"
        )
    frames = corners.sizes["frame"]
    boards: dict[Name, dict[str, int]] = {
        (camera, i): {"frame": i, "polarisation": p} for p, camera in enumerate(cameras) for i in range(frames)
    }
    count = frames * corners.sizes["row"] * corners.sizes["column"]
    sizes = {"all": 1, "line": 3, "entry": 3, "corner": count, "xy": 2, "flag": 2}
    return Arrangement(Grid(sizes, {}), (Group(dict.fromkeys(("points", "covariance", "first_is_black"), boards)),))


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: HomographyParams
) -> Mapping[str, Any]:
    camera = facts["cameras"]["parallel"]
    return {"size": list(upright_shape(facts, camera)), "mount": mount_of(facts, camera), "camera": camera}


STAGE = Stage(
    name="homography",
    version=1,
    summary="one camera's picture in the other's",
    params=HomographyParams,
    inputs={
        "points": Input("points", ("frame", "polarisation", "row", "column", "xy"), "group"),
        "covariance": Input("covariance", ("frame", "polarisation", "row", "column", "value"), "group"),
        "first_is_black": Input("first_is_black", ("frame", "polarisation"), "group"),
    },
    outputs={
        "matrix": Output(("all", "line", "entry"), "float64", ("line", "entry")),
        "points": Output(("all", "corner", "xy"), "float64", ("corner", "xy"), {"units": "pixel"}),
        "residual": Output(("all", "corner", "xy"), "float64", ("corner", "xy"), {"units": "pixel"}),
        "smooth": Output(("all", "corner", "xy"), "float64", ("corner", "xy"), {"units": "pixel"}),
        "board": Output(("all", "corner"), "int64", ("corner",)),
        **{
            name: Output(("all",), "float64", (), {"units": "pixel"})
            for name in (
                "rms_px",
                "sampson_px",
                "geometric_px",
                "expected_px",
                "smooth_px",
                "parallax_px",
                "noise_px",
                "mount_doubt",
            )
        },
        "flags": Output(("all", "flag"), "bool", ("flag",), {"meanings": "distorted parallax"}),
    },
    blocks=("all",),
    arrange=_arrange,
    context=_context,
    prepared=("size", "mount", "camera"),
    kernel="lightstage.kernels.targets.homography:homography",
    item="lightstage.kernels.targets.homography:item",
    verdict="lightstage.kernels.targets.homography:verdict",
)

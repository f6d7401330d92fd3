"""corners: the inner corners of a checkerboard, a picture at a time.

Corners are told in pixels of the picture with its mount undone, in an order that does not mirror the board.

Must have run before: capture. Source: those of `kernels/targets/board_corners.py` (finding) and `corner_fit.py`
(measuring).
"""

from collections.abc import Mapping, Sequence
from typing import Any

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Output, Params, Stage
from lightstage.stages.calibration.session import mount_of, need_target


class CornersParams(Params):
    """`corners` has no parameters."""


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: CornersParams) -> Arrangement:
    (raw,) = grids
    target = need_target(facts, "checkerboard", "measuring corners")
    columns, rows = target["inner_corners"]
    frames, cameras = raw.sizes["frame"], raw.sizes["polarisation"]
    groups = tuple(
        Group({"raw": {nm: {"frame": i, "band": b, "polarisation": p} for b, nm in enumerate(raw.along("band"))}})
        for i in range(frames)
        for p in range(cameras)
    )
    sizes = {"frame": frames, "polarisation": cameras, "row": rows, "column": columns, "xy": 2, "value": 4}
    labels = {name: raw.labels[name] for name in ("illumination", "polarisation")}
    return Arrangement(Grid(sizes, labels), groups)


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: CornersParams
) -> Mapping[str, Any]:
    camera = facts["cameras"][labels["polarisation"]]
    mount = mount_of(facts, camera)
    return {
        "inner_corners": facts["target"]["inner_corners"],
        "white_level": facts["white_level"],
        "camera": camera,
        "rotate": mount["rotate"],
        "mirror": mount["mirror"],
    }


STAGE = Stage(
    name="corners",
    version=1,
    summary="the inner corners of a checkerboard",
    params=CornersParams,
    inputs={"raw": Input("raw", ("frame", "band", "polarisation", "y", "x"), "group")},
    outputs={
        "points": Output(
            ("frame", "polarisation", "row", "column", "xy"), "float64", ("row", "column", "xy"), {"units": "pixel"}
        ),
        "covariance": Output(
            ("frame", "polarisation", "row", "column", "value"),
            "float64",
            ("row", "column", "value"),
            {"units": "pixel2"},
        ),
        "blur_px": Output(
            ("frame", "polarisation", "row", "column"), "float64", ("row", "column"), {"units": "pixel"}
        ),
        "first_is_black": Output(("frame", "polarisation"), "bool", ()),
    },
    blocks=("frame", "polarisation"),
    arrange=_arrange,
    context=_context,
    prepared=("inner_corners", "white_level", "camera", "rotate", "mirror"),
    kernel="lightstage.kernels.targets.corners:corners",
)

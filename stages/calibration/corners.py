"""corners: the inner corners of a checkerboard, a picture at a time.

The kernel is in `board_corners.py` (finding) and `corner_fit.py` (measuring). Corners are told in pixels of the
picture with its mount undone, in an order that does not mirror the board.

Must have run before: capture. Source: those of the two modules.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Output, Params, Stage
from lightstage.kernels.targets.board_corners import find_corners, undo_mount
from lightstage.stages.calibration.session import need_target


class CornersParams(Params):
    """`corners` has no parameters."""


def corners(
    raw: Sequence[NDArray[np.uint16]],
    *,
    inner_corners: Sequence[int],
    white_level: int,
    camera: str,
    rotate: int,
    mirror: bool,
) -> Mapping[str, NDArray[Any]]:
    """Corners of one board.

    Args:
        raw: the picture's bands, (y, x) counts, sensor orientation; their mean is measured.
        inner_corners: (columns, rows).
        white_level: the count at which the sensor saturates.
        camera: its name, for errors.
        rotate, mirror: the mount, to be undone.

    Returns:
        `points` (row, column, xy) pixels, `covariance` (row, column, 2, 2) as (row, column, value), `blur_px`
        (row, column), `first_is_black` ().

    Raises:
        StageError: no board, one that is cut or covered, or another one.
    """
    picture = raw[0] if len(raw) == 1 else np.mean([np.asarray(r, np.float64) for r in raw], axis=0)
    found = find_corners(
        undo_mount(picture, rotate=rotate, mirror=mirror),
        inner_corners=(inner_corners[0], inner_corners[1]),
        white_level=white_level,
        camera=camera,
    )
    return {
        "points": found.points,
        "covariance": found.covariance.reshape(*found.covariance.shape[:2], 4),
        "blur_px": found.blur_px,
        "first_is_black": np.array(found.first_is_black),
    }


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: CornersParams) -> Arrangement:
    (raw,) = grids
    target = need_target(facts, "checkerboard", "measuring corners")
    columns, rows = target["inner_corners"]
    frames, cameras = raw.sizes["frame"], raw.sizes["polarisation"]
    groups = tuple(
        Group({"raw": [{"frame": i, "band": b, "polarisation": p} for b in range(raw.sizes["band"])]})
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
    mount = facts["mount"].get(camera, {"rotate": 0, "mirror": False})
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
    kernel=corners,
)

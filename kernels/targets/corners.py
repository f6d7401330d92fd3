"""A checkerboard's inner corners in one picture: the kernel of `stages/calibration/corners.py`.

Finding is in `board_corners.py`, measuring in `corner_fit.py`.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.targets.board_corners import find_corners, undo_mount


def corners(
    raw: Mapping[float, NDArray[np.uint16]],
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
        KernelError: no board, one that is cut or covered, or another one.
    """
    bands = list(raw.values())
    picture = bands[0] if len(bands) == 1 else np.mean([np.asarray(band, np.float64) for band in bands], axis=0)
    board = find_corners(
        undo_mount(picture, rotate=rotate, mirror=mirror),
        inner_corners=(inner_corners[0], inner_corners[1]),
        white_level=white_level,
        camera=camera,
    )
    return {
        "points": board.points,
        "covariance": board.covariance.reshape(*board.covariance.shape[:2], 4),
        "blur_px": board.blur_px,
        "first_is_black": np.array(board.first_is_black),
    }

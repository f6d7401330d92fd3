"""How far a camera has moved between two calibrations, by their homographies."""

from collections.abc import Sequence

import numpy as np

_COLUMNS, _ROWS = 9, 7
"""Points that stand for all pixels: a homography's image of a picture is smooth."""


def shift_px(before: Sequence[Sequence[float]], now: Sequence[Sequence[float]], shape: tuple[int, int]) -> float:
    """Mean distance between two homographies' images of a picture, px.

    Args:
        before, now: (3, 3), pixels (x, y, 1) to pixels.
        shape: rows and columns of the picture.
    """
    a, b = np.asarray(before), np.asarray(now)
    x, y = np.meshgrid(np.linspace(0, shape[1] - 1, _COLUMNS), np.linspace(0, shape[0] - 1, _ROWS))
    points = np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    p, q = a @ points, b @ points
    return float(np.linalg.norm(p[:2] / p[2] - q[:2] / q[2], axis=0).mean())

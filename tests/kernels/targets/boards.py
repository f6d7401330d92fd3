"""Corners of a checkerboard in space, as a pinhole camera shows them."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
SQUARE_MM, ROWS, COLUMNS = 10.0, 5, 8
K = np.array([[1000.0, 0.0, 205.0], [0.0, 1000.0, 152.0], [0.0, 0.0, 1.0]])
SIZE = (309, 406)
POSES = (([25.0, 5.0, 0.0], -4.0), ([-20.0, 22.0, 5.0], 3.0), ([5.0, -28.0, -8.0], 6.0), ([-24.0, -18.0, 3.0], 0.0))
"""Tilt in degrees, and shift in mm."""


def seen(tilt_deg: list[float], shift_mm: float) -> Array:
    """(row, column, xy), pixels."""
    y, x = np.mgrid[0:ROWS, 0:COLUMNS].astype(float)
    flat = SQUARE_MM * np.stack([x - (COLUMNS - 1) / 2, y - (ROWS - 1) / 2, np.zeros_like(x)], axis=-1)
    turn = Rotation.from_euler("xyz", tilt_deg, degrees=True).as_matrix()
    point = flat @ turn.T + [shift_mm, -shift_mm, 400.0]
    image = point @ K.T
    return np.asarray(image[..., :2] / image[..., 2:])

"""A checkerboard seen through a homography, drawn by the colour that every sub-pixel's place has on it."""

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FINE = 8
"""Sub-pixels a side."""


def board(
    matrix: Array, inner: tuple[int, int], shape: tuple[int, int], *, blur_px: float = 0.7, first_black: bool = True
) -> tuple[Array, Array]:
    """Counts (y, x), and the inner corners (row, column, xy).

    Args:
        matrix: (3, 3), board (in squares, inner corners at whole numbers from 0) to picture.
        inner: inner corners, (columns, rows).
        shape: (rows, columns) of the picture.
        first_black: the colour of the square before the first corner.
    """
    columns, rows = inner
    height, width = shape
    y, x = (np.mgrid[0 : height * FINE, 0 : width * FINE] + 0.5) / FINE - 0.5
    a, b, c = np.einsum("ij,jyx->iyx", np.linalg.inv(matrix), np.stack([x, y, np.ones_like(x)]))
    u, v = a / c, b / c
    black = (np.floor(u) + np.floor(v)) % 2 == (0 if first_black else 1)
    on_board = (u > -1) & (v > -1) & (u < columns) & (v < rows)
    drawn = np.where(on_board & black, 60.0, 800.0)
    # a pixel is the mean over its square, the lens a Gaussian
    blurred = cv2.GaussianBlur(drawn, (0, 0), blur_px * FINE)
    picture = blurred.reshape(height, FINE, width, FINE).mean(axis=(1, 3))
    i, j = np.meshgrid(np.arange(columns), np.arange(rows))
    points = np.einsum("ij,jyx->yxi", matrix, np.stack([i, j, np.ones_like(i)]).astype(float))
    return picture, points[..., :2] / points[..., 2:]


def tilted(step_px: float = 16.0, turn_deg: float = 7.0, at: tuple[float, float] = (40.0, 36.0)) -> Array:
    """A board turned in the picture and seen a little from the side."""
    c, s = step_px * np.cos(np.radians(turn_deg)), step_px * np.sin(np.radians(turn_deg))
    return np.array([[c, -s, at[0]], [s, c, at[1]], [0.004, -0.003, 1.0]])

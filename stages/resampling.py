"""Sensor counts to signal on the reference grid: dark, flat, and mount and homography in one resampling.

The interpolation is the cubic convolution of Keys (1981, doi:10.1109/TASSP.1981.1163711) with a = -1/2, at the
exact sub-pixel position: OpenCV's own remap rounds positions to 1/32 pixel and uses a = -3/4.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Image = NDArray[np.float32]


@njit(nogil=True, cache=True, error_model="numpy")
def correct(raw: Any, dark: Image, gain: Image, white_level: int) -> Image:
    """(raw - dark) gain for one picture (y, x); NaN where the sensor saturated (raw >= white_level)."""
    height, width = raw.shape
    out = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            value = (np.float32(raw[y, x]) - dark[y, x]) * gain[y, x]
            out[y, x] = value if raw[y, x] < white_level else np.float32(np.nan)
    return out


@njit(nogil=True, cache=True, inline="always")
def _weights(t: float) -> tuple[float, float, float, float]:
    """Keys' weights of the four neighbours at fraction t behind the second."""
    return (
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )


@njit(nogil=True, cache=True, error_model="numpy")
def warp(image: Image, to_source: NDArray[np.float64], height: int, width: int) -> Image:
    """Resample `image` at `to_source` (x, y, 1) for every pixel of a height x width grid.

    Args:
        image: (y, x), may hold NaN.
        to_source: (3, 3), target pixel to source pixel, homogeneous.

    Returns:
        (height, width). NaN where one of the 16 neighbours lies outside the image or is NaN.
    """
    rows, columns = image.shape
    out = np.empty((height, width), np.float32)
    h = to_source
    for y in range(height):
        a0, b0, c0 = h[0, 1] * y + h[0, 2], h[1, 1] * y + h[1, 2], h[2, 1] * y + h[2, 2]
        for x in range(width):
            w = 1.0 / (h[2, 0] * x + c0)
            sx = (h[0, 0] * x + a0) * w
            sy = (h[1, 0] * x + b0) * w
            if not (w > 0.0 and sx >= 1.0 and sy >= 1.0 and sx < columns - 2 and sy < rows - 2):
                out[y, x] = np.nan
                continue
            ix, iy = int(sx), int(sy)
            wx0, wx1, wx2, wx3 = _weights(np.float32(sx - ix))
            wy0, wy1, wy2, wy3 = _weights(np.float32(sy - iy))
            total = np.float32(0.0)
            for k, wy in ((-1, wy0), (0, wy1), (1, wy2), (2, wy3)):
                row = image[iy + k]
                total += wy * (wx0 * row[ix - 1] + wx1 * row[ix] + wx2 * row[ix + 1] + wx3 * row[ix + 2])
            out[y, x] = total
    return out


def view_fraction(to_source: NDArray[np.float64], source: tuple[int, int], target: tuple[int, int]) -> float:
    """Fraction of the target grid (rows, columns) whose source position lies inside the source picture."""
    y, x = np.mgrid[0 : target[0] : 4, 0 : target[1] : 4]
    u, v, w = np.einsum("ij,jyx->iyx", to_source, np.stack([x, y, np.ones_like(x)]).astype(float))
    with np.errstate(divide="ignore", invalid="ignore"):
        sx, sy = u / w, v / w
    inside = (w > 0) & (sx >= 0) & (sy >= 0) & (sx <= source[1] - 1) & (sy <= source[0] - 1)
    return float(np.mean(inside))


def undo_mount(rotate: int, mirror: bool, shape: tuple[int, int]) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """Matrix from a pixel with the mount undone to the sensor's pixel, and the undone picture's (rows, columns).

    Undoing a mount is rotating clockwise by `rotate` degrees, then mirroring left to right.
    """
    rows, columns = shape
    # sensor -> rotated clockwise, for a picture of rows x columns
    turn = {
        0: [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        90: [[0, -1, rows - 1], [1, 0, 0], [0, 0, 1]],
        180: [[-1, 0, columns - 1], [0, -1, rows - 1], [0, 0, 1]],
        270: [[0, 1, 0], [-1, 0, columns - 1], [0, 0, 1]],
    }[rotate]
    undone = (columns, rows) if rotate in (90, 270) else (rows, columns)
    forward = np.array(turn, float)
    if mirror:
        forward = np.array([[-1, 0, undone[1] - 1], [0, 1, 0], [0, 0, 1]], float) @ forward
    return np.linalg.inv(forward), undone


def reorient(image: Image, rotate: int, mirror: bool) -> Image:
    """Undo a mount without resampling: a copy of the pixels in their new places."""
    turned = np.rot90(image, k=-(rotate // 90))
    return np.ascontiguousarray(turned[:, ::-1] if mirror else turned)

"""Sensor counts to signal on the reference grid: dark, flat, and mount and homography in one resampling.

The interpolation is the cubic convolution of Keys (1981, doi:10.1109/TASSP.1981.1163711) with a = -1/2, at the
exact sub-pixel position: OpenCV's own remap rounds positions to 1/32 pixel and uses a = -3/4.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lightstage.kernels.encodings import SIGNAL_STEP
from lightstage.kernels.pictures.keys_cubic import weights

Image = NDArray[np.float32]
_FAST = {"nsz"}
"""No "contract", a product and a sum in one step, and no "arcp", one over a divisor times: whether they pay, and so
the last bit, differs between processors. They gain nothing that can be measured here."""
_FINE, _STEP, _NAN = np.float32(1 / SIGNAL_STEP), np.float32(SIGNAL_STEP), np.float32(np.nan)
_HALF = np.float32(0.5)


@njit(nogil=True, cache=True, error_model="numpy")
def correct(raw: Any, dark: Image, gain: Image, white_level: int) -> Image:
    """(raw - dark) gain of one picture (y, x), to SIGNAL_STEP; NaN where it saturated (raw >= white_level)."""
    height, width = raw.shape
    out = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            value = (np.float32(raw[y, x]) - dark[y, x]) * gain[y, x]
            value = np.floor(value * _FINE + _HALF) * _STEP
            out[y, x] = value if raw[y, x] < white_level else np.float32(np.nan)
    return out


@njit(nogil=True, cache=True, error_model="numpy", fastmath=_FAST)
def warp(image: Image, to_source: NDArray[np.float64], height: int, width: int) -> Image:
    """Resample `image` at `to_source` (x, y, 1) for every pixel of a height x width grid.

    Args:
        image: (y, x), may hold NaN.
        to_source: (3, 3), target pixel to source pixel, homogeneous.

    Returns:
        (height, width), to SIGNAL_STEP. NaN where one of the 16 neighbours lies outside the image or is NaN.
    """
    rows, columns = image.shape
    flat = image.reshape(-1)
    out = np.empty((height, width), np.float32)
    h = to_source
    ix, iy = np.empty(width, np.int32), np.empty(width, np.int32)
    t, u = np.empty(width, np.float32), np.empty(width, np.float32)
    last_x, last_y = columns - 2, rows - 2
    for y in range(height):
        a0, b0, c0 = h[0, 1] * y + h[0, 2], h[1, 1] * y + h[1, 2], h[2, 1] * y + h[2, 2]
        for x in range(width):
            w = 1.0 / (h[2, 0] * x + c0)
            sx, sy = (h[0, 0] * x + a0) * w, (h[1, 0] * x + b0) * w
            seen = (w > 0.0) & (sx >= 1.0) & (sy >= 1.0) & (sx < last_x) & (sy < last_y)
            fx, fy = np.floor(sx), np.floor(sy)
            t[x], u[x] = np.float32(sx - fx), np.float32(sy - fy)
            ix[x], iy[x] = np.int32(fx if seen else 0.0), np.int32(fy if seen else 0.0)
        # a map near the identity takes long runs of neighbours from the same rows: those are read in one sweep
        first = 0
        while first < width:
            shift, row = ix[first] - first, iy[first]
            end = first + 1
            if row == 0:
                while end < width and iy[end] == 0:
                    end += 1
                out[y, first:end] = _NAN
            else:
                while end < width and iy[end] == row and ix[end] - end == shift:
                    end += 1
                start = (row - 1) * columns + shift - 1 + first
                size = end - first
                _sweep(
                    flat[start : start + size + 3],
                    flat[start + columns : start + columns + size + 3],
                    flat[start + 2 * columns : start + 2 * columns + size + 3],
                    flat[start + 3 * columns : start + 3 * columns + size + 3],
                    t[first:end],
                    u[first:end],
                    out[y, first:end],
                )
            first = end
    return out


@njit(nogil=True, cache=True, error_model="numpy", fastmath=_FAST)
def _sweep(above: Image, middle: Image, below: Image, last: Image, t: Image, u: Image, out: Image) -> None:
    """Interpolate a run of pixels whose neighbours follow each other; the rows begin one pixel before the first.

    t (across) and u (down) are fractions behind the second of four neighbours.
    """
    for i in range(out.size):
        wx0, wx1, wx2, wx3 = weights(t[i])
        wy0, wy1, wy2, wy3 = weights(u[i])
        value = (
            wy0 * (wx0 * above[i] + wx1 * above[i + 1] + wx2 * above[i + 2] + wx3 * above[i + 3])
            + wy1 * (wx0 * middle[i] + wx1 * middle[i + 1] + wx2 * middle[i + 2] + wx3 * middle[i + 3])
            + wy2 * (wx0 * below[i] + wx1 * below[i + 1] + wx2 * below[i + 2] + wx3 * below[i + 3])
            + wy3 * (wx0 * last[i] + wx1 * last[i + 1] + wx2 * last[i + 2] + wx3 * last[i + 3])
        )
        out[i] = np.floor(value * _FINE + _HALF) * _STEP


def view_fraction(to_source: NDArray[np.float64], source: tuple[int, int], target: tuple[int, int]) -> float:
    """Fraction of the target grid (rows, columns) whose source position lies inside the source picture."""
    y, x = np.mgrid[0 : target[0] : 4, 0 : target[1] : 4]
    u, v, w = np.einsum("ij,jyx->iyx", to_source, np.stack([x, y, np.ones_like(x)]).astype(float))
    with np.errstate(divide="ignore", invalid="ignore"):
        sx, sy = u / w, v / w
    inside = (w > 0) & (sx >= 0) & (sy >= 0) & (sx <= source[1] - 1) & (sy <= source[0] - 1)
    return float(np.mean(inside))


def undone_shape(rotate: int, shape: tuple[int, int]) -> tuple[int, int]:
    """(rows, columns) of a picture with its mount undone."""
    return (shape[1], shape[0]) if rotate in (90, 270) else shape


def reorient(image: Image, rotate: int, mirror: bool) -> Image:
    """Undo a mount: rotate clockwise by `rotate` degrees, then mirror left to right; (y, x), contiguous.

    Whole pixels move, so nothing is interpolated.
    """
    turned = np.rot90(image, k=-(rotate // 90))
    return np.ascontiguousarray(turned[:, ::-1] if mirror else turned)

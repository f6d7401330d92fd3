"""Blurs whose every bit is the same on every processor.

OpenCV picks its filters by the processor, and with them the last bit. What is small beside its parts, such as
texture less its local mean, has that bit in its leading digits. Here sums have one order and no fused products;
vectors lie along a row of results, never along a sum.

Kernels are OpenCV's (bit-exact there) and so are borders: reflected, with the border's pixel once.
"""

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

Image = NDArray[np.float32]
_FLAGS = {"nogil": True, "cache": True, "error_model": "numpy"}
_AROUND_PX = 7
_REACH = 4
"""Standard deviations that a Gaussian is cut off at."""


def gaussian(picture: Image, sigma: float) -> Image:
    """A picture (y, x) under a Gaussian of sigma pixels; NaN spreads."""
    size = round(2 * _REACH * sigma + 1) | 1
    weights = cv2.getGaussianKernel(size, sigma, cv2.CV_32F).ravel()[size // 2 :]
    out = np.empty(picture.shape, np.float32)
    _filtered(np.ascontiguousarray(picture, np.float32), np.ascontiguousarray(weights), out)
    return out


def box(picture: Image, size: int) -> Image:
    """The mean over size x size pixels, size odd."""
    out = np.empty(picture.shape, np.float32)
    _filtered(np.ascontiguousarray(picture, np.float32), np.full(size // 2 + 1, 1 / size, np.float32), out)
    return out


def filled(picture: Image) -> Image:
    """Unknown pixels take the mean of what is known around them, 0 where nothing is."""
    known = np.isfinite(picture)
    if known.all():
        return np.asarray(picture, np.float32)
    part = box(known.astype(np.float32), _AROUND_PX)
    mean = box(np.where(known, picture, np.float32(0)), _AROUND_PX) / np.maximum(part, np.float32(1e-3))
    return np.where(known, picture, mean).astype(np.float32)


def half_size(picture: Image) -> Image:
    """The next level of a pyramid: (1 4 6 4 1) / 16 along both axes, every second pixel."""
    rows, columns = picture.shape
    out = np.empty(((rows + 1) // 2, (columns + 1) // 2), np.float32)
    _every_second(np.ascontiguousarray(picture, np.float32), out)
    return out


@njit(inline="always", **_FLAGS)
def _mirrored(i: int, count: int) -> int:
    if count == 1:
        return 0
    while i < 0 or i >= count:
        i = -i if i < 0 else 2 * (count - 1) - i
    return i


@njit(**_FLAGS)
def _filtered(picture: Image, weights: Image, out: Image) -> None:
    """Symmetric weights, from the middle outwards, down and then across."""
    rows, columns = picture.shape
    reach = weights.size - 1
    line = np.empty(columns + 2 * reach, np.float32)
    for y in range(rows):
        middle = line[reach : reach + columns]
        for x in range(columns):
            middle[x] = weights[0] * picture[y, x]
        for k in range(1, reach + 1):
            w = weights[k]
            above, below = picture[_mirrored(y - k, rows)], picture[_mirrored(y + k, rows)]
            for x in range(columns):
                middle[x] += w * (above[x] + below[x])
        for x in range(reach):
            line[x] = line[reach + _mirrored(x - reach, columns)]
            line[reach + columns + x] = line[reach + _mirrored(columns + x, columns)]
        into = out[y]
        for x in range(columns):
            into[x] = weights[0] * middle[x]
        for k in range(1, reach + 1):
            w = weights[k]
            left, right = line[reach - k : reach - k + columns], line[reach + k : reach + k + columns]
            for x in range(columns):
                into[x] += w * (left[x] + right[x])


@njit(**_FLAGS)
def _every_second(picture: Image, out: Image) -> None:
    rows, columns = picture.shape
    four, six, part = np.float32(4), np.float32(6), np.float32(1 / 256)
    line = np.empty(columns + 4, np.float32)
    for y in range(out.shape[0]):
        a, b, c = picture[_mirrored(2 * y - 2, rows)], picture[_mirrored(2 * y - 1, rows)], picture[2 * y]
        d, e = picture[_mirrored(2 * y + 1, rows)], picture[_mirrored(2 * y + 2, rows)]
        middle = line[2 : 2 + columns]
        for x in range(columns):
            middle[x] = six * c[x] + four * (b[x] + d[x]) + (a[x] + e[x])
        for x in range(2):
            line[x] = line[2 + _mirrored(x - 2, columns)]
            line[2 + columns + x] = line[2 + _mirrored(columns + x, columns)]
        for x in range(out.shape[1]):
            i = 2 * x
            across = six * line[i + 2] + four * (line[i + 1] + line[i + 3]) + (line[i] + line[i + 4])
            out[y, x] = across * part

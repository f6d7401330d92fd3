"""Non-local means on normals, with the noise that the picture itself shows.

The normals are split into a smooth base and detail. A pixel's detail is averaged with that of others whose
neighbourhoods look alike,

    d(x) = sum_y w(x, y) d(y),    w = exp(-max(0, D(x, y) - 1) / h)

with D the mean square difference of the two neighbourhoods over what noise alone would make of it (Buades et
al. 2005, doi:10.1109/CVPR.2005.38). On a smooth surface detail is noise, so all of it goes; a pore that is
above the noise has few that look like it, and stays. Averaging detail instead of normals keeps curvature.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.pictures.masked_mean import MaskedMean
from lightstage.kernels.pictures.noise import finest_detail

Array = NDArray[np.float64]
Image = NDArray[np.float32]

_BASE_PX = 4.0
_RADIUS_PX = 8
_PATCH_PX = 1
"""Neighbourhoods are squares of 2 x this + 1."""
STRENGTH = 0.3
"""h: at 1 + h times the noise a neighbour counts 1/e."""


def non_local_means(normal: Array, spread: Array, mask: NDArray[np.bool_]) -> Array:
    """Filtered normals.

    Args:
        normal: (y, x, xyz) unit vectors; NaN where there is none.
        spread: (y, x): standard error of a component, up to one factor, which is measured here.
        mask: (y, x).

    Returns:
        (y, x, xyz), NaN where `normal` is or outside the mask.
    """
    known = mask & np.isfinite(normal).all(axis=2) & (spread > 0) & np.isfinite(spread)
    if known.sum() < 64:
        return normal
    inside = known.astype(np.float32)
    values = np.where(known[..., None], normal, 0).astype(np.float32)
    base = MaskedMean(known, _BASE_PX, dtype=np.float32)(values)
    base /= np.maximum(np.linalg.norm(base, axis=2, keepdims=True), 1e-6)
    detail = np.where(known[..., None], values - base, 0)
    variance = np.where(known, (noise_factor(normal, spread, known) * spread) ** 2, 1e6).astype(np.float32)
    precision = np.where(known, 1 / variance, 0).astype(np.float32)
    total = detail * precision[..., None]
    weights = precision.copy()
    rows, columns = known.shape
    for dy in range(_RADIUS_PX + 1):
        for dx in range(-_RADIUS_PX, _RADIUS_PX + 1):
            if (dy == 0 and dx <= 0) or dy * dy + dx * dx > _RADIUS_PX**2:
                continue  # each pair of pixels once
            if dy >= rows or abs(dx) >= columns:
                continue
            near = slice(0, rows - dy), slice(max(0, -dx), columns - max(0, dx))
            far = slice(dy, rows), slice(max(0, dx), columns - max(0, -dx))
            both = inside[near] * inside[far]
            apart = detail[near] - detail[far]
            distance = np.einsum("yxi,yxi->yx", apart, apart) / (variance[near] + variance[far]) * both
            # unit vectors have two free components
            ratio = _sum(distance) / np.maximum(_sum(both), 1) / 2
            alike = np.exp(-np.maximum(ratio - 1, 0) / STRENGTH) * both
            for a, b in ((near, far), (far, near)):
                weight = alike * precision[b]
                total[a] += weight[..., None] * detail[b]
                weights[a] += weight
    smooth = base + total / np.maximum(weights, 1e-12)[..., None]
    smooth /= np.maximum(np.linalg.norm(smooth, axis=2, keepdims=True), 1e-9)
    return np.where(known[..., None], smooth, np.nan).astype(np.float64)


def noise_factor(normal: Array, spread: Array, known: NDArray[np.bool_]) -> float:
    """What `spread` has to be multiplied with to be the standard error of a component.

    The finest detail of smooth surfaces is noise (`noise.finest_detail`); its median absolute value does not see
    edges. The three components share two degrees of freedom.
    """
    inner = cv2.erode(known.astype(np.uint8), np.ones((3, 3))) > 0
    values = np.where(known[..., None], normal, 0).astype(np.float32)
    squares = 0.0
    for i in range(3):
        fine = np.abs(finest_detail(values[..., i])[inner] / spread[inner])
        squares += (float(np.median(fine)) / 0.6745) ** 2 if fine.size else 0.0
    return max(float(np.sqrt(squares / 2)), 1e-6)


def _sum(values: Image) -> Image:
    side = 2 * _PATCH_PX + 1
    return np.asarray(
        cv2.boxFilter(values, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT), np.float32
    )

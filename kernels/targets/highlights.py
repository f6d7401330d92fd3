"""Where on a mirror ball a light is reflected: the kernel of `stages/calibration/highlights.py`.

    h = sum w p / sum w,   w = min(I - I_around, cap)

Erosion and dilation keep spots that hold a 2 x 2 square, so no hot pixel is taken for one. The weights are linear
up to a cap. Of a spot below saturation the centroid of its light is not moved by blur, so the cap is above it; a
threshold would cut a lopsided spot on one side. Of a saturated spot only the shape is left, and the glare around it
is lopsided, so the cap is half its height: the centroid of its area, with soft edges.

Source: Dutta (2010) 3.1.2.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.targets.ball_conic import Floats
from lightstage.kernels.targets.labels import SPOTS
from lightstage.kernels.targets.outline import ring_radius_px

FEW_SATURATED_PX = 3
"""So many saturated pixels leave the centroid to the light around them."""
_CAP = 0.5
"""Height, of a saturated spot's, from which all of it weighs the same."""
_NOISES = 8.0
"""A spot stands this many times the noise above its surroundings."""
_FAINTEST = 0.15
"""Of the strongest spot's height: what is lower is its glare."""
_LEAST_AREA_PX = 4
"""2 x 2 pixels."""
_KEPT = 0.5
"""Of the level: what erosion and dilation must leave of a spot."""
_LEAST_REACH_PX, _REACH = 3.0, 0.8
"""The centroid is taken so far around a spot, of its box's diagonal."""
_AROUND, _AROUND_PX = 1.3, 4
"""What a spot stands on is taken from a ring: it begins at so many times the reach, and is so wide."""
_PASSES = 4
"""Of the centroid, each about the one before."""
_MARGIN_PX = 6
"""About the ball, to see what is behind it."""
_SIGMA_OF_MAD = 1.4826
"""Of a normal distribution."""


def highlights(
    raw: Mapping[float, NDArray[np.uint16]], ring: Mapping[int, Floats], *, white_level: int
) -> Mapping[str, NDArray[Any]]:
    """The two strongest spots of one picture within the outline.

    Args:
        raw: the picture's bands, (y, x) counts; their mean is measured.
        ring: (point, xy), pixels: the ball's outline at the place where this picture shows it.
        white_level: the count at which a pixel says no more.

    Returns:
        `at_px` (spot, xy), `flux` and `peak` in counts, `width_px` (sigma) and `saturated_px` (spot), the
        strongest first, NaN where there is none; `noise` () in counts.
    """
    out = {
        "at_px": np.full((SPOTS, 2), np.nan),
        **{name: np.full(SPOTS, np.nan) for name in ("flux", "peak", "width_px", "saturated_px")},
    }
    (outline,) = ring.values()
    low = np.maximum(np.floor(outline.min(0)).astype(int) - _MARGIN_PX, 0)
    high = np.ceil(outline.max(0)).astype(int) + _MARGIN_PX + 1
    cut = [np.asarray(band[low[1] : high[1], low[0] : high[0]], np.float32) for band in raw.values()]
    full = np.any([band >= white_level for band in cut], axis=0)
    image = np.asarray(np.mean(cut, axis=0), np.float32)
    inside: NDArray[np.uint8] = np.zeros(image.shape, np.uint8)
    cv2.fillPoly(inside, [np.rint((outline - low) * 16).astype(np.int32)[:, None]], 1, shift=4)
    # a blurred spot at the rim reaches over it
    inside = cv2.dilate(inside, np.ones((3, 3), np.uint8)).astype(np.uint8)
    # beside a highlight at the rim lie the ball and what is behind it: each has its own ground
    share = _coverage(outline - low, image.shape)
    on = _ground(image[share > 0.99])
    off = _ground(image[share < 0.01]) if (share < 0.01).any() else 0.0
    image = (image - share * on - (1 - share) * off).astype(np.float32)
    noise = _SIGMA_OF_MAD * _mad(image[inside != 0])
    spots = _spots(image, inside, full, _NOISES * noise, ring_radius_px(outline))
    for i, spot in enumerate(spots[:SPOTS]):
        out["at_px"][i] = spot.at + low
        out["flux"][i], out["peak"][i] = spot.flux, spot.peak
        out["width_px"][i], out["saturated_px"][i] = spot.width, spot.saturated
    return {**out, "noise": np.array(noise)}


class _Spot(NamedTuple):
    at: Floats
    flux: float
    peak: float
    width: float
    saturated: int


def _spots(
    image: NDArray[np.float32], inside: NDArray[np.uint8], full: NDArray[np.bool_], least: float, radius: float
) -> list[_Spot]:
    """Spots of one picture, the strongest first."""
    clean = cv2.morphologyEx(image, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8), anchor=(0, 0))
    top = float(clean[inside != 0].max())
    if top < _KEPT * least:
        return []
    level = max(least, _FAINTEST * top)
    # the opened picture says which spots are real, the plain one where they are
    lit = ((image > level) & (inside != 0)).astype(np.uint8)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(lit, connectivity=8)
    spots = []
    for k in range(1, count):
        x, y, width, height, area = (int(v) for v in boxes[k])
        part = labels[y : y + height, x : x + width] == k
        if area < _LEAST_AREA_PX or clean[y : y + height, x : x + width][part].max() < _KEPT * level:
            continue
        if max(width, height) > radius:
            # as wide as half the ball: a lit surface in the mirror, no lamp
            continue
        saturated = int(np.count_nonzero(full[y : y + height, x : x + width][part]))
        peak = float(image[y : y + height, x : x + width][part].max())
        ys, xs = np.nonzero(part)
        values = image[y + ys, x + xs].astype(np.float64)
        start = np.array([np.average(x + xs, weights=values), np.average(y + ys, weights=values)])
        reach = max(_LEAST_REACH_PX, _REACH * np.hypot(width, height))
        at, spread = _centroid(image, start, reach, _CAP * peak if saturated > FEW_SATURATED_PX else np.inf)
        spots.append(_Spot(at, float(values.sum()), peak, spread, saturated))
    return sorted(spots, key=lambda spot: -spot.flux)


def _centroid(image: NDArray[np.float32], start: Floats, reach: float, cap: float) -> tuple[Floats, float]:
    """Centroid (xy) and width (sigma, px) of what stands above its surroundings within `reach`."""
    border = int(np.ceil(2 * reach)) + 2
    x0, y0 = np.maximum(np.rint(start).astype(int) - border, 0)
    window = image[y0 : y0 + 2 * border + 1, x0 : x0 + 2 * border + 1].astype(np.float64)
    ys, xs = np.indices(window.shape) + np.array([y0, x0])[:, None, None]
    at, spread = start, 0.0
    for _ in range(_PASSES):
        far = np.hypot(xs - at[0], ys - at[1])
        around = (far > _AROUND * reach) & (far <= _AROUND * reach + _AROUND_PX)
        weight = window - (_ground(window[around]) if around.any() else 0.0)
        if np.isfinite(cap):
            # soft edges from half of the cap to the cap
            weight = np.clip((weight - 0.5 * cap) / (0.5 * cap), 0, 1)
        # a smooth edge of the window, so that no pixel enters or leaves it at once
        weight = weight * np.clip(reach + 0.5 - far, 0, 1)
        flux = float(weight.sum())
        if flux <= 0:
            break
        at = np.array([(weight * xs).sum(), (weight * ys).sum()]) / flux
        spread = float(np.sqrt(max((weight * ((xs - at[0]) ** 2 + (ys - at[1]) ** 2)).sum() / (2 * flux), 0.1)))
    return at, spread


def _coverage(outline: Floats, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """How much of each pixel lies within the outline (point, xy), (y, x) from 0 to 1."""
    fine: NDArray[np.uint8] = np.zeros((8 * shape[0], 8 * shape[1]), np.uint8)
    corners = np.rint(((outline + 0.5) * 8 - 0.5) * 16).astype(np.int32)[:, None]
    cv2.fillPoly(fine, [corners], 255, shift=4)
    area = cv2.resize(fine, shape[::-1], interpolation=cv2.INTER_AREA)
    return np.asarray(area / np.float32(255), np.float32)


def _ground(values: NDArray[Any]) -> float:
    """Mean without outliers: counts are whole, and a median would be off by up to half a count on all pixels."""
    middle = float(np.median(values))
    return float(values[np.abs(values - middle) <= 3 * max(_mad(values), 0.5) * _SIGMA_OF_MAD].mean())


def _mad(values: NDArray[Any]) -> float:
    # counts are whole: the quantile that a third of a normal distribution exceeds is steadier than their median
    return float(np.quantile(np.abs(values), 0.683)) / _SIGMA_OF_MAD + 1e-3

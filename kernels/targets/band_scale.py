"""How many counts a band gives per unit of reflectance: exposure x transmission x source, from a white target.

    k_b = mean over the target of (picture_b - dark) / response, divided by its known reflectance in band b

The mean is Tukey's biweight, so that dust and hot pixels do not count. The target's irradiance is in every k_b
alike, hence bands compare with one another; the absolute scale is that of this target at this place. Optionally a
ColorChecker in the same pictures tells how well known reflectances are met (OpenCV's mcc).

Must have run before: dark and flat.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError
from lightstage.kernels.pictures.masked_mean import MaskedMean

Array = NDArray[np.float64]
_UNEVEN_PARTS = 80
"""Unevenness is told of means with a sigma of the picture's width over this: wide beside noise, narrow beside a
target."""


@dataclass(frozen=True)
class BandScale:
    """Per band, (band,)."""

    scale: Array
    """Counts per unit reflectance."""
    scale_se: Array
    unevenness: Array
    """Standard deviation over the target after smoothing, relative: light and flat together."""
    pixels: int


def response_of(flat: Array, dark: Array, *, reference: float | None = None) -> Array:
    """(flat - dark) / F, (y, x), where F is the smoothed maximum, or `reference` (of the reference camera).

    Args:
        flat: (y, x), counts, dark included.
    """
    light = flat - dark
    top = reference if reference is not None else float(cv2.GaussianBlur(light, (0, 0), light.shape[1] / 40).max())
    if top <= 0:
        raise KernelError("the flat is not brighter than the dark; take it with the lights on")
    return np.asarray(light / top)


def find_target(picture: Array) -> NDArray[np.bool_]:
    """The white target in a corrected picture (y, x): the largest patch near the brightest level, without its edge.

    Raises:
        KernelError: nothing stands out.
    """
    smooth = cv2.GaussianBlur(picture, (0, 0), max(1.0, picture.shape[1] / 200))
    level = float(np.percentile(smooth, 99))
    bright = (smooth > 0.9 * level).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(bright, connectivity=4)
    if count < 2 or level < 3 * max(float(np.median(np.abs(picture))), 1e-9):
        largest = 0 if count < 2 else int(stats[1:, cv2.CC_STAT_AREA].max())
        if largest < 0.05 * picture.size:
            raise KernelError("no white target stands out in the pictures; name its region")
    best = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    margin = max(3, round(0.06 * float(np.sqrt(stats[best, cv2.CC_STAT_AREA]))))
    kernel = np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)
    return np.asarray(cv2.erode((labels == best).astype(np.uint8), kernel) > 0)


def band_scale(
    pictures: NDArray[np.uint16],
    reflectance: Array,
    target: NDArray[np.bool_],
    *,
    dark: Array,
    response: Array,
    white: int = 1023,
    saturated_most: float = 0.001,
) -> BandScale:
    """Scale of every band.

    Args:
        pictures: (band, y, x), counts.
        reflectance: (band,), of the target, from above 0 to 1.
        target: (y, x).
        dark, response: (y, x), counts and relative.
        saturated_most: share of the target's pixels that may be saturated (hot ones are).

    Raises:
        KernelError: the target is small or saturated, a reflectance is impossible, or a band is dark.
    """
    if len(reflectance) != len(pictures) or not np.all((reflectance > 0) & (reflectance <= 1)):
        raise KernelError(
            f"{len(pictures)} bands need as many reflectances above 0 and up to 1, not {list(reflectance)}"
        )
    pixels = int(np.count_nonzero(target))
    if pixels < 100:
        raise KernelError(f"the target covers {pixels} pixels; 100 are the least")
    scale, error, uneven = (np.zeros(len(pictures)) for _ in range(3))
    for b, picture in enumerate(pictures):
        full = np.count_nonzero(picture[target] >= white) / pixels
        if full > saturated_most:
            raise KernelError(f"band {b}: {100 * full:.1f} % of the target is saturated; expose it less")
        values = ((picture - dark) / response)[target]
        mean, se = biweight(values)
        if mean < 20:
            raise KernelError(f"band {b}: the target has {mean:.1f} counts; expose it more, or check the filter")
        scale[b], error[b] = mean / reflectance[b], se / reflectance[b]
        local = MaskedMean(target, picture.shape[1] / _UNEVEN_PARTS, least=1e-9)((picture - dark) / response)
        uneven[b] = np.std(local[target]) / mean
    return BandScale(scale, error, uneven, pixels)


def biweight(values: Array, *, cut: float = 6.0) -> tuple[float, float]:
    """Tukey's biweight mean of (n,) and its standard error, after two steps from the median."""
    centre = float(np.median(values))
    weight = np.ones_like(values)
    for _ in range(2):
        width = float(np.median(np.abs(values - centre))) or 1e-9
        weight = np.clip(1 - ((values - centre) / (cut * width)) ** 2, 0, None) ** 2
        centre = float(np.sum(weight * values) / np.sum(weight))
    spread = float(np.sum(weight**2 * (values - centre) ** 2)) ** 0.5 / float(np.sum(weight))
    return centre, spread


def find_checker(reflectance: Array, *, red: int, green: int, blue: int) -> Array:
    """Outlines of the 24 patches, (patch, corner, xy) pixels, dark skin first.

    Args:
        reflectance: (band, y, x), corrected and over scale.
        red, green, blue: bands to show as these.

    Raises:
        KernelError: no chart is found.
    """
    shown = np.stack([reflectance[blue], reflectance[green], reflectance[red]], axis=-1)
    picture = np.round(255 * np.clip(shown, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    # the detector wants patches of some forty pixels
    for grow in (1, 1.5, 2, 3, 0.75):
        detector = cv2.mcc.CCheckerDetector.create()
        large = picture if grow == 1 else cv2.resize(picture, None, fx=grow, fy=grow, interpolation=cv2.INTER_CUBIC)
        if detector.process(large, 1):
            corners = np.array(detector.getBestColorChecker().getColorCharts(), dtype=float).reshape(-1, 4, 2)
            if len(corners) == 24:
                return np.asarray((corners + 0.5) / grow - 0.5)
    raise KernelError("no ColorChecker is found in the pictures; show it whole, upright and in focus")


def checker_reflectance(reflectance: Array, patches: Array, *, inner: float = 0.5) -> Array:
    """(patch, band): median over the inner part of every patch.

    Args:
        reflectance: (band, y, x).
        patches: (patch, corner, xy), pixels.
    """
    out = np.full((len(patches), len(reflectance)), np.nan)
    for k, corners in enumerate(patches):
        small = corners.mean(axis=0) + inner * (corners - corners.mean(axis=0))
        mask = np.zeros(reflectance.shape[1:], np.uint8)
        cv2.fillConvexPoly(mask, np.round(small).astype(np.int32), 1)
        if mask.any():
            out[k] = np.median(reflectance[:, mask > 0], axis=1)
    return out

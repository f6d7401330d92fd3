"""Dark and flat from repeated frames: means, temporal noise, hot and dead pixels.

    counts = dark + response x signal + noise

All in sensor orientation, counts. Frames come one after the other, so memory does not grow with their number.

Sources: EMVA Standard 1288 (release 4.0, 2021), defect pixels; Welford (1962), doi:10.1080/00401706.1962.10490022
(running variance).
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_SIGMAS = 8.0
"""A good pixel of a 2-megapixel sensor lies beyond this once in a billion sensors."""
_HOT_COUNTS_10_BIT = 10.0
"""However noisy the sensor is, a dark this far above the neighbours is hot (a hundredth of the range)."""
_QUANTISATION = 1 / 12


@dataclass(frozen=True)
class Moments:
    """Mean and temporal variance of repeated frames."""

    mean: Array
    """(y, x), counts."""
    variance: Array
    """(y, x), counts squared, unbiased; the rounding to whole counts is in it."""
    frames: int
    saturated: Mask
    """(y, x): at the white level in any frame."""


def moments(frames: Iterable[NDArray[Any]], *, white_level: int) -> Moments:
    """Mean and variance over frames (y, x) of the same scene.

    Raises:
        KernelError: no frames, or frames of different sizes.
    """
    mean = squares = None
    count = 0
    for frame in frames:
        values = np.asarray(frame, np.float64)
        if mean is None or squares is None:
            mean, squares, saturated = (
                np.zeros_like(values),
                np.zeros_like(values),
                np.zeros(values.shape, np.bool_),
            )
        if values.shape != mean.shape:
            raise KernelError(f"the frames differ in size ({values.shape} after {mean.shape}); capture them again")
        count += 1
        step = values - mean
        mean += step / count
        squares += step * (values - mean)
        saturated |= np.asarray(frame) >= white_level
    if mean is None or squares is None:
        raise KernelError("a dark or flat needs at least one frame; none is given")
    variance = squares / (count - 1) if count > 1 else np.full_like(mean, np.nan)
    return Moments(mean, variance, count, saturated)


def find_hot(dark: Array, *, white_level: int) -> tuple[Mask, float]:
    """Pixels whose dark lies far above their neighbours'.

    Args:
        dark: (y, x) mean dark, counts.

    Returns:
        mask (y, x) and the threshold in counts: 8 robust sigmas of dark - median of 5 x 5, or a hundredth of the
        range, whichever is less.
    """
    above = dark - _median(dark)
    threshold = min(
        _SIGMAS * max(_sigma(above), np.sqrt(_QUANTISATION)), _HOT_COUNTS_10_BIT * (white_level + 1) / 1024
    )
    return above > threshold, threshold


def find_dead(flat: Array, dark: Array, *, bad: Mask | None = None) -> tuple[Mask, float]:
    """Pixels that answer to light far less than their neighbours.

    Args:
        flat, dark: (y, x) mean counts.
        bad: (y, x) pixels known to be bad (hot): they do not count as neighbours.

    Returns:
        mask (y, x) and the threshold: response relative to the neighbours', 1 - 8 robust sigmas, from 0.5 to 0.9.

    Raises:
        KernelError: the flat shows no light.
    """
    lit = flat - dark if bad is None else interpolate(flat - dark, bad)
    level = float(np.median(lit))
    if level <= 5 * _sigma(lit - _median(lit)) or level <= 0:
        raise KernelError(f"the flat lies {level:.1f} counts above the dark, which is no light; light the target")
    around = _median(lit)
    # a corner that the lens leaves black has no response to compare
    relative = np.where(around > 0.02 * level, lit / np.maximum(around, 1e-9), 1.0)
    threshold = float(np.clip(1 - _SIGMAS * _sigma(relative - 1), 0.5, 0.9))
    return relative < threshold, threshold


def interpolate(image: NDArray[Any], bad: Mask) -> Array:
    """The picture (y, x) with bad pixels replaced from their good neighbours, weighted by 1 / distance²."""
    out = np.array(image, np.float64)
    rows, columns = out.shape
    for y, x in np.argwhere(bad):
        # clusters: look further until half of a ring of 3 x 3 is good
        for reach in range(1, max(rows, columns)):
            ys = slice(max(y - reach, 0), y + reach + 1)
            xs = slice(max(x - reach, 0), x + reach + 1)
            good = ~bad[ys, xs]
            if good.sum() >= 4:
                break
        else:
            raise KernelError("every pixel is bad, so there is nothing to interpolate from; check the frames")
        dy, dx = np.ogrid[ys.start - y : ys.start - y + good.shape[0], xs.start - x : xs.start - x + good.shape[1]]
        weight = good / np.maximum(dy * dy + dx * dx, 1)
        out[y, x] = (weight * image[ys, xs]).sum() / weight.sum()
    return out


def _median(image: Array) -> Array:
    return np.asarray(cv2.medianBlur(image.astype(np.float32), 5), np.float64)


def _sigma(values: Array) -> float:
    """Robust standard deviation: half the range of the middle 68 %, which whole counts round less than the MAD."""
    low, high = np.percentile(values, [15.87, 84.13])
    return float(high - low) / 2

"""Gain, read noise and linearity of a sensor.

    var = read² + (counts - dark) / e        e: electrons a count        counts = offset + slope t

Sources: EMVA Standard 1288 (release 4.0, 2021): photon transfer, linearity; Janesick (2007), Photon Transfer,
doi:10.1117/3.725073.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.defects import Mask, Moments

Array = NDArray[np.float64]
_QUANTISATION = 1 / 12
"""Variance of rounding to whole counts."""


@dataclass(frozen=True)
class PhotonTransfer:
    """Gain and read noise from variance against mean."""

    electrons_per_count: float
    electrons_per_count_sd: float
    read_noise_electrons: float


@dataclass(frozen=True)
class Linearity:
    """Counts against exposure time."""

    offset_counts: float
    slope_counts_per_s: float
    deviation_percent: float
    """Worst deviation from the line below saturation, percent of full scale (white level less offset)."""
    deviation_counts: Array
    """(exposure,) measured - line, in the order given; NaN above saturation."""
    saturates_at_counts: float | None
    """Level where it stops to follow the line; None if no picture reached it."""


def photon_transfer(dark: Moments, flats: Iterable[Moments], *, bad: Mask | None = None) -> PhotonTransfer:
    """Electrons per count: the slope of temporal variance against signal, pixel by pixel.

    Vignetting spreads the signal, so one flat level gives a slope already; more levels make it better. Variances
    are averaged, never their median: that of few frames is skewed.

    Raises:
        KernelError: fewer than two frames of dark or of every flat, or all saturated.
    """
    use = np.ones(dark.mean.shape, np.bool_) if bad is None else ~bad
    if dark.frames < 2:
        raise KernelError("the gain needs the noise: two dark frames are the least, one is given")
    base = float(dark.variance[use].mean())
    numerator = denominator = weights = 0.0
    for flat in flats:
        if flat.frames < 2:
            raise KernelError(
                "the gain needs the noise: two flat frames of every level are the least, one is given"
            )
        # the top of the noise is cut off where a frame saturates: the variance would be too small
        good = use & ~flat.saturated
        if not good.any():
            continue
        signal = (flat.mean - dark.mean)[good]
        excess = flat.variance[good] - base
        # sd of a variance from n frames grows with the variance: weight 1 / signal makes the slope a ratio of sums
        numerator += float(signal.sum()) * (flat.frames - 1)
        denominator += float(excess.sum()) * (flat.frames - 1)
        weights += float(good.sum()) * (flat.frames - 1)
    if denominator <= 0:
        raise KernelError("the flats are not noisier than the dark, so they tell no gain: saturated, or not lit")
    gain = numerator / denominator
    read = np.sqrt(max(base - _QUANTISATION, 0.0)) * gain
    return PhotonTransfer(gain, float(gain * np.sqrt(2 / weights)), float(read))


def fit_linearity(exposure_s: Array, counts: Array, *, white_level: int) -> Linearity:
    """Line through an exposure series: counts = offset + slope t.

    Args:
        exposure_s: (k,) exposure times, seconds.
        counts: (k,) mean level of the same evenly lit pixels, dark included, or (k, y, x) frames: then the median
            of the brighter half of the pixels counts.

    Raises:
        KernelError: fewer than three different exposures below saturation.
    """
    times = np.asarray(exposure_s, float)
    values = np.asarray(counts, float)
    piled = np.zeros(times.size)
    if values.ndim == 3:
        # chosen on a smooth picture: the noise of a frame would choose pixels that are bright in that frame alone
        smooth = cv2.GaussianBlur(values.mean(0), (0, 0), 0.02 * values.shape[2] + 1)
        bright = values[:, smooth >= np.median(smooth)]
        # a well that is full before the converter is shows as pixels piled up at one value below white
        top = min(float(bright.max()), float(white_level))
        piled = (bright >= top).mean(1)
        values = np.mean(bright, 1)
    order = np.argsort(times, kind="stable")
    full = white_level
    linear: list[int] = []
    offset = slope = 0.0
    for k in order:
        if values[k] >= white_level or piled[k] > 0.001:
            break
        if len(linear) >= 3 and abs(values[k] - offset - slope * times[k]) > 0.05 * full:
            # far off the line of all shorter exposures: saturation, not curvature
            break
        linear.append(int(k))
        if np.unique(times[linear]).size >= 2:
            slope, offset = np.polyfit(times[linear], values[linear], 1)
    if np.unique(times[linear]).size < 3:
        raise KernelError(
            f"{len(linear)} exposures lie below saturation; three different ones are the least: expose more shortly"
        )
    deviation = np.full(times.size, np.nan)
    deviation[linear] = values[linear] - offset - slope * times[linear]
    worst = float(np.nanmax(np.abs(deviation)) / (full - offset) * 100)
    above = [k for k in order if k not in linear]
    saturates = float(values[above].max()) if above else None
    return Linearity(float(offset), float(slope), worst, deviation, saturates)

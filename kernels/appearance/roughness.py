"""How wide a specular lobe is, from its norm: the equations are in `stages/gloss.py`.

A pixel's norm is too noisy to tell a width, so it is found from wide neighbourhoods to narrow ones, and each
narrower one moves its logarithm only as far as its predicted error allows.

Sources: Ma et al. (2007) 3.2 for specular gradients; Ghosh et al. (2009), doi:10.1111/j.1467-8659.2009.01493.x, for
roughness from moments of the lobe; Immerkaer (1996), doi:10.1006/cviu.1996.0060, for noise without complements.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lightstage.hw.illuminations import AXES, CONSTANT, complement, pairs
from lightstage.kernels.appearance.microfacets import sphere_response
from lightstage.kernels.pictures.masked_mean import MaskedMean, ending
from lightstage.kernels.pictures.noise import finest_detail

Image = NDArray[np.float32]
Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

WIDTHS: Array = np.geomspace(0.05, 0.8, 18)
"""GGX widths that are told; beyond them a result is at the end."""
WINDOWS_PX = (32.0, 16.0, 8.0, 4.0, 2.0)
"""Sigma of the neighbourhoods, in pixels of the pictures that roughness is found in."""
_NOISE_PX = 8.0
"""Sigma of the neighbourhood that noise is measured in."""
_LEAST_SLOPE = 0.02
"""d norm / d ln a below which a norm tells no width."""
_FACING = np.linspace(0.05, 1, 20)
"""Cosines that the response of a sphere of light is tabulated at."""


class Moments(NamedTuple):
    """Of the specular lobe, all bands as one; NaN where not valid."""

    constant: Array
    """(y, x): s."""
    vector: Array
    """(y, x, xyz): m."""
    variance: Array
    """(y, x): of the noise of a component of m."""
    variance_constant: Array
    """(y, x): of s."""


class Lobes(NamedTuple):
    """What lobes of WIDTHS show, for w = 1."""

    constant: Array
    """(width, y, x)."""
    square: Array
    """(width, y, x): |m|^2."""


class Widths(NamedTuple):
    """Roughness and its standard error, (y, x)."""

    value: Array
    error: Array


def measure(bands: Sequence[Mapping[str, Image]]) -> Moments:
    """s and m of the specular component, bands weighted by their noise.

    Args:
        bands: per band, pictures (y, x) by illumination.
    """
    shape = next(iter(bands[0].values())).shape
    total, weights = np.zeros((*shape, 4)), np.zeros(shape)
    for pictures in bands:
        part, known = _vector(pictures)
        weight = np.where(known, 1 / _noise(pictures, known), 0)
        total += weight[..., None] * np.where(known[..., None], part, 0)
        weights += weight
    weights = np.where(weights > 0, weights, np.nan)
    total /= weights[..., None]
    count = len(pairs(bands[0])) + int(CONSTANT in bands[0])
    # shot noise: a pair's sum is as noisy as C, and so is its difference
    return Moments(total[..., 3], total[..., :3], 1 / weights, 1 / weights / count)


def _vector(pictures: Mapping[str, Image]) -> tuple[Array, Mask]:
    """(y, x, 4): m and s, and where all pictures are valid."""
    whole = [pictures[CONSTANT]] if CONSTANT in pictures else []
    whole += [pictures[a] + pictures[b] for a, b in pairs(pictures)]
    constant = np.mean(np.stack(whole), axis=0, dtype=np.float64)
    out = np.empty((*constant.shape, 4))
    out[..., 3] = constant
    for i, axis in enumerate(AXES):
        opposite = complement(axis)
        if axis in pictures and opposite in pictures:
            out[..., i] = pictures[axis] - pictures[opposite]
        else:
            out[..., i] = 2 * pictures[axis] - constant if axis in pictures else constant - 2 * pictures[opposite]
    return out, np.asarray(np.isfinite(out).all(axis=2))


def _noise(pictures: Mapping[str, Image], known: Mask) -> Array:
    """(y, x): variance of a constant picture around each pixel. The specular component is the difference of two
    cameras, so its noise is mostly the diffuse light's, and does not follow from its own brightness."""
    couples = pairs(pictures) if CONSTANT in pictures else []
    if couples:
        off = [(pictures[a] + pictures[b] - pictures[CONSTANT]).astype(np.float64) ** 2 / 2 for a, b in couples]
    else:
        picture = next(iter(pictures.values())).astype(np.float64)
        off = [finest_detail(np.where(known, picture, 0)) ** 2]
    around = local_mean(np.mean(off, axis=0), known, _NOISE_PX)
    least = float(np.max(around[known], initial=0.0)) * 1e-6
    return np.maximum(around, max(least, 1e-30))


def find_widths(moments: Moments, lobes: Lobes, known: Mask, spread: float) -> Widths:
    """From wide neighbourhoods to narrow ones.

    Args:
        moments: measured.
        lobes: what the model has at each pixel.
        known: (y, x), where both are.
        spread: of ln a, between a neighbourhood and its middle: the prior of each halving.
    """
    square = np.einsum("yxi,yxi->yx", moments.vector, moments.vector) - 3 * moments.variance
    level = moments.constant**2 - moments.variance_constant
    noisy = 4 * np.maximum(square, 0) * moments.variance + 6 * moments.variance**2
    noisy_level = 4 * np.maximum(level, 0) * moments.variance_constant + 2 * moments.variance_constant**2
    log_width = np.zeros(known.shape)
    weights: list[Array] = []
    deviations: list[Array] = []
    for step, sigma in enumerate(WINDOWS_PX):
        up, down = local_mean(square, known, sigma), local_mean(level, known, sigma)
        norm = 0.5 * np.sqrt(np.maximum(up, 0) / np.maximum(down, 1e-30))
        expected = [
            0.5 * np.sqrt(local_mean(m, known, sigma) / np.maximum(local_mean(s**2, known, sigma), 1e-30))
            for m, s in zip(lobes.square, lobes.constant, strict=True)
        ]
        crossing, slope = _crossing(np.stack(expected), norm)
        # a Gaussian window of sigma averages the variance of 4 pi sigma^2 pixels
        pixels = 4 * np.pi * sigma**2 * np.maximum(local_mean(known.astype(float), known | True, sigma), 1e-6)
        narrow = sigma / np.sqrt(2)
        relative = local_mean(noisy, known, narrow) / np.maximum(up, 1e-30) ** 2
        relative += local_mean(noisy_level, known, narrow) / np.maximum(down, 1e-30) ** 2
        own = norm**2 * relative / (4 * pixels) / np.maximum(slope, _LEAST_SLOPE) ** 2
        if step == 0:
            middle = float(np.median(crossing[known])) if known.any() else 0.0
            log_width = np.where(np.isfinite(crossing), crossing, middle)
            gain = np.ones(known.shape)
        else:
            gain = spread**2 / (spread**2 + own)
            log_width = log_width + gain * (crossing - log_width)
        weights = [*(weight * (1 - gain) for weight in weights), gain]
        deviations.append(np.sqrt(own))
    return Widths(np.exp(log_width), np.exp(log_width) * np.sqrt(summed_variance(weights, deviations)))


def summed_variance(weights: Sequence[Array], deviations: Sequence[Array]) -> Array:
    """Variance of a weighted sum of what the neighbourhoods of WINDOWS_PX tell.

    A narrow neighbourhood lies within the wide ones, so their noise is correlated: two Gaussian windows of sigma s
    and t, over white noise, with 2 s t / (s^2 + t^2).
    """
    parts = [weight * deviation for weight, deviation in zip(weights, deviations, strict=True)]
    total = np.zeros(parts[0].shape)
    for s, part in zip(WINDOWS_PX, parts, strict=True):
        for t, other in zip(WINDOWS_PX, parts, strict=True):
            total += 2 * s * t / (s**2 + t**2) * part * other
    return total


def _crossing(expected: Array, norm: Array) -> tuple[Array, Array]:
    """ln a at which the model has the measured norm, and -d norm / d ln a there, (y, x)."""
    falling = np.minimum.accumulate(expected, axis=0)
    logs = np.log(WIDTHS)
    below = np.clip((falling > norm).sum(axis=0), 1, len(WIDTHS) - 1)[None]
    high = np.take_along_axis(falling, below - 1, axis=0)[0]
    low = np.take_along_axis(falling, below, axis=0)[0]
    part = np.clip((high - norm) / np.maximum(high - low, 1e-12), 0, 1)
    step = logs[1] - logs[0]
    return logs[below[0] - 1] + part * step, (high - low) / step


def local_mean(values: Array, known: Mask, sigma: float) -> Array:
    """Gaussian mean over what is known."""
    return MaskedMean(known, sigma, least=1e-9, blur=ending)(values)


def at_width(lobes: Array, width: Array) -> Array:
    """What lobes (width, y, x) show at the width of each pixel."""
    place = np.log(width / WIDTHS[0]) / np.log(WIDTHS[1] / WIDTHS[0])
    below = np.clip(place.astype(int), 0, len(WIDTHS) - 2)
    part = np.clip(place - below, 0, 1)
    low, high = (np.take_along_axis(lobes, (below + i)[None], axis=0)[0] for i in (0, 1))
    return np.asarray(low + part * (high - low))


def sphere_lobes(facing: Array, known: Mask, index: float) -> Lobes:
    """Under a whole sphere of light.

    Args:
        facing: (y, x), cosine of the angle between the surface and the camera. known: (y, x), where there is one.
        index: of refraction.
    """
    cosine = np.where(known, np.clip(facing, _FACING[0], 1), 1)
    constant, norm = sphere_response(_FACING, WIDTHS, index)
    level = np.stack([np.interp(cosine, _FACING, row) for row in constant])
    length = np.stack([np.interp(cosine, _FACING, row) for row in norm])
    return Lobes(level, (2 * length * level) ** 2)

"""How noisy pictures are, measured in the capture itself.

A gradient and its complement add up to the constant picture
whatever the subject, so what parts such sums from it and from each other is noise alone; with read noise alpha and
shot noise beta r (Foi et al. 2008, doi:10.1109/TIP.2008.2001399, for the model)

    var(r_a + r_a' - r_c) = 3 alpha + 2 beta r_c,    var(r_a + r_a' - r_b - r_b') = 4 alpha + 2 beta r_c

The two tell alpha from beta also where a scene has one level only. Without complements the finest detail of the
pictures stands in for them (Immerkaer 1996, doi:10.1006/cviu.1996.0060).

The fit is the maximum of a Cauchy likelihood, scaled so that it is right for Gaussian noise: highlights that move
or saturate do not pull it. Each sample counts by what its square is worth as an estimate of its variance v, which
is 1 / (2 v^2). Nothing is sorted, cut or put into bins, so a last bit in a picture moves the fit by a last bit.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.hw.illuminations import CONSTANT, pairs

Image = NDArray[np.float32]
Array = NDArray[np.float64]

_CAUCHY = 0.6120032
"""Scale of the Cauchy distribution that fits a standard normal one best: the mean of x^2 / (x^2 + c^2) is 1/2."""
_STEPS = (1.0,) * 10 + (2.5,) * 10
"""Lengths of the steps of the fixed-point iteration: it gains 0.7 a step, and 0.2 with long ones, which must begin
nearby. After these it stands to seven digits."""
_LEAST_PX, _ENOUGH_PX = 64, 1 << 16
"""Pixels that tell anything; and those that tell a variance to half a percent, so that more are not looked at."""
_PRIOR = 16.0
"""So many samples say that there is no read noise: where one level is all there is, alpha is not left to chance."""


class _Samples(NamedTuple):
    """Numbers that are noise alone, of variance reads alpha + shots beta."""

    value: Array
    reads: Array
    shots: Array


def noise_model(pictures: Mapping[str, Image]) -> tuple[float, float]:
    """(alpha, beta): the variance of a pixel of radiance r is alpha + beta r, in the pictures' unit.

    Args:
        pictures: one band, by illumination, (y, x).
    """
    samples = _sums_apart(pictures) or _details(pictures)
    if samples.value.size < _LEAST_PX:
        return 1.0, 0.0
    return _fit(samples)


def finest_detail(picture: NDArray[Any]) -> NDArray[Any]:
    """What a picture (y, x) has beyond its planes: of white noise, noise of the same variance.

    Immerkaer (1996): the second difference along both axes, over the root of what its factors square to.
    """
    plane_blind = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], picture.dtype) / picture.dtype.type(6)
    return np.asarray(cv2.filter2D(picture, -1, plane_blind))


def _sums_apart(pictures: Mapping[str, Image]) -> _Samples | None:
    """What parts the constant picture and the sums of pairs from each other; None where there is one or none."""
    every = _every(pictures)
    # how many pictures' read noise is in each
    same = [(pictures[CONSTANT][every].astype(np.float64), 1.0)] if CONSTANT in pictures else []
    same += [(pictures[a][every].astype(np.float64) + pictures[b][every], 2.0) for a, b in pairs(pictures)]
    if len(same) < 2:
        return None
    # the mean of all: a level that has a sample's own noise in it would put the large ones together
    level = np.mean([picture for picture, _ in same], axis=0)
    parts = [(a - b, reads + more, 2.0, level) for (a, reads), (b, more) in combinations(same, 2)]
    return _joined(parts)


def _details(pictures: Mapping[str, Image]) -> _Samples:
    every = _every(pictures)
    parts = []
    for picture in pictures.values():
        fine = np.asarray(picture, np.float64)
        level = cv2.GaussianBlur(
            fine, (0, 0), 1.0
        )  # smoothed, so that a pixel's own noise does not choose its level
        parts.append((finest_detail(fine)[every], 1.0, 1.0, level[every]))
    return _joined(parts)


def _every(pictures: Mapping[str, Image]) -> tuple[slice, slice]:
    """Every so many rows and columns."""
    apart = max(1, int(np.sqrt(next(iter(pictures.values())).size / _ENOUGH_PX)))
    return slice(None, None, apart), slice(None, None, apart)


def _joined(parts: Sequence[tuple[Array, float, float, Array]]) -> _Samples:
    """From value, reads, shots and level of each; what is not finite is left out."""
    columns = []
    for value, reads, shots, level in parts:
        known = np.isfinite(value) & np.isfinite(level)
        columns.append((value[known], np.full(int(known.sum()), reads), shots * np.maximum(level[known], 0)))
    return _Samples(*(np.concatenate(column) for column in zip(*columns, strict=True)))


def _fit(samples: _Samples) -> tuple[float, float]:
    """alpha and beta, neither below zero."""
    unit = float(np.mean(np.abs(samples.value))) ** 2
    if not unit > 0:
        return 0.0, 0.0
    square = (samples.value / _CAUCHY) ** 2 / unit
    usual = float(np.mean(samples.shots)) or 1.0
    reads, shots = samples.reads, samples.shots / usual
    alpha, beta = 0.5 / float(np.mean(reads)), 0.5
    for step in _STEPS:
        variance = np.maximum(alpha * reads + beta * shots, 1e-9)
        robust = variance * (1 + step * (square - variance) / (square + variance))
        weight = 1 / variance**2
        weighted = weight * reads
        rr, rs, ss = weighted @ reads, weighted @ shots, (weight * shots) @ shots
        r, s = weighted @ robust, (weight * shots) @ robust
        rr *= 1 + _PRIOR / square.size
        whole = max(float(rr * ss - rs * rs), 1e-300)
        alpha, beta = float(r * ss - s * rs) / whole, float(s * rr - r * rs) / whole
        if beta < 0 or not ss > 0:
            alpha, beta = max(float(r / rr), 0.0), 0.0
        elif alpha < 0:
            alpha, beta = 0.0, max(float(s / ss), 0.0)
    return alpha * unit, beta * unit / usual

"""Pictures with round spots of light at known places: what a mirror ball shows of distant lights."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

OFFSET = 16.0
"""Counts of the dark."""


def picture(
    places: Sequence[Sequence[float]],
    peaks: Sequence[float],
    *,
    shape: tuple[int, int] = (120, 140),
    width_px: float = 1.2,
    white: int = 1023,
) -> NDArray[np.uint16]:
    """(y, x) counts: a Gaussian of each peak at each (x, y), on the dark."""
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]]
    counts = np.full(shape, OFFSET)
    for (at_x, at_y), peak in zip(places, peaks, strict=True):
        counts += peak * np.exp(-((x - at_x) ** 2 + (y - at_y) ** 2) / (2 * width_px**2))
    return np.minimum(np.round(counts), white).astype(np.uint16)


def circle(x: float, y: float, radius: float) -> NDArray[np.float64]:
    """(720, xy): the outline of a ball."""
    turn = np.radians(np.arange(720) / 2)
    return np.stack([x + radius * np.cos(turn), y + radius * np.sin(turn)], axis=1)

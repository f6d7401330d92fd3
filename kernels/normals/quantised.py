"""Normals to what is stored and back: int16, in the steps of `kernels.encodings`."""

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.encodings import NORMAL_FILL, NORMAL_STEPS


def encode(normal: NDArray[np.floating], valid: NDArray[np.bool_] | None = None) -> NDArray[np.int16]:
    """Unit vectors as they are stored.

    Args:
        normal: (xyz, y, x).
        valid: (y, x), where there is a normal; None: where all three components are finite.
    """
    known = np.isfinite(normal).all(axis=0) if valid is None else valid
    number = normal.dtype.type  # so that float32 stays float32
    with np.errstate(invalid="ignore"):
        steps = np.floor(np.where(known, normal, number(0)) * number(NORMAL_STEPS) + number(0.5))
    return np.ascontiguousarray(np.where(known, steps, number(NORMAL_FILL)), np.int16)


def decode(stored: NDArray[np.int16]) -> NDArray[np.float64]:
    """Unit vectors (xyz, y, x) of what `encode` made; NaN where there is none."""
    return np.where(stored == NORMAL_FILL, np.nan, stored / NORMAL_STEPS)

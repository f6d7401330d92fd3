"""Normals as they are stored: int16, a component in steps of 1 / STEPS.

The error is below 0.002 degrees. `ATTRS` says so to whoever opens the array (CF conventions), and who opens it with
xarray gets unit vectors, NaN where there is none.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

STEPS = 32767
FILL = -32768
"""Stored where there is no normal; reads as NaN."""
ATTRS: Mapping[str, Any] = {"scale_factor": 1 / STEPS, "_FillValue": FILL, "units": "unit vector"}
"""What an array of stored normals says of itself."""


def encode(normal: NDArray[np.floating], valid: NDArray[np.bool_] | None = None) -> NDArray[np.int16]:
    """Unit vectors as they are stored.

    Args:
        normal: (xyz, y, x).
        valid: (y, x), where there is a normal; None: where all three components are finite.
    """
    known = np.isfinite(normal).all(axis=0) if valid is None else valid
    one = normal.dtype.type  # so that float32 stays float32
    with np.errstate(invalid="ignore"):
        steps = np.floor(np.where(known, normal, one(0)) * one(STEPS) + one(0.5))
    return np.ascontiguousarray(np.where(known, steps, one(FILL)), np.int16)


def decode(stored: NDArray[np.int16]) -> NDArray[np.float64]:
    """Unit vectors (xyz, y, x) of what `encode` made; NaN where there is none."""
    return np.where(stored == FILL, np.nan, stored / STEPS)

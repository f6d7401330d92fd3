"""The numbers of the two stages."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray


def scaled(raw: NDArray[np.uint16], *, exposure: float, gain: float) -> Mapping[str, Any]:
    """(polarisation, y, x) counts of one picture, scaled."""
    return {"value": (raw * (gain / exposure)).astype(np.float32)}


def summed(value: Mapping[int, NDArray[np.float32]]) -> Mapping[str, Any]:
    """(polarisation, y, x) of each frame, added up in order."""
    total = sum(picture.astype(np.float64) for picture in value.values())
    return {"total": np.asarray(total, np.float32)}

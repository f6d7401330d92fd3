"""From numbers to the counts of a picture file: 0 to 1 is black to white."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.appearance.colour import encode_srgb

WHITE_8, WHITE_16 = 255, 65535
LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Of linear Rec. 709."""


def counts_8(unit: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """To the nearest of 8 bits, halves up; what is beyond 0 to 1 is clipped, and NaN is black."""
    return _counts(unit, WHITE_8).astype(np.uint8)


def counts_16(unit: NDArray[np.floating[Any]]) -> NDArray[np.uint16]:
    """The same with 16 bits."""
    return _counts(unit, WHITE_16).astype(np.uint16)


def _counts(unit: NDArray[np.floating[Any]], white: int) -> NDArray[np.float64]:
    return np.floor(white * np.clip(np.nan_to_num(np.asarray(unit, np.float64)), 0, 1) + 0.5)


def srgb_8(linear: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """Linear light as sRGB's code in 8 bits."""
    return counts_8(encode_srgb(linear))


def srgb_16(linear: NDArray[np.floating[Any]]) -> NDArray[np.uint16]:
    """Linear light as sRGB's code in 16 bits."""
    return counts_16(encode_srgb(linear))


def shown_8(unit: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """8 bits for looking at, in the precision of the numbers themselves, halves to even; NaN is black."""
    return np.asarray(np.nan_to_num(np.round(np.clip(unit, 0, 1) * WHITE_8), nan=0.0).astype(np.uint8))


def shown_16(unit: NDArray[np.floating[Any]]) -> NDArray[np.uint16]:
    """The same with 16 bits."""
    return np.asarray(np.nan_to_num(np.round(np.clip(unit, 0, 1) * WHITE_16), nan=0.0).astype(np.uint16))

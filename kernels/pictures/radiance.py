"""Counts to radiance, pictures of one illumination to one: the equation is in `stages/stack.py`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lightstage.kernels.encodings import RADIANCE_BITS

_HALF_BIT = np.uint32(1 << (22 - RADIANCE_BITS))
_MASK = np.uint32(0xFFFFFFFF ^ ((1 << (23 - RADIANCE_BITS)) - 1))


def stack(
    signal: Mapping[int, NDArray[np.float32]],
    *,
    counts_per_radiance: float,
    exposure: Sequence[float] | None = None,
) -> Mapping[str, Any]:
    """Average the pictures of one illumination and band, and scale them to radiance.

    Args:
        signal: pictures (component, y, x) by frame, counts; NaN where not valid.
        counts_per_radiance: exposure x transmission x source x intensity.
        exposure: of each picture, relative to that exposure; None: all alike.

    Returns:
        `radiance` (component, y, x) float32: the pictures' sum over that of their exposures. A point that is not
        valid in one of the pictures is made of the others; NaN where none is valid.
    """
    shares = [1.0] * len(signal) if exposure is None else exposure
    first, *others = signal
    picture = signal[first]
    if not others:
        return {"radiance": _rounded(picture * np.float32(1 / (counts_per_radiance * shares[0])))}
    scale = np.float32(1 / counts_per_radiance)
    total, count = np.zeros((2, *picture.shape), np.float32)
    for frame, share in zip(signal, shares, strict=True):
        picture = signal[frame]
        seen = picture == picture
        np.add(total, picture, out=total, where=seen)
        count += seen * np.float32(share)
    with np.errstate(invalid="ignore", divide="ignore"):
        return {"radiance": _rounded((total / count * scale).astype(np.float32))}


@njit(nogil=True, cache=True)
def _rounded(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Round to RADIANCE_BITS of the mantissa, halves up; NaN stays NaN."""
    out = np.empty_like(values)
    source, target = values.reshape(-1), out.reshape(-1)
    bits, rounded = source.view(np.uint32), target.view(np.uint32)
    for i in range(source.size):
        if source[i] == source[i]:
            rounded[i] = (bits[i] + _HALF_BIT) & _MASK
        else:
            target[i] = np.float32(np.nan)
    return out

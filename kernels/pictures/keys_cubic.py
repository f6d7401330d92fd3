"""Cubic convolution with a = -1/2 (Keys 1981, doi:10.1109/TASSP.1981.1163711): weights of four neighbours in a row.

For a place at fraction t, 0 <= t < 1, behind the second of them,

    w0 = -t/2 + t^2 - t^3/2                 w1 = 1 - 5/2 t^2 + 3/2 t^3
    w2 = t/2 + 2 t^2 - 3/2 t^3              w3 = -t^2/2 + t^3/2

They add up to 1, and give back any parabola. The same polynomials stand here three times, because single precision
rounds them by how they are written: `weights`, each by itself, is what a loop over a row turns into vectors;
`weights_of_one` adds up to 1 to the last bit, so that what is constant stays so; `weights_and_slopes` shares powers
with the derivative. All compile into their callers.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

_HALF, _ONE, _1_5, _TWO, _2_5 = np.float32(0.5), np.float32(1), np.float32(1.5), np.float32(2), np.float32(2.5)
_FOUR, _4_5, _FIVE = np.float32(4), np.float32(4.5), np.float32(5)
_FLAGS = {"nogil": True, "cache": True, "error_model": "numpy", "fastmath": {"nsz"}, "inline": "always"}


@njit(**_FLAGS)
def weights(t: Any) -> Any:
    """(w0, w1, w2, w3)."""
    w0, w1 = ((_ONE - _HALF * t) * t - _HALF) * t, (_1_5 * t - _2_5) * t * t + _ONE
    w2, w3 = ((_TWO - _1_5 * t) * t + _HALF) * t, (_HALF * t - _HALF) * t * t
    return w0, w1, w2, w3


@njit(**_FLAGS)
def weights_of_one(t: Any) -> Any:
    """(w0, w1, w2, w3), whose sum is 1."""
    s = _ONE - t
    w0, w3 = -_HALF * t * s * s, -_HALF * s * t * t
    w1 = (_1_5 * t - _2_5) * t * t + _ONE
    return w0, w1, _ONE - w0 - w1 - w3, w3


@njit(**_FLAGS)
def weights_and_slopes(t: Any, into: NDArray[np.float32]) -> None:
    """Into (2, 4): the weights, and their derivatives by t."""
    t2 = t * t
    t3 = t2 * t
    into[0, 0] = -_HALF * t3 + t2 - _HALF * t
    into[0, 1] = _1_5 * t3 - _2_5 * t2 + _ONE
    into[0, 2] = -_1_5 * t3 + _TWO * t2 + _HALF * t
    into[0, 3] = _HALF * t3 - _HALF * t2
    into[1, 0] = -_1_5 * t2 + _TWO * t - _HALF
    into[1, 1] = _4_5 * t2 - _FIVE * t
    into[1, 2] = -_4_5 * t2 + _FOUR * t + _HALF
    into[1, 3] = _1_5 * t2 - t

"""What each light is driven with, per illumination.

Gradient axis a drives the light at unit position p with (p_a + 1) / 2, its complement with (1 - p_a) / 2, in
4096 steps of pulse width. The complement is 4095 minus the gradient's level, so a pair adds up exactly.
"""

import re

import numpy as np
from numpy.typing import NDArray

from lightstage.hw.errors import RigError

FULL = 4095


def levels(illumination: str, positions: NDArray[np.float64]) -> NDArray[np.int64]:
    """Drive levels (light,) from 0 to FULL.

    Args:
        illumination: C, X, Y, Z, Xc, Yc, Zc, L with a light number, T0 to T3, or O.
        positions: (light, xyz), the unit vectors that the weights are made from.

    Raises:
        RigError: the illumination is not known, or names a light that is not there.
    """
    count = len(positions)
    if illumination == "C":
        return np.full(count, FULL)
    if illumination == "O":
        return np.zeros(count, np.int64)
    if re.fullmatch(r"[XYZ]c?", illumination):
        # halves go up, so that a level does not depend on the last digit of a coordinate
        gradient = np.floor((positions[:, "XYZ".index(illumination[0])] + 1) / 2 * FULL + 0.5 + 1e-9).astype(
            np.int64
        )
        return FULL - gradient if illumination.endswith("c") else gradient
    if re.fullmatch(r"T[0-3]", illumination):
        return np.where(np.arange(count) % 4 == int(illumination[1]), FULL, 0)
    if re.fullmatch(r"L[0-9]+", illumination):
        number = int(illumination[1:])
        if number >= count:
            raise RigError(f"{illumination}: this rig has lights L00 to L{count - 1:02d}")
        return np.where(np.arange(count) == number, FULL, 0)
    raise RigError(f"the illumination '{illumination}' is not known; expected C, X Y Z Xc Yc Zc, L.., T0..T3 or O")


def weights(illumination: str, positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same as fractions of full drive, (light,) from 0 to 1."""
    return levels(illumination, positions) / FULL

"""What each light is driven with, per illumination.

Gradient axis a drives the light at unit position p with (p_a + 1) / 2, its complement with (1 - p_a) / 2, in
4096 steps of pulse width. The complement is 4095 minus the gradient's level, so a pair adds up exactly.
"""

import numpy as np
from numpy.typing import NDArray

from lightstage.hw import illuminations as names
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
    if not names.is_known(illumination):
        raise RigError(f"the illumination '{illumination}' is not known; expected {names.EXPECTED}")
    if names.is_gradient(illumination):
        # halves go up, so that a level does not depend on the last digit of a coordinate
        share = (positions[:, names.axis_number(illumination)] + 1) / 2
        gradient = np.floor(share * FULL + 0.5 + 1e-9).astype(np.int64)
        return FULL - gradient if names.is_complement(illumination) else gradient
    light = np.arange(count)
    if names.is_test(illumination):
        return np.where(light % names.TEST_PATTERNS == names.test_number(illumination), FULL, 0)
    if names.is_light(illumination):
        number = names.light_number(illumination)
        if number >= count:
            raise RigError(
                f"{illumination}: this rig has lights {names.light_name(0)} to {names.light_name(count - 1)}"
            )
        return np.where(light == number, FULL, 0)
    return np.full(count, FULL if illumination == names.CONSTANT else 0)


def weights(illumination: str, positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same as fractions of full drive, (light,) from 0 to 1."""
    return levels(illumination, positions) / FULL

"""Keys' cubic in its three ways against its definition, piece by piece."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.kernels.pictures.keys_cubic import weights, weights_and_slopes, weights_of_one

FRACTIONS = st.floats(0, 1, exclude_max=True, width=32)


def keys(distance: float) -> float:
    """Keys (1981), equation 15, a = -1/2."""
    s = abs(distance)
    if s < 1:
        return 1.5 * s**3 - 2.5 * s**2 + 1
    return -0.5 * s**3 + 2.5 * s**2 - 4 * s + 2 if s < 2 else 0.0


def test_half_way_by_hand() -> None:
    np.testing.assert_allclose(weights(np.float32(0.5)), [-1 / 16, 9 / 16, 9 / 16, -1 / 16])
    np.testing.assert_allclose(weights_of_one(np.float32(0)), [0, 1, 0, 0])


@given(FRACTIONS)
def test_all_three_are_the_definition(t: float) -> None:
    expected = [keys(t + 1), keys(t), keys(1 - t), keys(2 - t)]
    into = np.zeros((2, 4), np.float32)
    weights_and_slopes(np.float32(t), into)
    for found in (weights(np.float32(t)), weights_of_one(np.float32(t)), into[0]):
        np.testing.assert_allclose(found, expected, atol=3e-7)
    step = 1e-5
    slopes = [(keys(d + step) - keys(d - step)) / (2 * step) for d in (t + 1, t, t - 1, t - 2)]
    np.testing.assert_allclose(into[1], slopes, atol=1e-4)


@given(FRACTIONS, st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3))
def test_a_parabola_is_given_back(t: float, a: float, b: float, c: float) -> None:
    samples = np.array([a + b * x + c * x * x for x in (-1, 0, 1, 2)])
    assert weights(np.float32(t)) @ samples == pytest.approx(a + b * t + c * t * t, abs=1e-5)


@given(FRACTIONS)
def test_what_is_constant_stays_so(t: float) -> None:
    assert abs(sum(weights_of_one(np.float32(t))) - 1) <= np.finfo(np.float32).eps

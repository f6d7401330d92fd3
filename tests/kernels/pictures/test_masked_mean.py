"""Means over masks: by hand, and whatever lies outside."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.kernels.pictures import blurs
from lightstage.kernels.pictures.masked_mean import Blur, MaskedMean, ending, reflected


@pytest.mark.parametrize("blur", [reflected, ending, blurs.gaussian])
def test_a_constant_stays_up_to_its_edge_whatever_is_beyond(blur: Blur) -> None:
    known = np.zeros((20, 30), bool)
    known[5:15, 8:22] = True
    picture = np.where(known, 3.0, np.nan)
    picture.flags.writeable = known.flags.writeable = False
    found = MaskedMean(known, 2.0, blur=blur)(picture)
    np.testing.assert_allclose(found[known], 3.0, rtol=1e-5)


def test_two_pixels_by_hand() -> None:
    # one unknown between: each counts by the Gaussian of its distance
    known = np.array([[True, False, True]])
    found = MaskedMean(known, 0.8, blur=ending)(np.array([[1.0, 99.0, 2.0]]))
    near, far = 1.0, np.exp(-(2**2) / (2 * 0.8**2))
    np.testing.assert_allclose(found[0], [(near + 2 * far) / (near + far), 1.5, (2 * near + far) / (near + far)])


def test_channels_are_means_of_their_own_and_far_from_all_is_nothing() -> None:
    random = np.random.default_rng(0)
    picture, known = random.normal(size=(16, 18, 3)), random.random((16, 18)) > 0.5
    mean = MaskedMean(known, 1.5)
    np.testing.assert_allclose(mean(picture)[..., 1], mean(picture[..., 1]))
    lonely = np.zeros((5, 60), bool)
    lonely[:, 0] = True
    assert MaskedMean(lonely, 1.0)(np.ones((5, 60)))[2, 59] == 0


@given(st.floats(-5, 5), st.floats(-5, 5))
@settings(max_examples=20)
def test_it_is_linear(a: float, b: float) -> None:
    random = np.random.default_rng(1)
    one, other, known = random.normal(size=(9, 11)), random.normal(size=(9, 11)), random.random((9, 11)) > 0.3
    mean = MaskedMean(known, 1.2)
    np.testing.assert_allclose(mean(a * one + b * other), a * mean(one) + b * mean(other), atol=1e-9)


def test_it_is_computed_as_asked() -> None:
    known = np.ones((4, 4), bool)
    assert MaskedMean(known, 1.0, dtype=np.float32)(np.ones((4, 4), np.float32)).dtype == np.float32
    assert MaskedMean(known, 1.0)(np.ones((4, 4), np.float32)).dtype == np.float64

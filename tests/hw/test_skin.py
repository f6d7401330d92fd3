"""Skin's albedo: entries of the published tables, typed here, and what pigments do to it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.hw import skin

NONE = np.zeros(1)


def test_bloodless_white_skin_is_its_base() -> None:
    for nm, base in ((400, 0.80), (450, 0.815), (500, 0.83), (655, 0.871), (760, 0.88)):
        assert skin.albedo(NONE, NONE, nm)[0] == pytest.approx(base)


def test_melanin_is_a_power_of_the_wavelength() -> None:
    # Jacques: -3.33; half of 576 nm is 2^3.33 = 10.06 times as strong
    assert skin.absorption(576)[1] == 1
    assert skin.absorption(288)[1] == pytest.approx(10.056, abs=0.001)
    depth = -np.log(skin.albedo(np.array([0.3]), NONE, 434) / skin.albedo(NONE, NONE, 434))
    assert depth[0] == pytest.approx(0.3 * (576 / 434) ** 3.33)


@pytest.mark.parametrize(
    ("nm", "oxygenated", "free"),
    # Prahl (1999), cm-1 per mol/l
    [(420, 480360, 407560), (480, 26629, 14550), (540, 53236, 46592), (600, 3200, 14677), (620, 942, 6509)],
)
def test_blood_is_the_published_one_at_75_percent(nm: float, oxygenated: float, free: float) -> None:
    """Few entries of two digits: half too much on the steep edge at 600 nm, nearer elsewhere."""
    at_576 = 0.75 * 55540 + 0.25 * 40092
    expected = (0.75 * oxygenated + 0.25 * free) / at_576
    assert expected / 1.2 < skin.absorption(nm)[2] < expected * 1.5


def test_unfiltered_light_is_the_mean_of_the_six_bands() -> None:
    melanin, blood = np.array([[0.2, 0.4]]), np.array([[0.1, 0.05]])
    bands = [skin.albedo(melanin, blood, nm) for nm in (407, 434, 445, 497, 576, 655)]
    np.testing.assert_allclose(skin.albedo(melanin, blood, 0), np.mean(bands, axis=0))


def test_skin_is_darker_in_blue_and_blood_shows_at_576() -> None:
    pale, flushed = np.array([0.2]), np.array([0.6])
    assert skin.albedo(pale, pale, 434) < skin.albedo(pale, pale, 655)
    drop = [float(skin.albedo(pale, flushed, b)[0] / skin.albedo(pale, pale, b)[0]) for b in (576, 655)]
    assert drop[0] < 0.8 < drop[1]


@given(st.floats(0, 2), st.floats(0, 2), st.floats(0.01, 1), st.floats(390, 760))
def test_more_pigment_is_darker(melanin: float, blood: float, more: float, nm: float) -> None:
    m, h, d = (np.array([value]) for value in (melanin, blood, more))
    less = skin.albedo(m, h, nm)
    assert 0 < less[0] < 1
    assert skin.albedo(m + d, h, nm)[0] < less[0]
    assert skin.albedo(m, h + d, nm)[0] < less[0]

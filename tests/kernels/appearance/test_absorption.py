"""Pigments' absorption: published values, and means over pass bands worked out by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.kernels.appearance import absorption
from lightstage.kernels.errors import KernelError


def at(spectrum: np.ndarray, nm: float) -> float:
    return float(spectrum[np.argmin(np.abs(absorption.NM - nm))])


def test_published_values() -> None:
    # Prahl (1999): oxygenated and free haemoglobin at 576 and 650 nm
    assert at(absorption.haemoglobin(1.0), 576) == pytest.approx(55500)
    assert at(absorption.haemoglobin(0.0), 650) == pytest.approx(3750)
    # isosbestic at 500 nm: saturation does not matter
    assert at(absorption.haemoglobin(0.2), 500) == pytest.approx(at(absorption.haemoglobin(0.9), 500))
    # 150 g/l of 64500 g/mol, to the base e: 2.303 x 150 / 64500 x 55500 per cm
    assert at(absorption.blood_per_cm(1.0), 576) == pytest.approx(2.302585 * 150 / 64500 * 55500, rel=1e-5)
    assert at(absorption.melanin(), 576) == 1
    assert at(absorption.melanin(), 450) == pytest.approx((576 / 450) ** 3.33)


@given(st.floats(0, 1))
def test_saturation_mixes(share: float) -> None:
    mixed = share * absorption.haemoglobin(1.0) + (1 - share) * absorption.haemoglobin(0.0)
    np.testing.assert_allclose(absorption.haemoglobin(share), mixed)


def test_bands_by_hand() -> None:
    flat = absorption.pass_bands([{"centre_nm": 500, "width_nm": 20}], "flat")[0]
    assert flat.sum() == pytest.approx(1)
    inside = (absorption.NM > 490) & (absorption.NM < 510)
    np.testing.assert_allclose(flat[inside], 1 / 40)
    assert flat[~inside & (absorption.NM != 490) & (absorption.NM != 510)].max() == 0
    bell = absorption.pass_bands([{"centre_nm": 500, "width_nm": 20}])[0]
    assert at(bell, 490) == pytest.approx(at(bell, 500) / 2), "width at half maximum"
    # a curve of two points: the mean of a line is its middle
    curve = absorption.pass_bands([{"centre_nm": 0, "width_nm": None, "curve": [[600, 1.0], [500, 1.0]]}])[0]
    assert curve @ absorption.NM == pytest.approx(550, abs=0.01)
    assert absorption.pass_bands([]).shape == (0, len(absorption.NM))


def test_the_reference_is_a_mean() -> None:
    assert absorption.reference(absorption.NM) == pytest.approx(576)


def test_refusals() -> None:
    with pytest.raises(KernelError, match="550 nm; pigments need the pass band"):
        absorption.pass_bands([{"centre_nm": 550, "width_nm": None}])
    with pytest.raises(KernelError, match="reaches from 840 to 860 nm; absorption is tabulated from 380 to 780"):
        absorption.pass_bands([{"centre_nm": 850, "width_nm": 20}])

"""Pigments' absorption: published values, and means over pass bands worked out by hand."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import given
from hypothesis import strategies as st

from lightstage.kernels.appearance import absorption
from lightstage.kernels.errors import KernelError

SIX = tuple(zip((407, 434, 445, 497, 576, 655), (17, 17, 20, 16, 10, 15), strict=True))
PASSING = absorption.pass_bands([{"centre_nm": c, "width_nm": w} for c, w in SIX], "flat")


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


def test_a_curve_counts_as_it_is() -> None:
    flat = absorption.pass_bands([{"centre_nm": 500, "width_nm": 20}], "flat")
    box = [(489.99, 0), (490, 0.8), (510, 0.8), (510.01, 0)]
    curve = absorption.pass_bands([{"centre_nm": 500, "width_nm": None, "curve": box}])
    # the ends of the flat top count half, so that its width is right
    np.testing.assert_allclose(curve @ absorption.NM, 500, atol=1e-6)
    np.testing.assert_allclose(curve @ absorption.melanin(), flat @ absorption.melanin(), rtol=1e-3)
    gauss = absorption.pass_bands([{"centre_nm": 500, "width_nm": 20}], "gaussian")[0]
    half = absorption.NM[gauss >= gauss.max() / 2]
    assert np.ptp(half) == pytest.approx(20, abs=0.51)  # one sample


def test_the_coarse_table_is_dense_enough() -> None:
    # blood crosses its isosbestic points near 500, 530, 545, 570 and 584 nm whatever the saturation (Prahl 1999)
    bound, free = absorption.haemoglobin(1.0), absorption.haemoglobin(0.0)
    crossings = absorption.NM[1:][np.diff(np.sign(np.log(bound / free))) != 0]
    for known in (422, 452, 500, 530, 545, 570, 584):
        assert np.abs(crossings - known).min() <= 2, known  # the table's own steps there are 4 nm


@pytest.mark.data
def test_the_coarse_table_against_the_whole_one(data: Path) -> None:
    for name, saturation in (("oxyHemoglobin", 1.0), ("deoxyHemoglobin", 0.0)):
        stored = scipy.io.loadmat(data / "real" / "skin_spectra" / f"{name}.mat")
        nm, values = stored["wavelength"][0].astype(float), stored["data"][:, 0]
        whole = PASSING @ np.interp(absorption.NM, nm, values)
        # three digits, and lines over at most 10 nm where the curve is smooth
        np.testing.assert_allclose(PASSING @ absorption.haemoglobin(saturation), whole, rtol=0.02)

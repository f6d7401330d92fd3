"""Pass bands, and how coarse a table of absorption may be."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io

from lightstage.kernels.appearance import absorption

SIX = tuple(zip((407, 434, 445, 497, 576, 655), (17, 17, 20, 16, 10, 15), strict=True))
PASSING = absorption.pass_bands([{"centre_nm": c, "width_nm": w} for c, w in SIX], "flat")


def test_a_band_of_no_width_or_beyond_the_table_is_refused() -> None:
    with pytest.raises(ValueError, match=r"550 nm.*width_nm or its curve"):
        absorption.pass_bands([{"centre_nm": 550, "width_nm": None}])
    with pytest.raises(ValueError, match=r"850 nm reaches from 840 to 860 nm; .* 380 to 780 nm"):
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

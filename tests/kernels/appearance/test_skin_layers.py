"""Layered skin: one wavelength by hand, photons through a half space, and what no skin can be."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from lightstage.kernels.appearance import absorption
from lightstage.kernels.appearance.skin_layers import INTERNAL, VOLUMES, dermis, likeness, plausible
from tests.kernels.appearance import published_skin

BANDS = [407.0, 434.0, 445.0, 497.0, 576.0, 655.0]
PASSING = absorption.pass_bands([{"centre_nm": nm, "width_nm": 12} for nm in BANDS])


def narrow(nm: float) -> np.ndarray:
    """All of the weight at one sample."""
    return (nm == absorption.NM).astype(float)[None]


@pytest.mark.parametrize(("nm", "volume"), [(450.0, 0.01), (576.0, 0.03), (650.0, 0.002)])
def test_one_wavelength_by_hand(nm: float, volume: float) -> None:
    """Kubelka and Munk: r solves r^2 - 2 (1 + q) r + 1 = 0, and Saunderson's surface sends k of it back inside."""
    blood = 2.302585093 * 150 / 64500 * np.interp(nm, absorption.NM, absorption.haemoglobin(0.75))
    absorbs = volume * blood + 0.244 + 85.3 * np.exp(-(nm - 154) / 66.2)
    scatters = 46 * (nm / 500) ** -1.421
    q = 2 * absorbs / (0.75 * scatters - 0.25 * absorbs)
    r = min(np.roots([1, -2 * (1 + q), 1]).real)
    expected = (1 - INTERNAL) * r / (1 - INTERNAL * r)
    found = dermis(np.array([volume]), narrow(nm), saturation=0.75, vessel_radius_um=0)
    assert found[0, 0] == pytest.approx(expected, rel=1e-6)


@given(st.floats(0, 1), st.floats(0, 40))
@settings(max_examples=20)
@example(0.25, 2.2e-313)
def test_more_blood_is_darker_and_vessels_hide_some(saturation: float, radius: float) -> None:
    spread = dermis(VOLUMES, PASSING, saturation=saturation, vessel_radius_um=0)
    vessels = dermis(VOLUMES, PASSING, saturation=saturation, vessel_radius_um=radius)
    assert (np.diff(spread, axis=0) <= 1e-12).all()
    assert (vessels >= spread - 1e-12).all()
    assert ((spread > 0) & (spread < 1)).all()


@pytest.mark.parametrize(("volume", "off"), [(0.0, 0.02), (0.002, 0.02), (0.02, 0.02), (0.05, 0.06)])
def test_photons_agree(volume: float, off: float) -> None:
    """Followed through a half space with Fresnel's surface. 60,000 know a share to 0.4 %; Kubelka and Munk's law is
    for little absorption: 1 % off where it is a fiftieth of scattering, 5 % where it is a tenth or more."""
    reflected = dermis(np.array([volume]), published_skin.passing(), saturation=0.75, vessel_radius_um=0)[0]
    np.testing.assert_allclose(reflected, published_skin.skin(0.0, volume), rtol=off)


def test_brightness_is_no_likeness_and_grey_has_no_blood() -> None:
    narrow_bands = published_skin.passing()
    for gain in (0.3, 1.0):
        skin = likeness(gain * published_skin.skin(0.4, 0.02), narrow_bands, saturation=0.75, vessel_radius_um=0)
        assert skin.doubt is None
        assert skin.blood == pytest.approx(0.02, rel=0.1)  # a step of the table and half
        assert skin.misfit < 0.02
    grey = likeness(np.full(6, 0.4), PASSING, saturation=0.75, vessel_radius_um=15)
    assert grey.doubt is not None
    blue = likeness(np.array([0.5, 0.5, 0.45, 0.3, 0.1, 0.08]), PASSING, saturation=0.75, vessel_radius_um=15)
    assert "nearest that skin can have" in str(blue.doubt)


def test_plausible_skin_is_near_itself() -> None:
    spectra = plausible(PASSING, saturation=0.75, vessel_radius_um=15)
    assert spectra.shape[1] == 6
    found = likeness(spectra[37], PASSING, saturation=0.75, vessel_radius_um=15)
    assert found.angle_deg == pytest.approx(0, abs=1e-4)

"""From narrow bands to colour."""

import colour
import numpy as np
import pytest

from lightstage.kernels.appearance import absorption
from lightstage.kernels.appearance.colour import (
    NM,
    decode_srgb,
    encode_srgb,
    linear_srgb_matrix,
    observed,
    pass_band,
    spectrum_matrix,
    xyz_matrix,
)
from lightstage.kernels.errors import KernelError

SIX = (407.0, 434.0, 445.0, 497.0, 576.0, 655.0)
WIDTHS = (17.0, 17.0, 20.0, 16.0, 10.0, 15.0)


@pytest.mark.parametrize(("bands", "widths"), [(SIX, WIDTHS), ((0.0,), (None,)), ((576.0,), (10.0,))])
@pytest.mark.parametrize("illuminant", ["D65", "A"])
def test_grey_is_grey(bands: tuple[float, ...], widths: tuple[float | None, ...], illuminant: str) -> None:
    grey = np.full(len(bands), 0.18)
    np.testing.assert_allclose(linear_srgb_matrix(bands, widths, illuminant=illuminant) @ grey, 0.18, rtol=1e-5)
    assert (xyz_matrix(bands, widths, illuminant=illuminant) @ grey)[1] == pytest.approx(0.18, rel=1e-5)


def test_the_whitepoint_is_that_of_the_illuminant() -> None:
    white = xyz_matrix(SIX, WIDTHS).sum(axis=1)
    np.testing.assert_allclose(white[:2] / white.sum(), (0.3127, 0.3290), atol=2e-4)  # CIE 015, D65


def test_the_spectrum_has_the_measured_means() -> None:
    measured = np.array([0.2, 0.25, 0.3, 0.35, 0.4, 0.6])
    spectrum = spectrum_matrix(SIX, WIDTHS) @ measured
    passing = np.stack([pass_band(c, w) for c, w in zip(SIX, WIDTHS, strict=True)])
    np.testing.assert_allclose(passing @ spectrum, measured, atol=1e-5)
    assert np.ptp(spectrum[NM > 665]) < 0.01  # about constant beyond the last band


def test_a_smooth_spectrum_has_its_colour() -> None:
    # a logistic rise, as of skin, under the same observer; half a unit of CIEDE2000 is hardly visible
    reflectance = 0.25 + 0.35 / (1 + np.exp(-(NM - 590) / 40))
    passing = np.stack([pass_band(c, w) for c, w in zip(SIX, WIDTHS, strict=True)])
    xyz = xyz_matrix(SIX, WIDTHS) @ (passing @ reflectance)
    spectral = colour.SpectralDistribution(dict(zip(NM, reflectance, strict=True)))
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(spectral.shape)
    light = colour.SDS_ILLUMINANTS["D65"].copy().align(spectral.shape)
    exact = colour.sd_to_XYZ(spectral, observer, light, method="Integration") / 100
    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    off = colour.delta_E(colour.XYZ_to_Lab(xyz, white), colour.XYZ_to_Lab(exact, white), method="CIE 2000")
    assert off < 1.5


def _of(reflectance: np.ndarray, *, blood: bool) -> tuple[np.ndarray, np.ndarray]:
    """Lab of what the bands tell of a spectrum over NM, and of the spectrum itself, under D65."""
    passing = np.stack([pass_band(c, w) for c, w in zip(SIX, WIDTHS, strict=True)])
    found = spectrum_matrix(SIX, WIDTHS, blood=blood) @ (passing @ reflectance)
    seen = observed()
    white = colour.XYZ_to_xy(seen.sum(axis=1))
    return colour.XYZ_to_Lab(seen @ found, white), colour.XYZ_to_Lab(seen @ reflectance, white)


@pytest.mark.parametrize("blood", [0.2, 0.3, 0.6])
def test_skin_is_as_red_as_its_blood_makes_it(blood: float) -> None:
    """Between 497 and 655 nm the smoothest spectrum is a ramp, and that of blood is not: lips came out yellow."""
    taken = np.interp(NM, absorption.NM, absorption.haemoglobin(0.75))
    brown = np.interp(NM, absorption.NM, absorption.melanin())
    skin = 0.83 * np.exp(-0.2 * brown - blood * taken / taken[NM == 576])
    found, true = _of(skin, blood=True)
    plain, _ = _of(skin, blood=False)
    off, before = (float(colour.delta_E(lab, true, method="CIE 2000")) for lab in (found, plain))
    # a unit is what one sees side by side; far from medium skin the linear component falls short
    assert off < max(1.5, 0.6 * before)
    assert off < before


def test_pale_skin_is_not_made_red() -> None:
    brown = np.interp(NM, absorption.NM, absorption.melanin())
    found, true = _of(0.83 * np.exp(-0.2 * brown), blood=True)
    assert float(colour.delta_E(found, true, method="CIE 2000")) < 1.5


def test_codes_come_back() -> None:
    linear = np.linspace(0, 1, 257)
    np.testing.assert_allclose(decode_srgb(encode_srgb(linear)), linear, atol=1e-12)
    np.testing.assert_allclose(encode_srgb(np.array([0.5])), colour.cctf_encoding(0.5, function="sRGB"), atol=1e-4)
    np.testing.assert_allclose(encode_srgb(np.array([np.nan, -1, 2])), [0, 0, 1])


def test_an_unknown_illuminant_is_named() -> None:
    with pytest.raises(KernelError, match="'D66' is no CIE illuminant; there are A, B, C"):
        xyz_matrix(SIX, WIDTHS, illuminant="D66")

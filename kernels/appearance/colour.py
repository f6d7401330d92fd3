"""From narrow bands to colour: what an observer would see of a surface that was measured in a few bands.

The reflectance behind the measured bands is taken to be the smoothest that has their means, beside as much blood as
explains them better:

    r(l) = s(l) + a g(l),    g = eps_h exp(-M eps_m - H eps_h)

    minimise  integral s'^2 + (10 nm)^2 s''^2 dl + w a^2    such that    integral f_b r / integral f_b = r_b ,

f_b the pass band of b, g what a little more blood takes from the light that skin of medium colour reflects. Without
g, nothing tells that blood absorbs up to 590 nm and hardly beyond, and lips come out yellow. All is linear in the
measured values, so XYZ = M r_b with one matrix; beyond the first and the last band s is about constant. XYZ is that
of the CIE 1931 observer under an illuminant, Y of white 1; linear sRGB follows after adaptation to D65 (Bradford).
Six narrow bands do not tell all of a colour: measured skin comes out about 1 unit off (CIEDE2000; 2 without g), a
ColorChecker 3 with g and without (`python -m benchmarks.skin --only colours`).

Sources: van Trigt (1990), doi:10.1364/JOSAA.7.001891, for the smoothest reflectance; CIE 015:2018; IEC 61966-2-1.
The observer, the illuminants and the transforms are those of colour-science. The blood component is ours.
"""

import functools
from collections.abc import Sequence

import colour
import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.appearance import absorption
from lightstage.kernels.errors import KernelError

Array = NDArray[np.float64]
NM = np.arange(380.0, 781.0, 1.0)
"""Where spectra are sampled."""
_BENDING_NM = 10.0
_NARROWEST_NM = 2.0
_MELANIN, _BLOOD, _SATURATION = 0.5, 0.15, 0.75
"""M and H of skin of medium colour, optical depths at 576 nm, and the share of its blood that carries oxygen."""
_BLOOD_WEIGHT = 0.01
"""w. Anything from 0.001 to 0.02 does; without it (0) noise between 576 and 655 nm would be blood."""
_HELD = 1e6
"""Weight of the measured means beside the roughness: they are kept to a millionth."""


def observed(illuminant: str = "D65") -> Array:
    """(3, NM): XYZ under an illuminant = matrix @ reflectance over NM; Y of white is 1.

    Args:
        illuminant: a CIE illuminant by its name, such as D65, D50, A, E, FL2.

    Raises:
        KernelError: there is no such illuminant.
    """
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy()
    shape = colour.SpectralShape(NM[0], NM[-1], NM[1] - NM[0])
    if illuminant not in colour.SDS_ILLUMINANTS:
        known = ", ".join(sorted(colour.SDS_ILLUMINANTS))
        raise KernelError(f"'{illuminant}' is no CIE illuminant; there are {known}")
    light = np.asarray(colour.SDS_ILLUMINANTS[illuminant].copy().align(shape).values)
    seen = np.asarray(observer.align(shape).values) * light[:, None]
    return np.asarray(seen.T / seen[:, 1].sum())


def xyz_matrix(bands_nm: Sequence[float], widths_nm: Sequence[float | None], *, illuminant: str = "D65") -> Array:
    """M, (3, band): XYZ under an illuminant = M reflectance; Y of white is 1.

    Args:
        bands_nm: centres; 0 for unfiltered light.
        widths_nm: of flat pass bands; None where not known.
        illuminant: as of `observed`.
    """
    return observed(illuminant) @ spectrum_matrix(bands_nm, widths_nm)


def linear_srgb_matrix(
    bands_nm: Sequence[float], widths_nm: Sequence[float | None], *, illuminant: str = "D65"
) -> Array:
    """(3, band): linear sRGB under an illuminant, adapted to D65, = matrix @ reflectance; white is (1, 1, 1)."""
    xyz = xyz_matrix(bands_nm, widths_nm, illuminant=illuminant)
    space = colour.RGB_COLOURSPACES["sRGB"]
    target = colour.xy_to_XYZ(space.whitepoint)
    adapted = colour.adaptation.matrix_chromatic_adaptation_VonKries(xyz.sum(axis=1), target, transform="Bradford")
    rgb = np.asarray(space.matrix_XYZ_to_RGB) @ adapted @ xyz
    # the published matrix is rounded to four digits
    return np.asarray(rgb / rgb.sum(axis=1, keepdims=True))


@functools.cache
def _roughness() -> Array:
    slope = np.diff(np.eye(len(NM)), axis=0)
    bend = _BENDING_NM * np.diff(slope, axis=0)
    return np.asarray(slope.T @ slope + bend.T @ bend)


@functools.cache
def _blood() -> Array:
    """g over NM."""
    blood = np.interp(NM, absorption.NM, absorption.haemoglobin(_SATURATION))
    blood /= np.interp(absorption.REFERENCE_NM, NM, blood)
    brown = np.interp(NM, absorption.NM, absorption.melanin())
    return np.asarray(blood * np.exp(-_MELANIN * brown - _BLOOD * blood))


def spectrum_matrix(bands_nm: Sequence[float], widths_nm: Sequence[float | None], *, blood: bool = True) -> Array:
    """(NM, band): the reflectance that is taken to be behind the bands = matrix @ reflectance in them.

    One band gives a flat one. `blood` False leaves g out.
    """
    if len(bands_nm) == 1:
        return np.ones((len(NM), 1))
    passing = np.stack([pass_band(c, w) for c, w in zip(bands_nm, widths_nm, strict=True)])
    parts = np.eye(len(NM))
    cost = _roughness()
    if blood:
        parts = np.concatenate([parts, _blood()[:, None]], axis=1)
        cost = np.pad(cost, (0, 1))
        cost[-1, -1] = _BLOOD_WEIGHT
    seen = passing @ parts
    return np.asarray(parts @ np.linalg.solve(cost + _HELD * seen.T @ seen, _HELD * seen.T))


def pass_band(centre_nm: float, width_nm: float | None) -> Array:
    """A flat pass band over NM, its sum 1; a broad one for unfiltered light."""
    if centre_nm == 0:
        return np.full(len(NM), 1 / len(NM))
    half = max(width_nm or _NARROWEST_NM, _NARROWEST_NM) / 2
    passing = np.clip(half + 0.5 - np.abs(NM - centre_nm), 0, 1)
    if not passing.any():  # beyond the visible: what is nearest to it
        passing[np.argmin(np.abs(NM - centre_nm))] = 1
    return np.asarray(passing / passing.sum())


def encode_srgb(linear: NDArray[np.floating]) -> Array:
    """Linear to sRGB code values 0..1, clipped to what a screen can show; NaN is 0."""
    shown = np.clip(np.nan_to_num(np.asarray(linear, np.float64)), 0, 1)
    return np.asarray(np.where(shown <= 0.0031308, 12.92 * shown, 1.055 * shown ** (1 / 2.4) - 0.055))


def decode_srgb(encoded: NDArray[np.floating]) -> Array:
    """sRGB code values 0..1 to linear."""
    code = np.asarray(encoded, np.float64)
    return np.asarray(np.where(code <= 0.04045, code / 12.92, ((np.maximum(code, 0) + 0.055) / 1.055) ** 2.4))

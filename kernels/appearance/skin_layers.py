"""What layered skin reflects: melanin in the epidermis over a dermis that scatters, with blood in vessels.

    R(l) = exp(-(M eps_m(l) + offset)) T(r(l)),      T(r) = (1 - k) r / (1 - k r)
    r = 1 + q - sqrt(q^2 + 2 q),                     q = K / S_km = 2 mu_a / (3/4 mu_s' - 1/4 mu_a)
    mu_a = v C mu_blood + mu_0,                      C = (1 - exp(-2 mu_blood a)) / (2 mu_blood a)
    mu_0 = 0.244 + 85.3 exp(-(l - 154) / 66.2),      mu_s' = 46 (l / 500)^-1.421      (cm-1, l in nm)

M is the optical depth of the melanin at 576 nm, both ways together; v the part of the dermis' volume that is
blood. r is the reflectance of a half space (Kubelka and Munk 1931); the coefficients K and S_km in terms of
transport theory are those of van Gemert and Star (1987); k = 0.53 is what the surface throws back of diffuse
light from within at n = 1.4 (Egan 1973), by Saunderson (1942). C says that blood is in vessels of radius a: in
the Soret band light does not get through them, and their inside takes no part (Verkruysse et al. 1993; van Veen
et al. 2002, doi:10.1364/OL.27.000246). mu_0 and mu_s' are those of skin without blood and melanin (Jacques 1998;
2013, doi:10.1088/0031-9155/58/11/R37).

The layers do not end, melanin does not scatter, and light does not travel sideways.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.appearance import absorption

Array = NDArray[np.float64]
INTERNAL = 0.53
"""k."""
VOLUMES = np.concatenate([[0.0], np.geomspace(1e-4, 0.4, 127)])
"""v of the look-up table: nothing, then steps of 7 %."""
_LEAST_BLOOD = 4e-4
_MOST_MISFIT = 0.15


def dermis(volumes: Array, passing: Array, *, saturation: float, vessel_radius_um: float) -> Array:
    """Reflectance of a dermis under its surface, (volume, band), averaged over the pass bands.

    Args:
        volumes: v, parts of the volume. passing: (band, nm), from `absorption.pass_bands`.
        saturation: of the blood. vessel_radius_um: a; 0 for blood that is spread evenly.
    """
    blood = absorption.blood_per_cm(saturation)
    depth = 2 * blood * vessel_radius_um * 1e-4
    if depth.min() >= np.finfo(np.float64).tiny:  # below, numbers lose their digits, and blood is spread evenly
        blood = blood * -np.expm1(-depth) / depth
    return np.asarray(_seen(np.asarray(volumes)[:, None] * blood + _baseline_per_cm()) @ passing.T)


def _baseline_per_cm() -> Array:
    return np.asarray(0.244 + 85.3 * np.exp(-(absorption.NM - 154) / 66.2))


def _seen(absorbs: Array) -> Array:
    scatters = 46 * (absorption.NM / 500) ** -1.421
    # beyond mu_a = 3 mu_s' Kubelka and Munk's S would be negative; nothing comes back from there anyway
    ratio = 2 * absorbs / np.maximum(0.75 * scatters - 0.25 * absorbs, 0.01 * scatters)
    within = 1 + ratio - np.sqrt(ratio * ratio + 2 * ratio)
    return np.asarray((1 - INTERNAL) * within / (1 - INTERNAL * within))


@dataclass(frozen=True)
class Likeness:
    """How much a spectrum is like skin's."""

    blood: float
    """v that fits best."""
    misfit: float
    """RMS over the bands of the relative error of the fit."""
    angle_deg: float
    """Between the spectrum, as a vector, and the nearest of `plausible`."""

    @property
    def doubt(self) -> str | None:
        """Why it is not skin, or None. Measured skins (Vrhel et al. 1994): v 0.5 to 3 %, misfit to 0.14."""
        if self.misfit > _MOST_MISFIT:
            return (
                f"the subject's median spectrum is {self.misfit:.0%} off the nearest that skin can have; pigments "
                "of what is not skin mean nothing"
            )
        if self.blood < _LEAST_BLOOD:
            return (
                "no blood is seen in the subject's median spectrum, as on a grey target; pigments of what is not "
                "skin mean nothing"
            )
        return None


def likeness(spectrum: Array, passing: Array, *, saturation: float, vessel_radius_um: float) -> Likeness:
    """Compare a spectrum (band,) with what skin can have; brightness does not count."""
    logs = -np.log(dermis(VOLUMES, passing, saturation=saturation, vessel_radius_um=vessel_radius_um))
    rest = -np.log(spectrum) - logs
    rest -= rest.mean(axis=1, keepdims=True)
    slope = passing @ absorption.melanin()
    slope = slope - slope.mean()
    depth = np.maximum(rest @ slope / (slope @ slope), 0)
    misfit = np.sqrt(((rest - depth[:, None] * slope) ** 2).mean(axis=1))
    best = int(misfit.argmin())
    known = plausible(passing, saturation=saturation, vessel_radius_um=vessel_radius_um)
    cosine = known @ spectrum / np.linalg.norm(known, axis=1) / np.linalg.norm(spectrum)
    angle = float(np.degrees(np.arccos(np.clip(cosine.max(), -1, 1))))
    return Likeness(float(VOLUMES[best]), float(misfit[best]), angle)


def plausible(passing: Array, *, saturation: float, vessel_radius_um: float) -> Array:
    """Spectra of living skin by the model, (skin, band): M from 0 to 3, 0.2 to 10 % blood."""
    depths = np.concatenate([[0.0], np.geomspace(0.02, 3, 25)])
    below = dermis(np.geomspace(0.002, 0.1, 20), passing, saturation=saturation, vessel_radius_um=vessel_radius_um)
    above = np.exp(-depths[:, None] * (passing @ absorption.melanin()))
    return np.asarray((above[:, None] * below[None]).reshape(-1, passing.shape[0]))

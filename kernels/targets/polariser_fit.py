"""How each light's polariser is turned against the analyser of the cross camera (Dutta 2010, 3.2.1).

    I(t) = a + b cos^2(t - theta0) = m + c cos 2t + s sin 2t
    theta0 = atan2(s, c) / 2      q = sqrt(c^2 + s^2)      a = m - q      b = 2 q      residual = a / (a + b)

t is the setting of the light's polariser, I its highlight on a ball. At theta0 + 90 degrees the cross-polarised
highlight is least; `residual` of the greatest remains there. Least squares in (1, cos 2t, sin 2t), weighted by the
shot noise of the fitted model, not of the samples: weights from noisy samples would pull the fit down.

A ball of a dielectric keeps linear polarisation linear, and the residual is the polarisers' own. A metal delays one
component against the other, so that the residual rises towards grazing incidence, and theta0 is the metal's, not
the skin's (Fresnel; Ghosh et al. 2008 and Dutta 2010 take a plastic ball for this reason).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError

Array = NDArray[np.float64]
VAGUE_DEG = 0.5
"""Standard error of an angle from which it is too vague: half a degree off lets 0.008 % through, as much as a good
sheet polariser does by itself."""
GRAZING_DEG = 40.0
"""Incidence on a metal from which it shows: chromium leaves up to 0.6 % below, 4 % at 55, 18 % above 70 degrees."""


@dataclass(frozen=True)
class PolariserFit:
    """Per light, (light,); NaN for a light without a fit."""

    theta0_deg: Array
    """Of the brightest cross-polarised highlight, 0 to 180."""
    least_deg: Array
    """Where the polariser belongs, 0 to 180."""
    residual: Array
    """a / (a + b)."""
    a: Array
    b: Array
    theta0_se_deg: Array
    residual_se: Array
    chi2: Array
    """Per degree of freedom; NaN when there is none left."""
    used: NDArray[np.int64]
    """Samples that were not saturated."""
    grazing: NDArray[np.bool_]
    """A metal ball under grazing light: neither theta0 nor the residual is that of a dielectric."""
    notes: tuple[str, ...]


def fit_polarisers(
    intensities: Array,
    angles_deg: Array,
    *,
    saturated: NDArray[np.bool_] | None = None,
    incidence_deg: Array | None = None,
    ball: Literal["dielectric", "metal"] = "dielectric",
    electrons_per_count: float = 10.0,
    floor_counts2: float = 30.0,
) -> PolariserFit:
    """Fit every light.

    Args:
        intensities: (light, angle), highlight sums in counts; NaN where there is none.
        angles_deg: (angle,), or (light, angle).
        saturated: (light, angle), samples to leave out.
        incidence_deg: (light,), at the mirror point; needed to tell grazing light on a metal.
        floor_counts2: variance of a sum without light (`photometry.variance` at 0).

    Raises:
        KernelError: shapes disagree, or a light that is seen has fewer than three different usable angles.
    """
    count = len(intensities)
    if intensities.ndim != 2 or angles_deg.shape[-1] != intensities.shape[1]:
        raise KernelError(
            f"intensities {intensities.shape} and angles {angles_deg.shape} must share their last axis"
        )
    angles = np.broadcast_to(np.radians(angles_deg), intensities.shape)
    usable = np.isfinite(intensities)
    seen = usable.any(axis=1)
    if saturated is not None:
        usable &= ~saturated
    rows = np.full((count, 7), np.nan)
    for k in np.flatnonzero(seen):
        pick = usable[k]
        distinct = _distinct(angles[k, pick])
        if distinct < 3:
            raise KernelError(
                f"light {k} has {distinct} different polariser angles without saturation; three, apart by more "
                "than a degree and not by 180, are the least"
            )
        rows[k] = _fit(intensities[k, pick], angles[k, pick], electrons_per_count, floor_counts2)
    theta0, theta0_se, a, b, residual, residual_se, chi2 = rows.T
    grazing = np.zeros(count, np.bool_)
    notes = []
    if ball == "metal":
        if incidence_deg is None:
            notes.append("A metal ball without incidence angles: residuals may be the metal's; use a plastic ball.")
        else:
            grazing = seen & (incidence_deg > GRAZING_DEG)
    if grazing.any():
        names = ", ".join(str(k) for k in np.flatnonzero(grazing))
        notes.append(
            f"Lights {names} strike the metal ball at more than {GRAZING_DEG:g} degrees: their residual is partly "
            "the metal's and their angle not that of skin; use a plastic ball for them."
        )
    vague = np.flatnonzero(np.degrees(theta0_se) > VAGUE_DEG)
    if vague.size:
        names = ", ".join(str(k) for k in vague)
        notes.append(
            f"Lights {names} are too weak to place their polariser within {VAGUE_DEG:g} degrees; expose them "
            "longer."
        )
    return PolariserFit(
        theta0_deg=np.mod(np.mod(np.degrees(theta0), 180), 180),  # twice: the first of -1e-17 is 180
        least_deg=np.mod(np.degrees(theta0) + 90, 180),
        residual=residual,
        a=a,
        b=b,
        theta0_se_deg=np.degrees(theta0_se),
        residual_se=residual_se,
        chi2=chi2,
        used=usable.sum(axis=1),
        grazing=grazing,
        notes=tuple(notes),
    )


def _distinct(angles: Array) -> int:
    """How many directions there are among axes at `angles`, radians, that differ by more than a degree."""
    turned = np.sort(np.mod(angles, np.pi))
    if turned.size == 0:
        return 0
    gaps = np.diff(np.append(turned, turned[0] + np.pi))
    return max(1, int(np.count_nonzero(gaps > np.radians(1))))


def _fit(values: Array, angles: Array, electrons_per_count: float, floor: float) -> tuple[float, ...]:
    design = np.stack([np.ones_like(angles), np.cos(2 * angles), np.sin(2 * angles)], axis=1)
    spread = np.full(values.shape, floor + max(float(values.mean()), 0) / electrons_per_count)
    for _ in range(4):
        whitened = design / np.sqrt(spread)[:, None]
        covariance = np.linalg.inv(whitened.T @ whitened)
        m, c, s = covariance @ (whitened.T @ (values / np.sqrt(spread)))
        model = design @ (m, c, s)
        spread = floor + np.clip(model, 0, None) / electrons_per_count
    q = float(np.hypot(c, s))
    gradient = np.array([0, -s, c]) / (2 * q * q)
    share = (m - q) / (m + q)
    by_m, by_q = 2 * q / (m + q) ** 2, -2 * m / (m + q) ** 2
    slope = np.array([by_m, by_q * c / q, by_q * s / q])
    free = len(values) - 3
    chi2 = float(np.sum((values - model) ** 2 / spread)) / free if free else np.nan
    theta0 = float(np.arctan2(s, c) / 2)
    errors = [float(np.sqrt(g @ covariance @ g)) for g in (gradient, slope)]
    return theta0, errors[0], float(m - q), 2 * q, float(share), errors[1], chi2

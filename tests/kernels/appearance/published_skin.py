"""What skin reflects, without any kernel: printed numbers of its pigments, and photons followed through its layers.

Haemoglobin: S. Prahl, "Optical absorption of hemoglobin", Oregon Medical Laser Center (1999), cm-1 per mol/l.
Melanin, and skin without either: S. Jacques (1998), Oregon Medical Laser Center; (2013),
doi:10.1088/0031-9155/58/11/R37.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
HAEMOGLOBIN = {
    # nm: with oxygen, without
    450: (62816.0, 103292.0),
    500: (20932.8, 20862.0),
    540: (53236.0, 46592.0),
    560: (32613.2, 53788.0),
    576: (55540.0, 40092.0),
    600: (3200.0, 14677.2),
    650: (368.0, 3750.12),
}
AROUND_576 = (52021.0, 40144.0)
"""Their means over 571 to 581 nm, where optical depths of blood are told."""
NM = np.array(list(HAEMOGLOBIN), float)
MELANIN = np.array([2.2751, 1.6019, 1.2398, 1.0983, 1.0, 0.8729, 0.6687])
"""(nm / 576)^-3.33."""
BLOODLESS_PER_CM = np.array([1.2192, 0.7022, 0.4944, 0.4291, 0.3894, 0.3452, 0.2915])
"""Absorption of skin without blood and melanin: 0.244 + 85.3 exp(-(nm - 154) / 66.2)."""
SCATTERING_PER_CM = np.array([53.429, 46.0, 41.235, 39.158, 37.621, 35.501, 31.684])
"""Reduced: 46 (nm / 500)^-1.421."""
INDEX = 1.4
"""Of skin."""


def passing() -> Array:
    """(band, nm): bands of one wavelength each, where the numbers above are printed, on a grid of 380 to 780 nm."""
    out = np.zeros((len(NM), 801))
    out[np.arange(len(NM)), np.round((NM - 380) / 0.5).astype(int)] = 1
    return out


def blood(saturation: float) -> Array:
    """(band,): molar extinction, of which `saturation` carries oxygen."""
    oxygenated, free = np.array(list(HAEMOGLOBIN.values())).T
    return np.asarray(saturation * oxygenated + (1 - saturation) * free)


def blood_depth(saturation: float, *, unit: float = 0.75) -> Array:
    """(band,): optical depth of blood whose depth at 576 nm would be 1, were `unit` of it oxygenated."""
    return blood(saturation) / (unit * AROUND_576[0] + (1 - unit) * AROUND_576[1])


@cache
def _ways(photons: int = 60_000, longest: float = 700.0) -> tuple[Array, int]:
    """Lengths, in mean free ways, of the ways of photons that left a half space that only scatters; how many began.

    Light enters evenly from all sides; scattering is isotropic (with the reduced coefficient that is enough);
    at the surface Fresnel's reflectance throws back what comes from within.
    """
    generator = np.random.default_rng(1)
    depth, way = np.zeros(photons), np.zeros(photons)
    down = np.sqrt(generator.random(photons))  # Lambert
    left: list[Array] = []
    while depth.size:
        step = generator.exponential(size=depth.size)
        to_surface = np.where(down < 0, -depth / np.minimum(down, -1e-12), np.inf)
        out = to_surface < step
        way += np.minimum(step, to_surface)
        cosine = np.abs(down)
        sine = INDEX * np.sqrt(1 - cosine**2)
        beyond = np.sqrt(np.maximum(1 - sine**2, 0))
        s = ((INDEX * cosine - beyond) / (INDEX * cosine + beyond)) ** 2
        p = ((INDEX * beyond - cosine) / (INDEX * beyond + cosine)) ** 2
        thrown_back = generator.random(depth.size) < np.where(sine >= 1, 1.0, (s + p) / 2)
        gone = out & ~thrown_back
        left.append(way[gone])
        depth = np.where(out, 0.0, depth + step * down)
        # at the surface a mirrored photon goes on; elsewhere a scattered one goes anywhere
        down = np.where(out, -down, generator.uniform(-1, 1, depth.size))
        keep = ~gone & (way < longest)
        depth, way, down = depth[keep], way[keep], down[keep]
    return np.concatenate(left), photons


def half_space(absorbing: Array) -> Array:
    """Share of diffuse light that comes back from a half space whose absorption is so much of its scattering."""
    ways, photons = _ways()
    return np.array([np.exp(-a * ways).sum() / photons for a in np.atleast_1d(absorbing)])


def skin(melanin: float, volume: float, offset: float = 0.0, saturation: float = 0.75) -> Array:
    """(band,): melanin of that optical depth at 576 nm over a dermis of which `volume` is blood, by photons."""
    # 150 g of haemoglobin a litre, 64,500 g a mol; extinction is decadic
    absorbing = volume * 2.302585 * 150 / 64500 * blood(saturation) + BLOODLESS_PER_CM
    return np.asarray(half_space(absorbing / SCATTERING_PER_CM) * np.exp(-melanin * MELANIN - offset))

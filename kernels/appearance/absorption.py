"""How strongly melanin and blood absorb, averaged over the pass band of a filter.

    melanin        eps_m(l) = (l / 576 nm)^-3.33                                   relative to 576 nm
    haemoglobin    eps_h(l) = S e_oxy(l) + (1 - S) e_deoxy(l)                      cm-1 per mol/l
    whole blood    mu_a(l) = ln(10) x 150 g/l x eps_h(l) / 64500 g/mol            cm-1

S is the oxygen saturation. Between 400 and 450 nm both haemoglobins change severalfold within the width of a
filter, so the table is finer there, values between its entries are interpolated in the logarithm, and a band's
absorption is the mean over its pass band, never the value at its centre.

Sources: S. Prahl, "Optical absorption of hemoglobin", Oregon Medical Laser Center (1999), after W. B. Gratzer and
N. Kollias: a coarse selection of its entries, three digits. S. Jacques, "Optical absorption of melanin", Oregon
Medical Laser Center (1998): the power law. S. Jacques (2013), doi:10.1088/0031-9155/58/11/R37: blood and units.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError

Array = NDArray[np.float64]
PassBand = Literal["flat", "gaussian"]

REFERENCE_NM = 576.0
"""Where optical depths are told: the longer one of the two visible peaks of oxygenated blood."""
NM = np.arange(380.0, 780.5, 0.5)
"""Where spectra are sampled."""
MELANIN_POWER = -3.33
BLOOD_G_PER_L = 150.0
HAEMOGLOBIN_G_PER_MOL = 64500.0
_REFERENCE_HALF_NM = 5.0

# nm, oxyhaemoglobin, deoxyhaemoglobin: molar extinction, decadic, cm-1 per mol/l
_HAEMOGLOBIN = np.fromstring(
    """
     380 110000 145000    384 125000 149000    388 148000 160000    392 190000 180000    396 232000 202000
     400 266000 223000    404 309000 253000    408 422000 287000    412 500000 321000    414 524000 343000
     416 522000 364000    420 480000 408000    424 376000 461000    428 283000 501000    430 246000 529000
     432 214000 552000    434 165000 552000    436 133000 547000    438 119000 502000    440 103000 413000
     444  81400 283000    446  76300 237000    448  67000 173000    450  62800 103000    452  58900  62600
     454  53600  36200    460  44500  23400    470  33200  16200    480  26600  14600    490  23700  16700
     500  20900  20900    506  19900  23800    510  20000  25800    514  20400  28100    520  24200  31600
     526  32500  35900    530  40000  39000    536  49800  43600    540  53200  46600    546  49900  51300
     550  43000  53400    556  34500  54500    560  32600  53800    564  33900  50600    570  44500  45100
     574  53300  41700    576  55500  40100    578  54700  38500    580  50100  37000    584  34600  34300
     588  19800  31100    590  14400  28300    594   7680  22600    600   3200  14700    610   1510   9440
     620    942   6510    630    610   5150    640    442   4350    650    368   3750    660    320   3230
     670    294   2800    680    278   2410    690    276   2050    700    290   1790    710    314   1540
     720    348   1330    730    390   1100    740    446   1120    750    518   1410    760    586   1550
     770    650   1310    780    710   1080
    """,
    sep=" ",
).reshape(-1, 3)


def haemoglobin(saturation: float) -> Array:
    """Molar extinction of haemoglobin over NM, decadic, cm-1 per mol/l.

    Args:
        saturation: S, the share that carries oxygen, 0..1.
    """
    oxygenated, free = (np.exp(np.interp(NM, _HAEMOGLOBIN[:, 0], np.log(_HAEMOGLOBIN[:, i]))) for i in (1, 2))
    return np.asarray(saturation * oxygenated + (1 - saturation) * free)


def blood_per_cm(saturation: float) -> Array:
    """Absorption coefficient of whole blood over NM, cm-1."""
    return np.asarray(np.log(10) * BLOOD_G_PER_L / HAEMOGLOBIN_G_PER_MOL * haemoglobin(saturation))


def melanin() -> Array:
    """Absorption of melanin over NM, relative to REFERENCE_NM."""
    return np.asarray((NM / REFERENCE_NM) ** MELANIN_POWER)


def reference(spectrum: Array) -> float:
    """A spectrum over NM at REFERENCE_NM: its mean over 571 to 581 nm, so that no single entry decides it."""
    return float(spectrum[np.abs(NM - REFERENCE_NM) <= _REFERENCE_HALF_NM].mean())


def pass_bands(bands: Sequence[Mapping[str, Any]], shape: PassBand = "gaussian") -> Array:
    """Weights over NM of each band, (band, nm); a row adds up to 1.

    Args:
        bands: entries of a `bands` item: centre_nm, width_nm, and optionally curve, pairs of nm and transmission. A
            curve may hold the spectrum of the light as well; what counts is their product.
        shape: of a band without a curve: gaussian, width_nm at half maximum; or flat, width_nm wide.

    Raises:
        KernelError: a band has no width, or reaches beyond the table.
    """
    rows = [_pass_band(band, shape) for band in bands]
    return np.stack(rows) if rows else np.empty((0, len(NM)))


def _pass_band(band: Mapping[str, Any], shape: PassBand) -> Array:
    centre, width, curve = band["centre_nm"], band["width_nm"], band.get("curve")
    if curve:
        nm, value = np.array(sorted(map(tuple, curve)), np.float64).T
        first, last = nm[0], nm[-1]
        passing = np.interp(NM, nm, np.maximum(value, 0), left=0, right=0)
    elif width is None:
        raise KernelError(
            f"the bands item gives no width_nm for the band at {centre:g} nm; pigments need the pass band of each "
            "filter, its width_nm or its curve"
        )
    elif shape == "flat":
        first, last = centre - width / 2, centre + width / 2
        passing = np.clip(width / 2 + 0.25 - np.abs(NM - centre), 0, 0.5)
    else:
        first, last = centre - width / 2, centre + width / 2
        passing = np.exp(-4 * np.log(2) * ((NM - centre) / width) ** 2)
    if first < NM[0] or last > NM[-1] or not passing.any():
        raise KernelError(
            f"the band at {centre:g} nm reaches from {first:g} to {last:g} nm; absorption is tabulated from "
            f"{NM[0]:g} to {NM[-1]:g} nm"
        )
    return np.asarray(passing / passing.sum())

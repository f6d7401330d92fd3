"""What skin reflects, band by band: a base under two absorbers, melanin and haemoglobin.

    albedo = base exp(-(M eps_m + H eps_h))

M and H are optical depths at 576 nm, eps the absorption relative to 576 nm: melanin falls with the wavelength
to the power -3.33 (S. Jacques, Skin Optics, 1998), haemoglobin is read off a coarse table of blood at 75 %
oxygenation (after the extinction tabulated by S. Prahl, Oregon Medical Laser Center).
"""

import numpy as np
from numpy.typing import NDArray

_BLOOD_NM = (390, 407, 420, 434, 445, 460, 480, 497, 520, 540, 558, 576, 600, 620, 655, 700, 760)
_BLOOD = (3.9, 7.5, 8.1, 5.6, 2.9, 0.85, 0.55, 0.45, 0.52, 0.97, 0.76, 1.0, 0.17, 0.06, 0.024, 0.016, 0.02)
_WHITE_NM = (400, 500, 600, 700)
_WHITE = (0.80, 0.83, 0.86, 0.88)
BROADBAND_NM = (407.0, 434.0, 445.0, 497.0, 576.0, 655.0)


def absorption(band_nm: float) -> tuple[float, float, float]:
    """(base albedo, eps melanin, eps haemoglobin) at a wavelength."""
    base = float(np.interp(band_nm, _WHITE_NM, _WHITE))
    melanin = (band_nm / 576) ** -3.33
    blood = float(np.exp(np.interp(band_nm, _BLOOD_NM, np.log(_BLOOD))))
    return base, melanin, blood


def albedo(melanin: NDArray[np.float64], haemoglobin: NDArray[np.float64], band_nm: float) -> NDArray[np.float64]:
    """Diffuse albedo in a band, same shape as the maps; band 0 is unfiltered light."""
    if band_nm == 0:
        return np.asarray(np.mean([albedo(melanin, haemoglobin, band) for band in BROADBAND_NM], axis=0))
    base, eps_m, eps_h = absorption(band_nm)
    return np.asarray(base * np.exp(-(melanin * eps_m + haemoglobin * eps_h)))

"""Bands fused by their noise."""

from typing import Any

import numpy as np
import pytest

from lightstage.kernels.normals.gradient_methods import table
from lightstage.kernels.normals.spherical_gradients import solve
from lightstage.kernels.pictures.band_fusion import fuse
from tests.kernels.pictures.test_noise import band
from tests.scenes import STATIC, angle_deg, decoded, sphere_normals


def test_fusing_bands_beats_the_best_band() -> None:
    """Six equal bands: noise falls by sqrt(6) = 2.4; tolerance for the finite sample."""
    truth, mask = sphere_normals(64)
    bands = [band(seed, 4.0, STATIC) for seed in range(6)]
    how = table("difference", "", STATIC)

    def error(values: dict[str, Any]) -> float:
        return float(np.mean(angle_deg(decoded(solve([values[n] for n in how.pictures], how).normal), truth)[mask]))

    fused = dict(zip(STATIC, fuse([[b[n] for n in STATIC] for b in bands], STATIC), strict=True))
    assert error(bands[0]) / error(fused) == pytest.approx(np.sqrt(6), rel=0.1)


def test_a_noisy_band_is_given_little_weight_and_a_saturated_one_none() -> None:
    truth, mask = sphere_normals(64)
    good, poor = band(1, 4.0, STATIC), band(2, 0.05, STATIC)
    how = table("difference", "", STATIC)
    good_alone = dict(good)

    def error(values: dict[str, Any]) -> float:
        return float(np.mean(angle_deg(decoded(solve([values[n] for n in how.pictures], how).normal), truth)[mask]))

    fused = dict(zip(STATIC, fuse([[b[n] for n in STATIC] for b in (good, poor)], STATIC), strict=True))
    assert error(fused) < 1.02 * error(good_alone)
    good["X"][10:20, 10:20] = np.nan
    fused = dict(zip(STATIC, fuse([[b[n] for n in STATIC] for b in (good, poor)], STATIC), strict=True))
    assert np.isfinite(fused["X"]).all()

"""Polarisers turned by hand: Malus' law with known angles."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.polariser_fit import fit_polarisers

Array = NDArray[np.float64]
ANGLES = np.arange(0.0, 180.0, 22.5)


def malus(theta0_deg: Array, a: float, b: float, angles_deg: Array = ANGLES) -> Array:
    """(light, angle)."""
    return np.asarray(a + b * np.cos(np.radians(angles_deg - np.asarray(theta0_deg)[:, None])) ** 2)


def test_three_angles_by_hand() -> None:
    # a = 10, b = 90: 100 at theta0, 55 half way, 10 across
    found = fit_polarisers(np.array([[100.0, 55.0, 10.0]]), np.array([30.0, 75.0, 120.0]))
    assert found.theta0_deg[0] == pytest.approx(30)
    assert found.least_deg[0] == pytest.approx(120)
    assert (found.a[0], found.b[0]) == pytest.approx((10, 90))
    assert found.residual[0] == pytest.approx(0.1)
    assert np.isnan(found.chi2[0]), "three numbers for three unknowns"


@given(st.floats(0, 179.9), st.floats(1, 500), st.floats(200, 20000), st.floats(-40, 40))
@settings(max_examples=30)
def test_the_law_is_found_and_turns_with_the_dial(theta0: float, a: float, b: float, turn: float) -> None:
    samples = malus(np.array([theta0]), a, b)
    samples.flags.writeable = False
    found = fit_polarisers(samples, ANGLES)
    turned = fit_polarisers(samples, ANGLES + turn)

    def apart(x: float, y: float) -> float:
        return abs((x - y + 90) % 180 - 90)

    assert apart(found.theta0_deg[0], theta0) < 1e-6
    assert apart(turned.theta0_deg[0], theta0 + turn) < 1e-6
    assert found.residual[0] == pytest.approx(a / (a + b), rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_noise_ends_where_the_errors_say(seed: int) -> None:
    random = np.random.default_rng(seed)
    theta0 = random.uniform(10, 170, 400)
    clean = malus(theta0, 100.0, 4000.0)
    noisy = random.poisson(clean * 10) / 10 + random.normal(0, np.sqrt(30), clean.shape)
    found = fit_polarisers(noisy, ANGLES)
    # 400 lights tell a standard deviation to 3.5 %, a mean of chi^2 with five degrees to 3 %
    assert np.std((found.theta0_deg - theta0) / found.theta0_se_deg) == pytest.approx(1, abs=0.12)
    assert np.std((found.residual - 100 / 4100) / found.residual_se) == pytest.approx(1, abs=0.12)
    assert found.chi2.mean() == pytest.approx(1, abs=0.1)


def test_saturated_samples_are_left_out_and_unseen_lights_are_nan() -> None:
    samples = malus(np.array([20.0, 50.0]), 50.0, 900.0)
    saturated = samples > 850
    samples[saturated] = 850
    samples[1] = np.nan
    found = fit_polarisers(samples, ANGLES, saturated=saturated)
    assert found.theta0_deg[0] == pytest.approx(20)
    assert np.isnan(found.theta0_deg[1])
    assert found.used[1] == 0


def test_a_metal_ball_and_weak_light_are_noted() -> None:
    samples = malus(np.array([20.0, 50.0]), 5.0, 20000.0)
    found = fit_polarisers(samples, ANGLES, ball="metal", incidence_deg=np.array([10.0, 60.0]))
    np.testing.assert_array_equal(found.grazing, [False, True])
    assert "Lights 1 strike the metal ball at more than 40 degrees" in found.notes[0]
    assert "plastic ball" in fit_polarisers(samples, ANGLES, ball="metal").notes[0]
    weak = fit_polarisers(malus(np.array([20.0]), 5.0, 60.0), ANGLES, floor_counts2=900.0)
    assert "too weak to place their polariser" in weak.notes[0]


def test_refusals() -> None:
    with pytest.raises(KernelError, match="must share their last axis"):
        fit_polarisers(np.zeros((2, 4)), np.zeros(3))
    with pytest.raises(KernelError, match="light 0 has 2 different polariser angles"):
        fit_polarisers(np.ones((1, 3)), np.array([0.0, 90.0, 180.0]))

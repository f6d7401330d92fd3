"""Noise of known pictures, of several seeds."""

from typing import Any

import numpy as np
import pytest

from lightstage.kernels.pictures.noise import noise_model
from tests.scenes import ideal_gradient, sphere_normals


def band(seed: int, level: float, names: tuple[str, ...], shape: tuple[int, int] = (64, 64)) -> dict[str, Any]:
    """A band of known noise: variance 4e-4 + 0.01 r."""
    generator = np.random.default_rng(seed)
    truth, _ = sphere_normals(shape[0])
    clean = {n: ideal_gradient(truth, n, level) for n in names}
    return {
        n: (v + np.sqrt(4e-4 + 0.01 * v) * generator.standard_normal(shape)).astype(np.float32)
        for n, v in clean.items()
    }


def test_the_noise_is_measured_from_the_complement_residual() -> None:
    """24,576 differences of sums: the fit is known to about 5 %."""
    generator = np.random.default_rng(0)
    levels = np.linspace(0.2, 8, 64)[:, None] * np.ones((1, 64))
    clean = {"C": levels, **{a + c: levels / 2 for a in "XYZ" for c in ("", "c")}}
    noisy_band = {
        n: (v + np.sqrt(4e-3 + 0.01 * v) * generator.standard_normal(v.shape)).astype(np.float32)
        for n, v in clean.items()
    }
    alpha, beta = noise_model(noisy_band)
    assert beta == pytest.approx(0.01, rel=0.15)
    assert alpha == pytest.approx(4e-3, rel=0.5)


def test_the_noise_hangs_on_no_order_and_on_no_last_bit() -> None:
    """Counts are whole, so levels are tied; which of them come first tells nothing."""
    generator = np.random.default_rng(3)
    level = {"X": 390.0, "Xc": 10.0, "Y": 200.0, "Yc": 200.0, "C": 400.0}
    counts = {name: generator.poisson(mean, (64, 64)).astype(np.float32) for name, mean in level.items()}
    order = generator.permutation(64 * 64)
    shuffled = {name: picture.reshape(-1)[order].reshape(64, 64) for name, picture in counts.items()}
    moved = {name: np.nextafter(picture, np.float32(1e6)) for name, picture in counts.items()}
    fit = noise_model(counts)
    np.testing.assert_allclose(noise_model(shuffled), fit, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(noise_model(moved), fit, rtol=1e-5, atol=1e-5)


def test_one_level_tells_read_noise_from_shot_noise() -> None:
    """Variance 30 + 0.1 x 400 at one level: 3 alpha + 2 beta r alone could be all of either."""
    generator = np.random.default_rng(4)
    level = {name: 200.0 for a in "XYZ" for name in (a, a + "c")} | {"C": 400.0}
    pictures = {
        name: (mean + generator.normal(0, np.sqrt(30 + 0.1 * mean), (200, 200))).astype(np.float32)
        for name, mean in level.items()
    }
    alpha, beta = noise_model(pictures)
    assert alpha == pytest.approx(30, rel=0.1)
    assert beta == pytest.approx(0.1, rel=0.25)


def test_what_moves_or_saturates_does_not_pull_the_noise() -> None:
    """A twentieth of the pixels is off by 100 sigma: in the mean of squares that is 500 times the variance."""
    generator = np.random.default_rng(5)
    pictures = {name: (5 + generator.normal(0, 0.1, (64, 64))).astype(np.float32) for name in ("X", "Xc")}
    pictures["C"] = (10 + generator.normal(0, 0.1, (64, 64))).astype(np.float32)
    clean = noise_model(pictures)
    pictures["C"][::20] += 10
    pulled = noise_model(pictures)
    at = [alpha + 10 * beta for alpha, beta in (clean, pulled)]
    assert at[1] == pytest.approx(at[0], rel=0.35)

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


SEEDS = range(8)


def fits(level: dict[str, Any], read: float, shot: float) -> Any:
    """(seed, 2): alpha and beta of pictures with variance read + shot x level."""
    out = []
    for seed in SEEDS:
        generator = np.random.default_rng(seed)
        pictures = {}
        for name, mean in level.items():
            noise = np.sqrt(read + shot * mean) * generator.standard_normal(mean.shape)
            pictures[name] = (mean + noise).astype(np.float32)
        out.append(noise_model(pictures))
    return np.array(out)


def test_the_noise_is_measured_from_the_complement_residual() -> None:
    """24,576 differences of sums: one fit knows beta to 2.5 % and alpha to 10 %, eight to 1 and 4 %."""
    levels = np.linspace(0.2, 8, 64)[:, None] * np.ones((1, 64))
    fitted = fits({"C": levels, **{a + c: levels / 2 for a in "XYZ" for c in ("", "c")}}, 4e-3, 0.01)
    np.testing.assert_allclose(fitted.mean(axis=0), [4e-3, 0.01], rtol=0.08)
    assert (fitted.std(axis=0) < [0.2 * 4e-3, 0.05 * 0.01]).all()


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
    """Variance 30 + 0.1 x 400 at one level: 3 alpha + 2 beta r alone could be all of either. One fit knows them
    to 7 and 8 %, eight to 3."""
    half, whole = np.full((100, 100), 200.0), np.full((100, 100), 400.0)
    fitted = fits({name: half for a in "XYZ" for name in (a, a + "c")} | {"C": whole}, 30, 0.1)
    np.testing.assert_allclose(fitted.mean(axis=0), [30, 0.1], rtol=0.08)
    assert (fitted.std(axis=0) < [0.13 * 30, 0.16 * 0.1]).all()


@pytest.mark.parametrize("seed", range(4))
def test_what_moves_or_saturates_does_not_pull_the_noise(seed: int) -> None:
    """A twentieth of the pixels is off by 100 sigma: in the mean of squares that is 500 times the variance."""
    generator = np.random.default_rng(seed)
    pictures = {name: (5 + generator.normal(0, 0.1, (64, 64))).astype(np.float32) for name in ("X", "Xc")}
    pictures["C"] = (10 + generator.normal(0, 0.1, (64, 64))).astype(np.float32)
    clean = noise_model(pictures)
    pictures["C"][::20] += 10
    pulled = noise_model(pictures)
    before, after = (alpha + 10 * beta for alpha, beta in (clean, pulled))
    assert 1 <= after / before < 1.35  # a twentieth of doubt: 1.2 to 1.3

"""Non-local means: noise goes, a groove stays."""

import numpy as np
import pytest

from lightstage.kernels.normals.normal_filter import noise_factor, non_local_means
from lightstage.kernels.surface.integration import integrate
from tests.scenes import angle_deg


def test_the_filter_takes_noise_and_leaves_a_groove() -> None:
    x = np.mgrid[0:80, 0:80][1]
    tilt = np.where((x % 20) < 3, 0.5, 0.0)
    truth = np.stack([tilt, np.zeros_like(tilt), np.ones_like(tilt)], axis=-1)
    truth /= np.linalg.norm(truth, axis=2, keepdims=True)
    mask, flat, even = np.ones((80, 80), bool), (x % 20) > 8, np.ones((80, 80))
    factor, left, depth = [], [], []
    for seed in range(5):
        noisy = truth + np.random.default_rng(seed).normal(0, 0.03, truth.shape)
        noisy /= np.linalg.norm(noisy, axis=2, keepdims=True)
        out = non_local_means(noisy, even, mask)
        before, after = (angle_deg(np.moveaxis(n, 2, 0), np.moveaxis(truth, 2, 0)) for n in (noisy, out))
        factor.append(noise_factor(noisy, even, mask))
        left.append(after[flat].mean() / before[flat].mean())
        depth.append(out[..., 0][(x % 20) == 1].mean() / truth[0, 1, 0])
    assert np.mean(factor) == pytest.approx(0.03, rel=0.03)  # one is good to 1.3 %
    assert np.mean(left) < 0.3
    assert np.mean(depth) == pytest.approx(1, abs=0.02)


def test_small_pictures_do_not_crash_the_filter_or_the_integration() -> None:
    normal = np.zeros((5, 100, 3))
    normal[..., 2] = 1
    assert non_local_means(normal, np.ones((5, 100)), np.ones((5, 100), bool)).shape == normal.shape
    rays = np.dstack([np.zeros((40, 1)), np.linspace(-0.1, 0.1, 40)[:, None], np.ones((40, 1))])
    flat = np.zeros((40, 1, 3))
    flat[..., 2] = -1
    assert np.ptp(integrate(flat, np.ones((40, 1), bool), rays)) < 1e-6

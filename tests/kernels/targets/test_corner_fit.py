"""Corners of drawn boards, to hundredths of a pixel."""

import numpy as np
import pytest

from lightstage.kernels.targets.corner_fit import refine_corners
from tests.kernels.targets.drawn_board import board, tilted


@pytest.mark.parametrize(("turn_deg", "blur_px"), [(0.0, 0.5), (7.0, 0.5), (20.0, 1.0)])
def test_drawn_corners_are_found(turn_deg: float, blur_px: float) -> None:
    picture, true = board(tilted(turn_deg=turn_deg, at=(44.3, 30.6)), (5, 4), (110, 150), blur_px=blur_px)
    start = true + np.random.default_rng(0).uniform(-0.7, 0.7, true.shape)
    picture.flags.writeable = start.flags.writeable = False
    points, covariance, blur = refine_corners(picture, start)
    # edges are straight in a window, which perspective bends by hundredths
    assert np.abs(points - true).max() < 0.02
    np.testing.assert_allclose(blur, blur_px, rtol=0.15)
    assert (np.linalg.eigvalsh(covariance) > 0).all()


@pytest.mark.parametrize("seed", range(3))
def test_noise_moves_them_by_what_the_covariance_says(seed: int) -> None:
    picture, true = board(tilted(), (6, 5), (140, 160))
    random = np.random.default_rng(seed)
    off = []
    for _ in range(3):
        points, covariance, _ = refine_corners(picture + random.normal(0, 12.0, picture.shape), true)
        spread = np.sqrt(covariance[..., [0, 1], [0, 1]])
        off.append((points - true) / spread)
    # 180 numbers tell a standard deviation to 5 %
    assert np.std(off) == pytest.approx(1, abs=0.25)


def test_more_light_changes_nothing_and_moving_the_picture_moves_the_corners() -> None:
    picture, true = board(tilted(), (5, 4), (110, 130))
    plain, _, _ = refine_corners(picture, true)
    bright, _, _ = refine_corners(3 * picture + 100, true)
    np.testing.assert_allclose(bright, plain, atol=1e-5)
    moved, _, _ = refine_corners(np.roll(picture, (2, 3), axis=(0, 1)), true + np.array([3, 2]))
    np.testing.assert_allclose(moved - [3, 2], plain, atol=1e-3)


def test_a_corner_off_the_picture_is_nan() -> None:
    picture, true = board(tilted(), (5, 4), (110, 130))
    points, _, _ = refine_corners(picture, true - np.array([200.0, 0.0]))
    assert np.isnan(points).all()

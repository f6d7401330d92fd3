"""Cameras from boards that the test projects with a pinhole of its own."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.camera_matrix import fit_camera, other_camera
from tests.kernels.targets.mirror_ball import K, projected

Array = NDArray[np.float64]
LENS = (-0.08, 0.03, 0.0005, -0.0008, 0.0)
SQUARE_MM = 12.0
SHAPE = (309, 406)


def boards(seed: int, count: int, noise_px: float, tilt_deg: float = 30.0) -> list[Array]:
    """(row, column, xy) of boards of 9 x 6 inner corners, tilted to all sides."""
    random = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(9) - 4, np.arange(6) - 2.5)
    flat = SQUARE_MM * np.stack([x, y, np.zeros_like(x)], axis=-1)
    out = []
    for k in range(count):
        way = 2 * np.pi * k / count + random.normal() * 0.2
        turn = Rotation.from_rotvec(np.radians(tilt_deg) * np.array([np.cos(way), np.sin(way), 0.1])).as_matrix()
        shift = np.array([random.uniform(-20, 20), random.uniform(-15, 15), random.uniform(420, 520)])
        points = np.array([[projected(turn @ p + shift, LENS) for p in row] for row in flat])
        out.append(points + random.normal(0, noise_px, points.shape))
    return out


def test_exact_boards_give_the_camera() -> None:
    pictures = boards(0, 8, 1e-4)
    fit = fit_camera(pictures, square_mm=SQUARE_MM, shape=SHAPE)
    np.testing.assert_allclose(fit.matrix, K, atol=0.2)
    np.testing.assert_allclose(fit.distortion[:2], LENS[:2], atol=0.05)
    assert fit.rms_px < 3e-4


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_noise_ends_within_what_the_fit_says(seed: int) -> None:
    fit = fit_camera(boards(seed, 6, 0.03), square_mm=SQUARE_MM, shape=SHAPE)
    found = dict(zip(("fx", "fy", "cx", "cy"), fit.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], strict=True))
    true = {"fx": 1000.0, "fy": 1010.0, "cx": 202.0, "cy": 155.0}
    for name, value in true.items():
        # four sigma: one of 16000 normal numbers is beyond, and the aspect of 1.01 is five of its prior's sigmas
        assert abs(found[name] - value) < 4 * fit.deviation[name] + 5, name
    assert fit.rms_px == pytest.approx(0.03 * np.sqrt(2), rel=0.2)
    assert fit.residual.shape == (6, 6, 9, 2)


def test_a_board_twice_as_large_is_twice_as_far() -> None:
    pictures = boards(5, 3, 0.01)
    one, two = (fit_camera(pictures, square_mm=s, shape=SHAPE) for s in (SQUARE_MM, 2 * SQUARE_MM))
    np.testing.assert_allclose(two.matrix, one.matrix, rtol=1e-5)
    np.testing.assert_allclose(two.translations_mm, 2 * one.translations_mm, rtol=1e-5)


def test_the_other_camera_follows_from_the_homography() -> None:
    other = np.array([[980.0, 0, 190.0], [0, 985.0, 160.0], [0, 0, 1]])
    turn = Rotation.from_euler("xyz", [0.5, -0.8, 1.2], degrees=True).as_matrix()
    # a ray X of the reference frame is turn X in the other's: H leads from the other's picture to the reference's
    homography = K @ turn.T @ np.linalg.inv(other)
    matrix, rotation = other_camera(homography * -3.7, K)
    np.testing.assert_allclose(matrix, other, atol=1e-9)
    np.testing.assert_allclose(rotation, turn, atol=1e-12)


def test_refusals() -> None:
    with pytest.raises(KernelError, match="needs at least one picture of a checkerboard"):
        fit_camera([], square_mm=SQUARE_MM, shape=SHAPE)
    with pytest.raises(KernelError, match="boards of different sizes"):
        fit_camera([np.zeros((6, 9, 2)), np.zeros((5, 9, 2))], square_mm=SQUARE_MM, shape=SHAPE)
    with pytest.raises(KernelError, match="seen too nearly frontally; tilt it"):
        fit_camera(boards(6, 1, 0.05, tilt_deg=0.5), square_mm=SQUARE_MM, shape=SHAPE)

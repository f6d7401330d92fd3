"""Outlines of balls from the cone of rays that touch them, worked out in space."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.ball_conic import outline_of_points, sphere_centre
from tests.kernels.targets.mirror_ball import RADIUS_MM, K, projected

Array = NDArray[np.float64]
LENS = (-0.2, 0.08, 0.001, -0.002, 0.0)


def touching(centre_mm: Array, count: int = 90, distortion: tuple[float, ...] = (0.0,) * 5) -> Array:
    """(point, xy): the circle along which rays from the origin touch a ball, in the picture."""
    far = np.linalg.norm(centre_mm)
    axis = centre_mm / far
    middle, radius = centre_mm * (1 - RADIUS_MM**2 / far**2), RADIUS_MM * np.sqrt(1 - RADIUS_MM**2 / far**2)
    side = np.cross(axis, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    up = np.cross(axis, side)
    turn = np.linspace(0, 2 * np.pi, count, endpoint=False)
    circle = middle + radius * (np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * up)
    return np.array([projected(point, distortion) for point in circle])


def test_a_ball_on_the_axis_by_hand() -> None:
    # rays that touch it make an angle with the axis whose tangent is R / sqrt(d^2 - R^2): 3 / 4 for R = 3, d = 5
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    points = 100 + 75 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    matrix = np.array([[100.0, 0, 100], [0, 100, 100], [0, 0, 1]])
    found = outline_of_points(points, intrinsics=matrix)
    assert found.radius_px == pytest.approx(75, abs=1e-6)
    np.testing.assert_allclose(found.centre_px, [100, 100], atol=1e-6)
    np.testing.assert_allclose(sphere_centre(found.conic, matrix, 3.0), [0, 0, 5], atol=1e-6)


@given(st.floats(-120, 120), st.floats(-90, 90), st.floats(600, 1500))
@settings(max_examples=20)
def test_the_centre_of_a_ball_anywhere(x: float, y: float, z: float) -> None:
    centre = np.array([x, y, z])
    points = touching(centre)
    points.flags.writeable = False
    found = outline_of_points(points, intrinsics=K)
    np.testing.assert_allclose(sphere_centre(found.conic, K, RADIUS_MM), centre, atol=1e-4)
    assert found.rms_px < 1e-6
    assert 0.95 < found.seen <= 1


def test_a_lens_is_undone_on_the_points() -> None:
    centre = np.array([60.0, -40.0, 700.0])
    points = touching(centre, distortion=LENS)
    found = outline_of_points(points, intrinsics=K, distortion=np.array(LENS))
    np.testing.assert_allclose(sphere_centre(found.conic, K, RADIUS_MM), centre, atol=0.01)
    # the ring is as the picture has it
    apart = np.linalg.norm(points[:, None] - found.ring_px[None], axis=2).min(axis=1)
    assert apart.max() < 0.3, "half a step of the ring, and no more"


@pytest.mark.parametrize("seed", range(5))
def test_a_quarter_of_the_points_may_be_wrong(seed: int) -> None:
    random = np.random.default_rng(seed)
    centre = np.array([20.0, 30.0, 800.0])
    points = touching(centre) + random.normal(0, 0.05, (90, 2))
    wrong = random.choice(90, 22, replace=False)
    points[wrong] += random.uniform(3, 15, (22, 2))
    found = outline_of_points(points, intrinsics=K)
    assert not found.used[wrong].any()
    # 0.05 px over the root of 68 points: 0.006 px, and as much of the radius is 0.1 mm along the axis
    np.testing.assert_allclose(sphere_centre(found.conic, K, RADIUS_MM), centre, atol=0.8)
    np.testing.assert_allclose(
        found.centre_px, outline_of_points(touching(centre), intrinsics=K).centre_px, atol=0.05
    )


def test_without_a_camera_an_ellipse_will_do() -> None:
    turn = np.linspace(0, 2 * np.pi, 50, endpoint=False)
    points = np.array([80.0, 60.0]) + np.stack([30 * np.cos(turn), 24 * np.sin(turn)], axis=1)
    found = outline_of_points(points)
    np.testing.assert_allclose(found.centre_px, [80, 60], atol=1e-6)
    assert found.radius_px == pytest.approx(np.sqrt(30 * 24))


def test_refusals() -> None:
    with pytest.raises(KernelError, match="5 points do not make an outline; pick six or more"):
        outline_of_points(np.zeros((5, 2)))
    with pytest.raises(KernelError, match="cut by the frame"):
        outline_of_points(touching(np.array([0.0, 0.0, 800.0])), intrinsics=K, frame=(100, 100))

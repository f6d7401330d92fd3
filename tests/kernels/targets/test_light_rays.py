"""Rays to lights from highlights that the shortest way over the ball makes, and their meeting."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.kernels.targets.light_rays import (
    light_rays,
    on_stage,
    orthographic_directions,
    predicted_px,
    ray_sigma,
    to_world,
    triangulate,
)
from tests.kernels.targets.mirror_ball import RADIUS_MM, SHIFT_MM, TURN, K, mirror_point, scattered, shown

BALL = np.array([4.0, -6.0, 893.0])
LENS = (-0.2, 0.08, 0.001, -0.002, 0.01)


def test_an_orthographic_ball_by_hand() -> None:
    # the middle of the ball shows what is behind the camera, the rim what is behind the ball, and 45 degrees of the
    # normal turn the light by 90
    half = np.sqrt(0.5)
    at = np.array([[50.0, 40.0], [60.0, 40.0], [50.0 + 10 * half, 40.0], [50.0, 40.0 - 10 * half]])
    found = orthographic_directions(at, np.array([50.0, 40.0]), 10.0)
    np.testing.assert_allclose(found, [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, 1, 0]], atol=1e-12)


@pytest.mark.parametrize("distortion", [(0.0,) * 5, LENS])
def test_rays_lead_to_the_lights(distortion: tuple[float, ...]) -> None:
    lights = 790.0 * scattered(20, 3)
    at = shown(lights, BALL, distortion)
    point, direction = light_rays(at, BALL, RADIUS_MM, K, distortion=np.array(distortion))
    expected = np.array([mirror_point(light @ TURN.T + SHIFT_MM, BALL) for light in lights])
    # OpenCV undoes a distortion by five rounds of a fixed point
    np.testing.assert_allclose(point, expected, atol=1e-6 if distortion == (0.0,) * 5 else 0.02)
    world, way = to_world(point, direction, TURN, SHIFT_MM)
    there = on_stage(world, way, 790.0)
    np.testing.assert_allclose(there, lights, atol=1e-5 if distortion == (0.0,) * 5 else 3.0)


def test_a_prediction_is_what_the_shortest_way_shows() -> None:
    lights = 790.0 * scattered(20, 4)
    found = predicted_px(lights @ TURN.T + SHIFT_MM, BALL, RADIUS_MM, K)
    np.testing.assert_allclose(found, shown(lights, BALL), atol=1e-6)


def test_nan_stays_and_a_highlight_beyond_the_rim_is_taken_there() -> None:
    middle = (K @ BALL)[:2] / BALL[2]
    at = np.array([[np.nan, np.nan], middle + np.array([80.0, 0.0])])
    at.flags.writeable = False
    point, direction = light_rays(at, BALL, RADIUS_MM, K)
    assert np.isnan(point[0]).all()
    assert np.isnan(direction[0]).all()
    # beside the rim a ray goes on as it came
    view = np.linalg.inv(K) @ [*at[1], 1.0]
    np.testing.assert_allclose(direction[1] @ view / np.linalg.norm(view), 1.0, atol=0.1)


def test_an_error_of_a_highlight_turns_the_ray_by_what_it_says() -> None:
    lights = 790.0 * scattered(12, 5)
    at = shown(lights, BALL)
    sigma = np.full(12, 0.02)
    middle = (K @ BALL)[:2] / BALL[2]
    inward = (middle - at) / np.linalg.norm(middle - at, axis=1, keepdims=True)
    _, here = light_rays(at, BALL, RADIUS_MM, K)
    _, there = light_rays(at + 0.02 * inward, BALL, RADIUS_MM, K)
    turned = np.arccos(np.clip((here * there).sum(1), -1, 1))
    np.testing.assert_allclose(ray_sigma(at, sigma, BALL, RADIUS_MM, K), turned, rtol=1e-3)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_rays_that_meet_meet_there(seed: int) -> None:
    random = np.random.default_rng(seed)
    lights = random.normal(size=(5, 3)) * 500
    points = random.normal(size=(3, 5, 3)) * 30
    directions = lights - points
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    directions[1:, 4] = np.nan
    position, sigma = triangulate(points, directions, np.full((3, 5), 1e-3))
    np.testing.assert_allclose(position[:4], lights[:4], atol=1e-3)
    assert (sigma[:4] > 0).all()
    assert np.isnan(position[4]).all()

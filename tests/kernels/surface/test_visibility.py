"""Shadows: a wall, a ball, and the body below the picture."""

from typing import Any

import numpy as np

from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.kernels.surface.visibility import visible
from tests.scenes import light_places, near_ball


def test_a_wall_hides_the_lights_behind_it() -> None:
    """A step of 40 mm: its foot does not see a light low over the step, its top does."""
    _, _, _, camera = near_ball(*light_places(3))
    pinhole = Pinhole.of(camera, (96, 96))
    depth = np.full((96, 96), 850.0)
    depth[:, 60:] = 810.0
    lights = np.array([[790.0, 0, 200.0], [-790.0, 0, 200.0], [0, 0, 790.0]])
    points = pinhole.points(depth)
    foot, top, far = points[48, 57], points[48, 62], points[48, 5]
    seen = visible(np.stack([foot, top, far]), depth, pinhole, lights)
    np.testing.assert_array_equal(seen[:, 0], [0, 1, 0])
    np.testing.assert_array_equal(seen[:, 1], [1, 1, 1])
    np.testing.assert_array_equal(seen[:, 2], [1, 1, 1])


def test_light_passes_behind_a_ball(ball: tuple[Any, ...]) -> None:
    """A board behind and beside a ball sees a light that shines past the ball's back."""
    _, _, depth, camera, _ = ball
    pinhole = Pinhole.of(camera, depth.shape)
    point = np.array([[85.0, 0, -100.0]])
    lights = np.array([[-790.0, 0, -100.0], [-790.0, 0, 900.0]])
    seen = visible(point, depth, pinhole, lights)
    assert seen[0, 0] == 1  # 100 mm behind the centre of a ball of 80 mm radius
    assert seen[0, 1] == 0  # through the ball


def test_the_body_goes_on_below_the_picture() -> None:
    """A neck that widens downwards: its side does not see a light far below and behind the shoulder."""
    _, _, _, camera = near_ball(*light_places(3))
    pinhole = Pinhole.of(camera, (96, 96))
    depth = np.full((96, 96), np.nan)
    for row in range(30, 96):
        half = 14 + max(0, row - 70)
        depth[row, 48 - half : 48 + half] = 850.0
    points = pinhole.points(depth)[40, 58][None]
    below = np.array([[120.0, -700.0, 10.0]])
    assert visible(points, depth, pinhole, below)[0, 0] == 0
    assert visible(points, depth, pinhole, below * [1, -1, 1])[0, 0] == 1

"""A mirror ball in front of a pinhole camera, written out: the light takes the shortest way over it (Fermat)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from lightstage.kernels.surface.pinhole import Pinhole

Array = NDArray[np.float64]
K = np.array([[1000.0, 0.0, 202.0], [0.0, 1010.0, 155.0], [0.0, 0.0, 1.0]])
TURN = np.diag([1.0, -1.0, -1.0])
"""World to camera: x right, y and z the other way."""
SHIFT_MM = np.array([3.0, -2.0, 890.0])
RADIUS_MM = 38.1


class Scene(NamedTuple):
    """Lights on a stage, and where they show on the ball."""

    position_mm: Array
    """(light, xyz), world."""
    ball_mm: Array
    """(xyz), camera frame."""
    at_px: Array
    """(light, xy)."""


def camera(distortion: tuple[float, ...] = (0.0,) * 5) -> Pinhole:
    return Pinhole.of(
        {
            "size_px": [406, 309],
            "K": K.tolist(),
            "distortion": distortion,
            "world_to_camera": {"R": TURN.tolist(), "t_mm": SHIFT_MM.tolist()},
        },
        (309, 406),
    )


def projected(point_mm: Array, distortion: tuple[float, ...] = (0.0,) * 5) -> Array:
    """(xy): the image of a point of the camera's frame; Brown's distortion, k1 k2 p1 p2 k3."""
    k1, k2, p1, p2, k3 = distortion
    x, y = point_mm[0] / point_mm[2], point_mm[1] / point_mm[2]
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    x, y = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.array([K[0, 0] * x + K[0, 2], K[1, 1] * y + K[1, 2]])


def mirror_point(light_mm: Array, ball_mm: Array) -> Array:
    """Where the ball shows a light to a camera at the origin: the way there and on has no slope there."""
    to_camera = -ball_mm / np.linalg.norm(ball_mm)
    to_light = light_mm - ball_mm
    side = to_light - (to_light @ to_camera) * to_camera
    if np.linalg.norm(side) < 1e-9:
        return ball_mm + RADIUS_MM * to_camera
    side /= np.linalg.norm(side)
    end = np.arccos(to_light @ to_camera / np.linalg.norm(to_light))

    def slope(t: float) -> float:
        point = ball_mm + RADIUS_MM * (np.cos(t) * to_camera + np.sin(t) * side)
        moved = RADIUS_MM * (-np.sin(t) * to_camera + np.cos(t) * side)
        return float(
            point @ moved / np.linalg.norm(point) + (point - light_mm) @ moved / np.linalg.norm(point - light_mm)
        )

    t = brentq(slope, 0, end, xtol=1e-13)
    return ball_mm + RADIUS_MM * (np.cos(t) * to_camera + np.sin(t) * side)


def shown(position_mm: Array, ball_mm: Array, distortion: tuple[float, ...] = (0.0,) * 5) -> Array:
    """(light, xy) of lights in the world."""
    lights = position_mm @ TURN.T + SHIFT_MM
    return np.array([projected(mirror_point(light, ball_mm), distortion) for light in lights])


def scattered(count: int, seed: int, *, apart_deg: float = 18.0) -> Array:
    """(light, xyz): random unit vectors, no two nearer than that, none behind the ball, which hides it."""
    random = np.random.default_rng(seed)
    chosen: list[Array] = []
    while len(chosen) < count:
        unit = random.normal(size=3)
        unit /= np.linalg.norm(unit)
        if unit[2] > -0.75 and all(unit @ other < np.cos(np.radians(apart_deg)) for other in chosen):
            chosen.append(unit)
    return np.array(chosen)

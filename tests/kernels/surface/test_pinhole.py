"""The camera against a pinhole written out."""

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lightstage.kernels.errors import KernelError
from lightstage.kernels.surface.pinhole import Pinhole
from tests.scenes import light_places, near_ball


def test_the_camera_smaller_sees_the_same_rays() -> None:
    _, _, _, camera = near_ball(*light_places(3))
    pinhole = Pinhole.of(camera, (96, 96))
    half = pinhole.smaller(2)
    np.testing.assert_allclose(half.rays[5, 7], pinhole.rays[10:12, 14:16].mean(axis=(0, 1)), atol=1e-12)


LENS = (-0.2, 0.08, 0.001, -0.002, 0.01)
K = np.array([[300.0, 1.5, 39.0], [0, 310.0, 31.0], [0, 0, 1]])


def item(distortion: tuple[float, ...] = (0.0,) * 5) -> dict[str, Any]:
    turn = Rotation.from_euler("xyz", [3, -4, 2], degrees=True).as_matrix() @ np.diag([1.0, -1, -1])
    pose = {"R": turn.tolist(), "t_mm": [5.0, -8.0, 890.0]}
    return {"size_px": [80, 64], "K": K.tolist(), "distortion": distortion, "world_to_camera": pose}


@pytest.mark.parametrize("distortion", [(0.0,) * 5, LENS])
def test_points_are_where_a_pinhole_written_out_sees_them(distortion: tuple[float, ...]) -> None:
    camera = Pinhole.of(item(distortion), (64, 80))
    depth = np.full((64, 80), 700.0)
    world = camera.points(depth)
    pose = item()["world_to_camera"]
    x, y, z = np.moveaxis(world @ np.array(pose["R"]).T + pose["t_mm"], -1, 0)
    np.testing.assert_allclose(z, 700, atol=1e-9)
    x, y = x / z, y / z
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    bent = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    x, y = x * bent + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * bent + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    rows, columns = np.mgrid[:64, :80]
    np.testing.assert_allclose(K[0, 0] * x + K[0, 1] * y + K[0, 2], columns, atol=1e-4)
    np.testing.assert_allclose(K[1, 1] * y + K[1, 2], rows, atol=1e-4)


def test_there_and_back() -> None:
    camera = Pinhole.of(item(), (64, 80))
    world = np.random.default_rng(0).normal(size=(20, 3)) * 100
    there = camera.to_camera(world)
    np.testing.assert_allclose((there - camera.translation) @ camera.rotation, world, atol=1e-9)
    np.testing.assert_allclose(camera.to_camera(camera.centre), 0, atol=1e-9)
    np.testing.assert_array_equal(camera.matrix, K)
    assert camera.lens is None
    assert camera.focal == 305


def test_an_item_of_another_size_is_refused() -> None:
    with pytest.raises(KernelError, match="the camera item is for 80 x 64; the pictures are 10 x 12"):
        Pinhole.of(item(), (12, 10))

"""Where a part stands that hangs on the rest by a break alone."""

from typing import Any

import numpy as np
import pytest

from lightstage.kernels.normals.near_light import Lights, LightVectors
from lightstage.kernels.surface.integration import softest
from lightstage.kernels.surface.loose_parts import LooseParts
from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.kernels.surface.visibility import visible
from tests.scenes import LIGHT_MM, light_places

SIZE, CAMERA_MM = 120, 890.0
FRONT, BACK = (np.array([0.0, 38.0, 40.0]), 42.0), (np.array([0.0, -35.0, 0.0]), 62.0)
"""Centre and radius of two balls, mm: the one before and above the other, as a head before a chest."""


@pytest.fixture(scope="module")
def scene() -> tuple[Any, ...]:
    """Two balls under near lights with the shadows that they cast: what is measured, true normals and depth."""
    places, drive = light_places()
    lights = Lights(np.asarray(places), np.asarray(drive), np.ones(len(places)))
    focal = 0.42 * SIZE * CAMERA_MM / 85
    middle = (SIZE - 1) / 2
    camera = Pinhole.of(
        {
            "size_px": [SIZE, SIZE],
            "K": [[focal, 0, middle], [0, focal, middle], [0, 0, 1]],
            "distortion": [0, 0, 0, 0, 0],
            "world_to_camera": {"R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "t_mm": [0, 0, CAMERA_MM]},
        },
        (SIZE, SIZE),
    )
    rays = camera.rays @ camera.rotation
    depth, normal = np.full((SIZE, SIZE), np.inf), np.zeros((SIZE, SIZE, 3))
    for centre, radius in (FRONT, BACK):
        way = camera.centre - centre
        half, square = rays @ way, np.einsum("yxi,yxi->yx", rays, rays)
        root = half**2 - square * (way @ way - radius**2)
        hit = np.where(root > 0, (-half - np.sqrt(np.maximum(root, 0))) / square, np.inf)
        nearer = hit < depth
        at = camera.centre + np.where(nearer, hit, 0)[..., None] * rays
        normal[nearer] = ((at - centre) / radius)[nearer]
        depth = np.minimum(depth, hit)
    mask = np.isfinite(depth)
    depth = np.where(mask, depth, np.nan)
    points = camera.points(depth)[mask]
    way = lights.position[None] - points[:, None]
    distance = np.linalg.norm(way, axis=2)
    cosine = np.maximum(np.einsum("pi,pki->pk", normal[mask], way) / distance, 0)
    arrives = visible(points, depth, camera, lights.position) * cosine * (LIGHT_MM / distance) ** 2
    vector, constant = np.zeros((1, SIZE, SIZE, 3)), np.zeros((1, SIZE, SIZE))
    vector[0][mask], constant[0][mask] = arrives @ lights.drive, arrives.sum(axis=1)
    measured = LightVectors(
        vector / np.maximum(constant, 1e-9)[..., None], mask[None].astype(float), 1e6 * mask[None]
    )
    return measured, np.where(mask[..., None], normal @ camera.rotation.T, 0), depth, mask, camera, lights


def test_the_softest_shape_is_one_ball_against_the_other(scene: Any) -> None:
    _, normal, depth, mask, camera, _ = scene
    parts = LooseParts.of(normal, mask, camera, np.log(depth))
    front = mask & (np.linalg.norm(camera.points(depth) - FRONT[0], axis=2) < FRONT[1] + 0.1)
    first = parts.shapes[0]
    # almost a step: what each ball bends by is little beside what parts them
    assert abs(np.median(first[front]) - np.median(first[mask & ~front])) > 0.7
    assert np.ptp(first) == pytest.approx(1)


@pytest.mark.parametrize("wrong_mm", [-10.0, 10.0])
def test_light_puts_the_ball_back_in_its_place(scene: Any, wrong_mm: float) -> None:
    measured, normal, depth, mask, camera, lights = scene
    shape = LooseParts.of(normal, mask, camera, np.log(depth)).shapes[0]
    front = mask & (np.linalg.norm(camera.points(depth) - FRONT[0], axis=2) < FRONT[1] + 0.1)
    sign = np.sign(np.median(shape[front]) - np.median(shape[mask & ~front]))
    off = sign * wrong_mm / 850 * shape
    log_depth = np.where(mask, np.log(depth) + off, np.nan)
    parts = LooseParts.of(normal, mask, camera, log_depth)
    for _ in range(2):
        parts = parts.moved(log_depth, float(np.nanmedian(depth)), measured, camera, lights)
    left = 850 * (off + parts.swing())[mask]
    before = 850 * off[mask]
    # the integration's own pull towards where it began, and shadows of one pixel's width, leave some of it
    assert np.std(left) < 0.4 * np.std(before)


def test_a_right_place_is_kept(scene: Any) -> None:
    measured, normal, depth, mask, camera, lights = scene
    log_depth = np.log(depth)
    parts = LooseParts.of(normal, mask, camera, log_depth)
    moved = parts.moved(log_depth, float(np.nanmedian(depth)), measured, camera, lights)
    assert np.ptp(850 * moved.swing()[mask]) < 0.5


def test_a_step_between_two_planes_by_hand() -> None:
    """Two halves of a wall: no equation spans the step but those that bilateral weights have taken out."""
    rays = np.dstack([*np.meshgrid(np.linspace(-0.1, 0.1, 24), np.linspace(-0.1, 0.1, 20)), np.ones((20, 24))])
    normal = np.zeros((20, 24, 3))
    normal[..., 2] = -1
    log_depth = np.zeros((20, 24))
    log_depth[:, 12:] = 0.2
    shapes, energy, _ = softest(normal, np.ones((20, 24), bool), rays, log_depth, 2)
    first = shapes[0].reshape(20, 24)
    assert np.ptp(first[:, :12]) < 1e-3
    assert np.ptp(first[:, 12:]) < 1e-3
    # how much of the free mean is in it is open, but a step there is
    assert abs(first[0, 0] - first[0, -1]) > 0.02
    assert energy[0] < 1e-3 * energy[1]


def test_what_the_shapes_draw_of_a_difference_is_what_they_were_moved_by(scene: Any) -> None:
    _, normal, depth, mask, camera, _ = scene
    parts = LooseParts.of(normal, mask, camera, np.log(depth))
    wanted = np.tensordot([0.01, -0.02][: len(parts.shapes)], parts.shapes, 1)
    found = parts.drawn(np.where(mask, wanted + 0.3, np.nan))
    np.testing.assert_allclose(found[mask], wanted[mask], atol=1e-9)
    assert not parts.drawn(np.full(mask.shape, np.nan)).any()

"""Depth, shadows and bounces found together, on a ball whose lights are near."""

from typing import Any

import numpy as np
import pytest

from lightstage.kernels.normals import near_light, self_consistent
from lightstage.kernels.normals.near_light import invert, measure
from lightstage.kernels.surface.pinhole import Pinhole
from tests.kernels.near_rig import read
from tests.scenes import angle_deg


def test_near_ball_is_exact_without_noise_and_tells_its_distance(ball: tuple[Any, ...]) -> None:
    pictures, truth, depth, camera, lights = ball
    mask = np.isfinite(depth)
    pinhole = Pinhole.of(camera, mask.shape)
    found = self_consistent.solve(read(pictures), mask, pinhole, lights, model="near")
    inner = mask & (truth[2] > 0.2)
    normal = np.full((*mask.shape, 3), np.nan)
    normal[mask] = invert(read(pictures).vector[0][mask], pinhole.points(found.depth)[mask], lights).normal
    error = angle_deg(normal[inner].T, truth[:, inner])
    assert np.mean(error) < 0.02  # what the first-order equations of the depth leave
    assert found.distance_found
    assert abs(np.median((found.depth - depth)[inner])) < 0.5
    # uncorrected, the same pictures are half a degree off and more
    plain = read(pictures).vector[0][inner]
    assert np.mean(angle_deg(plain.T, truth[:, inner])) > 0.5


@pytest.mark.slow
def test_the_whole_solution_is_the_same_twice(ball: tuple[Any, ...]) -> None:
    pictures, _, depth, camera, lights = ball
    mask = np.isfinite(depth)
    pinhole = Pinhole.of(camera, mask.shape)
    one, two = (self_consistent.solve(read(pictures), mask, pinhole, lights, model="full") for _ in range(2))
    np.testing.assert_array_equal(one.depth, two.depth)
    np.testing.assert_array_equal(one.seen, two.seen)


def test_two_parts_of_a_subject_have_a_distance_each(ball: tuple[Any, ...]) -> None:
    """A ball behind a bar: what is left and right of it touches nothing, and each part tells its own distance."""
    pictures, truth, depth, camera, lights = ball
    mask = np.isfinite(depth)
    mask[:, 46:50] = False
    pinhole = Pinhole.of(camera, mask.shape)
    found = self_consistent.solve(read(pictures), mask, pinhole, lights, model="near")
    for half in (np.s_[:, :46], np.s_[:, 50:]):
        inside = mask[half] & (truth[2][half] > 0.3)
        assert abs(np.median((found.depth - depth)[half][inside])) < 2


@pytest.mark.slow
@pytest.mark.parametrize("albedos", [(0.6, 0.6, 0.6), (0.6,) * 6, (0.6, 0.61, 0.62)])
def test_bands_of_one_albedo_tell_nothing_of_bounces_and_change_nothing(
    ball: tuple[Any, ...], albedos: tuple[float, ...]
) -> None:
    """A white target: the line through its bands has no slope, only noise; `full` must not follow it."""
    pictures, truth, depth, camera, lights = ball
    generator = np.random.default_rng(0)
    top = max(p.max() for p in pictures.values())
    measured = measure(
        [
            {k: (a * v + generator.normal(0, 0.004 * top, v.shape)).astype(np.float32) for k, v in pictures.items()}
            for a in albedos
        ]
    )
    mask = np.isfinite(depth)
    pinhole = Pinhole.of(camera, mask.shape)
    inner = mask & (truth[2] > 0.2)
    errors = {}
    for model in ("near", "full"):
        found = self_consistent.solve(measured, mask, pinhole, lights, model=model)
        direct = np.ones(mask.shape)
        one = near_light.fused(found.without_bounces(measured, direct))
        normal = np.full((*mask.shape, 3), np.nan)
        points = pinhole.points(found.depth)[found.mask]
        normal[found.mask] = invert(one.vector[0][found.mask], points, lights, found.seen).normal
        errors[model] = np.nanmean(angle_deg(normal[inner].T, truth[:, inner]))
    # the noise of one map is 0.6 degrees; bands that differ by 1.5 % may add as much
    assert errors["full"] < errors["near"] + 0.6


def test_the_distance_is_where_the_residual_is_zero() -> None:
    found, told = self_consistent._root(lambda d: np.arctan((d - 803.217) / 40), 850.0, 400.0, 1300.0)
    assert told
    assert found == pytest.approx(803.217, abs=1e-6)

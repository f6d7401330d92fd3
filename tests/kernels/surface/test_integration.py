"""Depth from normals: planes and walls."""

from typing import Any

import numpy as np

from lightstage.kernels.surface.integration import integrate
from lightstage.kernels.surface.pinhole import Pinhole
from tests.scenes import light_places, near_ball


def test_integration_of_a_tilted_plane_is_exact() -> None:
    _, _, _, camera = near_ball(*light_places(3))
    pinhole = Pinhole.of(camera, (96, 96))
    n = np.array([0.3, -0.2, -1.0])
    n /= np.linalg.norm(n)
    depth = 800 * n[2] / (pinhole.rays @ n)
    mask = np.zeros((96, 96), bool)
    mask[5:90, 8:80] = True
    found = integrate(np.broadcast_to(n, (96, 96, 3)), mask, pinhole.rays, rounds=3)
    off = (found - np.log(depth))[mask]
    # the equation is of first order in the pixel's angle: 1e-3 rad here
    assert np.ptp(off) < 1e-3
    assert np.isnan(found[~mask]).all()


def test_integration_keeps_a_wall_behind_a_ball_flat(ball: tuple[Any, ...]) -> None:
    """The ball's rim is steep, and plain least squares lets the wall behind it pay; bilateral weights do not."""
    _, truth, depth, camera, _ = ball
    pinhole = Pinhole.of(camera, depth.shape)
    on_ball = np.isfinite(depth)
    n = np.where(on_ball, truth, np.array([0.0, 0, 1])[:, None, None]) * np.array([1, -1, -1])[:, None, None]
    off = {}
    for stiffness in (0.0, 2.0):
        found = integrate(
            n.transpose(1, 2, 0), np.ones(depth.shape, bool), pinhole.rays, rounds=25, stiffness=stiffness
        )
        off[stiffness] = float(np.std(found[~on_ball]))
    assert off[2.0] < 0.3 * off[0.0]


def test_depth_does_not_tell_where_its_solver_began(ball: tuple[Any, ...]) -> None:
    """So neither its last step nor its preconditioner, which hang on last bits, shows; 1e-8 is 8 nm of depth."""
    _, truth, depth, camera, _ = ball
    mask = np.isfinite(depth)
    normal = np.where(mask, truth, 0).transpose(1, 2, 0) * [1, -1, -1]
    rays = Pinhole.of(camera, mask.shape).rays
    start = np.where(mask, 7 + 0.05 * np.random.default_rng(0).normal(size=mask.shape), np.nan)
    one, other = integrate(normal, mask, rays), integrate(normal, mask, rays, start=start)
    np.testing.assert_allclose(other[mask], one[mask], rtol=0, atol=1e-8)

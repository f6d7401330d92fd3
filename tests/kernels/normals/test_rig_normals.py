"""Normals with the rig modelled, put together for a frame."""

from typing import Any

import numpy as np

from lightstage.kernels.normals.rig_normals import surface_normals
from lightstage.kernels.surface.pinhole import Pinhole
from tests.scenes import angle_deg


def test_normals_of_the_integrated_surface_are_those_of_the_ball(ball: tuple[Any, ...]) -> None:
    _, truth, depth, camera, _ = ball
    mask = np.isfinite(depth)
    found = surface_normals(Pinhole.of(camera, mask.shape).points(depth), mask)
    inner = mask & (truth[2] > 0.3)
    # differences over two pixels of a ball of 80 px: a chord is a third of a pixel's turn off at the steep side
    assert np.mean(angle_deg(found[inner].T, truth[:, inner])) < 0.2
    assert np.isnan(found[~mask]).all()

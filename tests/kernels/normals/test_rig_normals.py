"""Normals with the rig modelled, put together for a frame."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lightstage.kernels.normals import rig_normals, self_consistent
from lightstage.kernels.normals.near_light import Lights
from lightstage.kernels.normals.rig_normals import surface_normals
from lightstage.kernels.surface.pinhole import Pinhole
from tests.scenes import angle_deg, light_places, near_ball


@pytest.mark.parametrize("known", [True, False])
def test_a_distance_that_the_norm_does_not_tell_is_a_sentence(known: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    places, drive = light_places()
    pictures, _, depth, camera = near_ball(places, drive, size=48)
    rounds = self_consistent.solve

    def solve(*given: Any, **more: Any) -> self_consistent.Geometry:
        return replace(rounds(*given, **more), distance_found=known)

    monkeypatch.setattr(self_consistent, "solve", solve)
    scene = rig_normals.Scene(
        Pinhole.of(camera, depth.shape), Lights(places, drive, np.ones(len(places))), np.isfinite(depth)
    )
    band = {name: np.asarray(picture, np.float32) for name, picture in pictures.items()}
    out = rig_normals.solve([band], scene, model="near", as_one=False, filtered="none")
    assert list(out["stats"]) == ["distance_mm"]
    wanted = [] if known else ["the norm does not tell the distance; the stage's centre was taken"]
    assert [sentence.split(", so")[0] for sentence in out.get("warnings", [])] == wanted


def test_normals_of_the_integrated_surface_are_those_of_the_ball(ball: tuple[Any, ...]) -> None:
    _, truth, depth, camera, _ = ball
    mask = np.isfinite(depth)
    found = surface_normals(Pinhole.of(camera, mask.shape).points(depth), mask)
    inner = mask & (truth[2] > 0.3)
    # differences over two pixels of a ball of 80 px: a chord is a third of a pixel's turn off at the steep side
    assert np.mean(angle_deg(found[inner].T, truth[:, inner])) < 0.2
    assert np.isnan(found[~mask]).all()

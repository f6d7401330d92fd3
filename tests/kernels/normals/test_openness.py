"""How much light a point sees, from the length of its mean direction."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.kernels.normals import rig_normals
from lightstage.kernels.normals.near_light import Lights
from lightstage.kernels.normals.openness import share_of_light
from lightstage.kernels.surface.pinhole import Pinhole
from tests.scenes import light_places, near_ball


@pytest.mark.parametrize("cone_deg", [20.0, 45.0, 60.0, 80.0])
def test_a_cone_of_even_light_by_summing_it_up(cone_deg: float) -> None:
    """100,000 lights on a Fibonacci sphere: share and length of the mean direction within the cone."""
    height = 1 - 2 * (np.arange(100_000) + 0.5) / 100_000
    seen = np.where(height > np.cos(np.radians(cone_deg)), height, 0)
    whole = np.maximum(height, 0)
    length = (seen * height).sum() / seen.sum()  # across the axis all cancels
    open_length = (whole * height).sum() / whole.sum()
    assert share_of_light(np.ones(1), np.array([length - open_length]))[0] == pytest.approx(
        seen.sum() / whole.sum(), abs=1e-3
    )


@given(st.floats(0.01, 1), st.floats(-0.5, 0.5))
def test_no_excess_changes_nothing_and_a_share_stays_a_share(share: float, excess: float) -> None:
    at = np.array([share])
    assert share_of_light(at, np.zeros(1))[0] == pytest.approx(share, abs=1e-4)
    found = share_of_light(at, np.array([excess]))[0]
    assert 0 < found <= 1
    # more excess is a narrower cone
    assert share_of_light(at, np.array([excess + 0.01]))[0] <= found


@pytest.fixture(scope="module")
def pitted() -> tuple[Any, ...]:
    """A ball with pits in its middle, and the irradiance that is found with them and without."""
    places, drive = light_places()
    y, x = np.mgrid[0:96, 0:96]
    pit = np.hypot(x - 47.5, y - 47.5) < 12
    cone = np.where(pit, 55.0, 180.0)
    lights = Lights(np.asarray(places), np.asarray(drive), np.ones(len(places)))
    out = []
    for cones in (cone, None):
        pictures, _, depth, camera = near_ball(places, drive, cone_deg=cones)
        rig = rig_normals.Scene(Pinhole.of(camera, (96, 96)), lights, np.isfinite(depth))
        bands = [{name: picture.astype(np.float32) for name, picture in pictures.items()}]
        found = rig_normals.solve(bands, rig, model="near+shadows", as_one=False, filtered="none")
        out.append((found["irradiance"], pictures["C"]))
    return pit, *out


@pytest.mark.slow
def test_light_that_pits_take_is_measured_although_no_depth_map_shows_them(pitted: Any) -> None:
    pit, (found, true), (_, whole) = pitted
    inner = pit & (np.hypot(*(np.mgrid[0:96, 0:96] - 47.5)) < 9)
    assert np.median(true[inner] / whole[inner]) < 0.8  # so much is taken
    off = np.abs(np.log(found[inner] / true[inner]))
    # with 41 lights a cone holds some more or fewer of them from pixel to pixel; uncorrected it is 0.43
    assert np.median(off) < 0.12


def test_an_open_ball_keeps_its_irradiance(pitted: Any) -> None:
    _, (found, true), (plain, whole) = pitted
    rim = np.isfinite(plain) & (whole > 0.3 * np.nanmax(whole))
    # without noise what is left is the found surface's
    assert np.percentile(np.abs(np.log(plain / whole))[rim], 95) < 0.005
    y, x = np.mgrid[0:96, 0:96]
    away = rim & (np.hypot(x - 47.5, y - 47.5) > 20)
    assert np.percentile(np.abs(np.log(found / true))[away], 95) < 0.005

"""A whole stage from its highlights: lights scattered at random, shown by the shortest way over the ball."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.light_positions import Balls, Highlights, Layout, Refined, refine
from tests.kernels.targets.mirror_ball import RADIUS_MM, camera, scattered, shown

Array = NDArray[np.float64]
STAGE_MM = 790.0
COUNT = 24


def stage(seed: int, *, off_mm: float = 0.0) -> tuple[Array, Array]:
    """(light, xyz) places as planned, unit, and lights, mm: the stage is turned, shifted, a bit large."""
    random = np.random.default_rng(seed)
    places = scattered(COUNT, seed)
    turn = Rotation.from_rotvec(random.normal(size=3) * 0.03).as_matrix()
    lights = (STAGE_MM + 1.5) * places @ turn.T + random.normal(size=3)
    return places, lights + off_mm * random.normal(size=lights.shape)


def refined(at: Array, ball: Array, places: Array, sigma_px: float = 0.02) -> Refined:
    sigma = np.where(np.isfinite(at[:, 0]), sigma_px, np.nan)
    return refine(
        Highlights(at[None], sigma[None]), Balls(ball[None], RADIUS_MM), camera(), Layout(places, STAGE_MM)
    )


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_stage_as_built_is_found(seed: int) -> None:
    places, lights = stage(seed)
    ball = np.array([2.0, 5.0, 884.0])
    at = shown(lights, ball)
    at.flags.writeable = places.flags.writeable = False
    found = refined(at, ball, places)
    # radius and centre of the layout are believed to 3 and 2 mm; across the rays 2 mm are 0.15 degrees
    away = found.position_mm - lights
    unit = lights / np.linalg.norm(lights, axis=1, keepdims=True)
    across = away - (away * unit).sum(1, keepdims=True) * unit
    assert np.linalg.norm(across, axis=1).max() < 2.0
    assert np.abs((away * unit).sum(1)).max() < 4.0
    assert found.findings == ()
    np.testing.assert_array_equal(found.place, np.arange(COUNT))
    assert found.seen.all()


@pytest.mark.parametrize("seed", [4, 5])
def test_a_ball_that_was_placed_wrongly_is_put_right(seed: int) -> None:
    places, lights = stage(seed)
    ball = np.array([2.0, 5.0, 884.0])
    wrong = ball + np.array([0.1, -0.08, 0.3])
    found = refined(shown(lights, ball), wrong, places)
    assert np.linalg.norm(found.ball_mm[0, :2] - ball[:2]) < 0.05


def test_swapped_missing_and_displaced_lights_are_named() -> None:
    places, lights = stage(6)
    # of lights that the ball shows near its middle, where a highlight of 0.02 px is exact
    front = np.argsort(-places[:, 2])
    a, b, gone, off = (int(k) for k in front[:4])
    lights[[a, b]] = lights[[b, a]]
    lights[off] += 60.0 * np.cross(places[off], [0.0, 1.0, 0.0])
    ball = np.array([0.0, 0.0, 890.0])
    at = shown(lights, ball)
    at[gone] = np.nan
    found = refined(at, ball, places)
    kinds = {finding.kind: finding for finding in found.findings}
    assert set(kinds["swapped"].lights) == {a, b}
    assert kinds["off its place"].lights == (off,)
    assert kinds["dead"].lights == (gone,)
    assert f"L{min(a, b):02d} and L{max(a, b):02d} are swapped" in kinds["swapped"].sentence
    assert not found.seen[gone]
    assert np.linalg.norm(found.position_mm[gone] - lights[gone]) < 6.0, "placed by the layout"


def test_two_lights_at_one_place_and_one_at_none_are_named() -> None:
    places, lights = stage(7)
    front = np.argsort(-places[:, 2])
    double, other = int(front[0]), int(front[1])
    lights[double] = lights[other] + [4.0, 0.0, 0.0]
    found = refined(shown(lights, np.array([0.0, 0.0, 890.0])), np.array([0.0, 0.0, 890.0]), places)
    (same,) = [finding for finding in found.findings if finding.kind == "same place"]
    assert set(same.lights) == {double, other}
    nowhere = lights.copy()
    nowhere[double] = 790.0 * _between(places)
    found = refined(shown(nowhere, np.array([0.0, 0.0, 890.0])), np.array([0.0, 0.0, 890.0]), places)
    assert [f.lights for f in found.findings if f.kind == "no place"] == [(double,)]


def _between(places: Array) -> Array:
    """A direction before the ball that is far from every place."""
    random = np.random.default_rng(0)
    tries = random.normal(size=(4000, 3))
    tries /= np.linalg.norm(tries, axis=1, keepdims=True)
    tries = tries[tries[:, 2] > 0]
    return np.asarray(tries[(tries @ places.T).max(axis=1).argmin()])


def test_moving_everything_in_the_layouts_frame_turns_the_answer() -> None:
    places, lights = stage(8)
    ball = np.array([0.0, 0.0, 890.0])
    at = shown(lights, ball)
    turn = Rotation.from_euler("y", 0.4).as_matrix()
    plain, turned = refined(at, ball, places), refined(at, ball, places @ turn.T)
    np.testing.assert_allclose(turned.position_mm, plain.position_mm, atol=1e-3)
    np.testing.assert_allclose(turned.turn @ turn, plain.turn, atol=1e-5)


def test_refusals() -> None:
    places, lights = stage(9)
    ball = np.array([0.0, 0.0, 890.0])
    at = shown(lights, ball)
    few = np.full_like(at, np.nan)
    few[:3] = at[:3]
    with pytest.raises(KernelError, match="3 lights were seen on the ball; the layout needs four or more"):
        refined(few, ball, places)
    with pytest.raises(KernelError, match="the directions do not fit the layout"):
        refined(at, ball, np.random.default_rng(1).permutation(places))

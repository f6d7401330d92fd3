"""A surface under other lights: by hand, against a ball's closed form, environments, what is refused."""

from typing import Any

import numpy as np
import pytest

from lightstage.kernels.appearance.microfacets import at_normal_incidence
from lightstage.kernels.appearance.relighting import Lamps, Surface, compare, median_cut, relight
from lightstage.kernels.errors import KernelError
from lightstage.kernels.surface.pinhole import Pinhole
from tests.scenes import LIGHT_MM, light_places, near_ball

INDEX = 1.4


def ball(albedo: float = 1.0, gloss: float | None = None, channels: int = 1) -> tuple[Surface, Pinhole, Any]:
    places, drive = light_places()
    pictures, normal, depth, item = near_ball(places, drive)
    normal = np.moveaxis(normal, 0, 2)
    colour = np.where(np.isfinite(depth), albedo, np.nan)[..., None] * np.ones(channels)
    shiny = None if gloss is None else np.full(depth.shape, gloss)
    width = None if gloss is None else np.full(depth.shape, 0.3)
    return Surface(normal, depth, colour, shiny, width, INDEX), Pinhole.of(item, depth.shape), (places, pictures)


def near(places: Any, strength: Any) -> Lamps:
    return Lamps(places, strength, np.full(len(places), LIGHT_MM))


def test_all_lights_of_the_rig_are_its_constant_light() -> None:
    surface, camera, (places, pictures) = ball()
    out = relight(surface, camera, near(places, np.ones((len(places), 1))), bounces=0, shadows=False)
    known = np.isfinite(surface.depth_mm)
    np.testing.assert_allclose(out.diffuse[known, 0], pictures["C"][known], rtol=1e-5)  # float32
    assert np.isnan(out.diffuse[~known]).all()
    assert not out.specular[known].any()


def test_head_on_by_hand() -> None:
    """A light at the camera's side of the ball's pole: diffuse is the albedo; gloss is w R / (4 a^2) of it."""
    surface, camera, _ = ball(0.5, gloss=0.02)
    lamp = Lamps.distant(np.array([[0.0, 0.0, 1.0]]), np.array([[2.0]]))
    out = relight(surface, camera, lamp, bounces=0)
    assert out.diffuse[48, 48, 0] == pytest.approx(1.0, rel=0.001)  # half a pixel from the pole
    assert out.specular[48, 48, 0] == pytest.approx(2 * 0.02 / (4 * 0.3**2), rel=0.01)


def test_light_adds_and_channels_are_apart() -> None:
    surface, camera, (places, _) = ball(0.4, gloss=0.03, channels=3)
    strength = np.random.default_rng(0).random((len(places), 3))
    both = relight(surface, camera, near(places, strength))
    halves = [relight(surface, camera, near(places[part], strength[part])) for part in (np.s_[:20], np.s_[20:])]
    for name in ("diffuse", "specular"):
        total = sum(getattr(half, name) for half in halves)
        np.testing.assert_allclose(getattr(both, name), total, rtol=2e-4, atol=1e-6)  # float32 sums


def test_a_ball_casts_no_shadow_on_its_lit_side_and_bounces_nothing() -> None:
    surface, camera, _ = ball()
    lamp = Lamps.distant(np.array([[0.6, 0.0, 0.8]]), np.array([[1.0]]))
    plain = relight(surface, camera, lamp, bounces=0, shadows=False).diffuse[..., 0]
    cast = relight(surface, camera, lamp, bounces=3).diffuse[..., 0]
    lit = np.nan_to_num(plain) > 0.3  # nearer the terminator rays graze what is between two pixels
    np.testing.assert_allclose(cast[lit], plain[lit], atol=0.01)


def test_a_step_casts_a_shadow_where_geometry_says() -> None:
    """A wall 20 mm high, lit at 45 degrees from beyond it, shades 20 mm of the floor."""
    _, camera, _ = ball()
    x = np.arange(96)[None, :] * np.ones((96, 1))
    depth = np.where(x < 48, 870.0, 890.0)
    normal = np.zeros((96, 96, 3))
    normal[..., 2] = 1
    surface = Surface(normal, depth, np.ones((96, 96, 1)), None, None, INDEX)
    lamp = Lamps.distant(np.array([[-np.sqrt(0.5), 0.0, np.sqrt(0.5)]]), np.array([[1.0]]))
    row = relight(surface, camera, lamp, bounces=0).diffuse[48, :, 0] / np.sqrt(0.5)
    pixel_mm = 890 / camera.focal
    end = 48 + 20 / pixel_mm
    assert row[50 : int(end) - 5].max() < 0.1
    assert row[int(end) + 6 : 90].min() > 0.9
    assert row[:40].min() > 0.99


def test_a_white_furnace() -> None:
    """Under an environment of 1 a white ball without shadows shows 1."""
    surface, camera, _ = ball()
    directions, strength = median_cut(np.ones((32, 64, 1)), 512)
    out = relight(surface, camera, Lamps.distant(directions, strength), bounces=0, shadows=False).diffuse[..., 0]
    known = np.isfinite(surface.depth_mm)
    np.testing.assert_allclose(out[known], 1, atol=0.02)  # 512 lights for a hemisphere's integral


@pytest.mark.slow
def test_gloss_under_an_environment_of_one() -> None:
    surface, camera, _ = ball(gloss=at_normal_incidence(INDEX))
    directions, strength = median_cut(np.ones((64, 128, 1)), 2048)
    out = relight(surface, camera, Lamps.distant(directions, strength), bounces=0, shadows=False)
    # `sphere_response` has 0.62 of 0.04 for this width: Fresnel's 0.0278 less what masking takes
    assert out.specular[48, 48, 0] == pytest.approx(0.62 * 0.04, rel=0.05)


def test_environments_are_cut_into_equal_energy_that_adds_up() -> None:
    generator = np.random.default_rng(2)
    environment = generator.random((16, 32, 3)) ** 8
    directions, strength = median_cut(environment, 64)
    edges = np.sin(np.pi * (0.5 - np.arange(17) / 16))
    solid = (edges[:-1] - edges[1:]) * 2 * np.pi / 32
    np.testing.assert_allclose(strength.sum(axis=0), (environment * solid[:, None, None]).sum((0, 1)) / np.pi)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    assert len(directions) == 64


@pytest.mark.parametrize(
    ("row", "column", "wanted"), [(0, 5, (0, 1, 0)), (7, 15, (0, 0, 1)), (7, 7, (1, 0, 0)), (7, 23, (-1, 0, 0))]
)
def test_directions_are_those_of_openexr(row: int, column: int, wanted: tuple[float, float, float]) -> None:
    environment = np.zeros((16, 32, 1))
    environment[row, column] = 1
    directions, _ = median_cut(environment, 8)
    np.testing.assert_allclose(directions[0], wanted, atol=0.15)  # half a pixel of 11 degrees


def test_likeness_by_hand() -> None:
    truth = np.zeros((16, 16))
    truth[:, 8:] = 1
    mask = np.ones(truth.shape, bool)
    alike = compare(truth + 0.1, truth, mask)
    assert alike.psnr_db == pytest.approx(20)  # an error of a tenth of the peak
    assert alike.ssim < 1
    assert compare(truth, truth, mask).ssim == pytest.approx(1)
    mask[:, :8] = False
    outside = np.where(mask, truth + 0.1, 7)
    assert compare(outside, truth, mask).psnr_db == pytest.approx(20)


def test_what_cannot_be_relit_is_refused() -> None:
    surface, camera, (places, _) = ball()
    nothing = surface._replace(depth_mm=np.full_like(surface.depth_mm, np.nan))
    with pytest.raises(KernelError, match="nothing to relight"):
        relight(nothing, camera, near(places, np.ones((len(places), 1))))
    with pytest.raises(KernelError, match="environment"):
        median_cut(np.zeros((4, 8, 3)), 16)


def test_inputs_are_left_alone() -> None:
    surface, camera, (places, _) = ball(gloss=0.03)
    for array in surface[:5]:
        array.setflags(write=False)
    relight(surface, camera, near(places[:2], np.ones((2, 1))))

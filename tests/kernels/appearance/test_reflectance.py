"""Albedo from constant light: what is divided out, and what the error is."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from lightstage.kernels.appearance.reflectance import reflectance, white_radiance
from lightstage.kernels.surface.pinhole import Pinhole
from tests.scenes import LIGHT_MM, light_places, near_ball

NAN = np.nan
SEVEN = ("C", "X", "Y", "Z", "Xc", "Yc", "Zc")


def reflect(pictures: Sequence[Any], names: Sequence[str], **more: Any) -> Any:
    """The kernel on one band; no surface where none is given."""
    surface = {name: {0: more.pop(name)} if name in more else {} for name in ("irradiance", "normal", "depth_mm")}
    settings = {"shading": "none", "white": None, "camera": None, "bounced": "kept"} | more
    radiance = {(576.0, name): picture for name, picture in zip(names, pictures, strict=True)}
    return reflectance(radiance, **surface, **settings)


def test_by_hand() -> None:
    constant = np.array([[2.0, 4.0], [0.2, NAN]], np.float32)
    arrives = np.array([[4.0, 4.0], [0.1, 4.0]], np.float32)
    out = reflect([constant], ("C",), irradiance=arrives, shading="geometry", white=4.0)
    # 0.1 of 4 is too dark to divide by
    np.testing.assert_allclose(out["reflectance"][0], [[0.5, 1.0], [NAN, NAN]])
    np.testing.assert_allclose(out["shading"], [[1, 1], [NAN, 1]])


def test_a_pair_stands_for_constant_light() -> None:
    gradient = np.full((8, 8), 1.5, np.float32)
    complement = np.full((8, 8), 0.5, np.float32)
    out = reflect([gradient, complement], ("X", "Xc"), white=4.0)
    np.testing.assert_allclose(out["reflectance"], 0.5)


def test_the_error_is_that_of_the_noise() -> None:
    rng = np.random.default_rng(0)
    truth = np.linspace(0.2, 0.8, 120 * 120).reshape(120, 120)
    read, shot, open_light = 0.02**2, 0.004, 10.0
    radiance = open_light * truth
    share = dict(zip(SEVEN, (1, 0.7, 0.5, 0.9, 0.3, 0.5, 0.1), strict=True))
    clean = [share[name] * radiance for name in SEVEN]
    noisy = [(p + np.sqrt(read + shot * p) * rng.standard_normal(p.shape)).astype(np.float32) for p in clean]
    made = {}
    for names in (SEVEN, SEVEN[:1]):
        out = reflect(noisy[: len(names)], names, white=open_light)
        off = (out["reflectance"][0] - truth) / out["standard_error"][0]
        made[names] = float(out["standard_error"].mean())
        # the deviation of 14400 samples is good to 0.6 %; the noise model, fitted to the pictures, to some per cent
        assert off.std() == pytest.approx(1, abs=0.08)
    # three pairs, each as good as C but for read noise, halve the error
    assert made[SEVEN] == pytest.approx(made[SEVEN[:1]] / 2, rel=0.1)


def test_a_ball_under_near_lights_has_its_albedo() -> None:
    lights, drive = light_places()
    pictures, normals, depth, camera = near_ball(lights, drive)
    size = depth.shape[0]
    item = {"lights": [{"position_mm": list(p), "direction": None, "power": 1.0} for p in lights]}
    albedo = np.where(np.arange(size) // 12 % 2, 0.6, 0.3)[None, :] * np.ones((size, 1))
    albedo = np.where(np.isfinite(depth), albedo, NAN)
    direct = pictures["C"]
    radiance = [np.asarray(albedo * pictures[name], np.float32) for name in SEVEN]
    out = reflect(
        radiance,
        SEVEN,
        irradiance=np.asarray(np.where(np.isfinite(depth), direct, NAN), np.float32),
        normal=np.asarray(normals, np.float32),
        depth_mm=np.asarray(depth, np.float32),
        shading="geometry",
        white=white_radiance(item),
        camera=Pinhole.of(camera, depth.shape),
        bounced="removed",
    )
    known = np.isfinite(out["reflectance"][0])
    assert known.sum() > 0.9 * np.isfinite(depth).sum()
    # a convex body sees nothing of itself; neighbouring tiles, being flat and coarse, see a little of each other
    np.testing.assert_allclose(out["reflectance"][0][known], albedo[known], rtol=0.02)


def test_white_faces_the_camera_at_the_centre() -> None:
    ahead = {"position_mm": [0, 0, LIGHT_MM], "direction": None, "power": 2.0}
    beside = {"position_mm": [LIGHT_MM, 0, 0], "direction": None, "power": 1.0}
    behind = {"position_mm": [0, 0, -LIGHT_MM], "direction": None, "power": 1.0}
    assert white_radiance({"lights": [ahead, beside, behind]}) == pytest.approx(2)
    nearer = {**beside, "position_mm": [0, 0, LIGHT_MM / 2]}
    # mean distance 3/4: (3/4)^2 * 2 + (3/2)^2
    assert white_radiance({"lights": [ahead, nearer]}) == pytest.approx(2 * 0.75**2 + 1.5**2)


def test_smooth_takes_shading_and_keeps_what_is_fine() -> None:
    y, x = np.mgrid[0:90, 0:120]
    falls = 0.4 + 0.6 * x / 120
    fine = np.where((x + y) % 2, 0.5, 0.4)
    picture = np.asarray(3 * falls * fine, np.float32)
    out = reflect([picture], ("C",), shading="smooth", white=3.0)
    inner = (slice(20, 70), slice(25, 95))
    made = out["reflectance"][0][inner]
    rows = made.mean(axis=0)
    before = (falls * fine)[inner].mean(axis=0)
    # a blur with a quarter of the width bends a ramp of all of it flat by a good half at the sides
    assert np.ptp(rows) / rows.mean() < 0.75 * np.ptp(before) / before.mean()
    ratio = made[:, ::2].mean() / made[:, 1::2].mean()
    assert ratio == pytest.approx(picture[inner][:, ::2].mean() / picture[inner][:, 1::2].mean(), rel=0.01)


def test_without_a_scale_the_brightest_is_one() -> None:
    picture = np.linspace(1, 900, 64).reshape(8, 8).astype(np.float32)
    once = reflect([picture], ("C",))
    again = reflect([7 * picture], ("C",))
    assert 1 <= once["reflectance"].max() < 1.02
    np.testing.assert_allclose(again["reflectance"], once["reflectance"], rtol=1e-6)

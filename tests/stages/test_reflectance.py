"""Albedo from constant light: what is divided out, what the error is, what is refused."""

import numpy as np
import pytest

from lightstage.dag.stage import Grid, StageError
from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.stages.reflectance import STAGE, reflectance, white_radiance
from tests.scenes import LIGHT_MM, light_places, near_ball

NAN = np.nan
SEVEN = ("C", "X", "Y", "Z", "Xc", "Yc", "Zc")


def test_by_hand() -> None:
    constant = np.array([[2.0, 4.0], [0.2, NAN]], np.float32)
    arrives = np.array([[4.0, 4.0], [0.1, 4.0]], np.float32)
    out = reflectance(
        [constant], [arrives], [], [], names=("C",), shading="geometry", white=4.0, camera=None, bounced="kept"
    )
    # 0.1 of 4 is too dark to divide by
    np.testing.assert_allclose(out["reflectance"][0], [[0.5, 1.0], [NAN, NAN]])
    np.testing.assert_allclose(out["shading"], [[1, 1], [NAN, 1]])


def test_a_pair_stands_for_constant_light() -> None:
    gradient = np.full((8, 8), 1.5, np.float32)
    complement = np.full((8, 8), 0.5, np.float32)
    out = reflectance(
        [gradient, complement],
        [],
        [],
        [],
        names=("X", "Xc"),
        shading="none",
        white=4.0,
        camera=None,
        bounced="kept",
    )
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
        out = reflectance(
            noisy[: len(names)],
            [],
            [],
            [],
            names=names,
            shading="none",
            white=open_light,
            camera=None,
            bounced="kept",
        )
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
    out = reflectance(
        radiance,
        [np.asarray(np.where(np.isfinite(depth), direct, NAN), np.float32)],
        [np.asarray(normals, np.float32)],
        [np.asarray(depth, np.float32)],
        names=SEVEN,
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
    out = reflectance([picture], [], [], [], names=("C",), shading="smooth", white=3.0, camera=None, bounced="kept")
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
    once = reflectance([picture], [], [], [], names=("C",), shading="none", white=None, camera=None, bounced="kept")
    again = reflectance(
        [7 * picture], [], [], [], names=("C",), shading="none", white=None, camera=None, bounced="kept"
    )
    assert 1 <= once["reflectance"].max() < 1.02
    np.testing.assert_allclose(again["reflectance"], once["reflectance"], rtol=1e-6)


def grids(members: list[str], arrays: frozenset[str] = frozenset({"normal"})) -> list[Grid]:
    frames = list(range(len(members)))
    aligned = Grid(
        {"tracking": 1, "member": len(members), "band": 1, "component": 1, "y": 8, "x": 8},
        {
            "tracking": (("tracking",), [members.index("C") if "C" in members else 0]),
            "illumination": (("tracking", "member"), [members]),
            "frame": (("tracking", "member"), [frames]),
            "band": (("band",), [576.0]),
            "component": (("component",), ["diffuse"]),
        },
    )
    relief = Grid({"tracking": 1}, {"tracking": aligned.labels["tracking"]}, arrays=arrays)
    return [aligned, relief]


FACTS = {
    "frame_rate_hz": None,
    "items": ["bands", "lights"],
    "light_ids": ["L00"],
    "polarisation": ["parallel", "cross"],
}


def test_of_a_moving_subject_only_the_tracking_frame_counts() -> None:
    members = ["X", "C", "Xc", "C"]
    still = STAGE.arrange(grids(members), FACTS, STAGE.params())
    moving = STAGE.arrange(grids(members), {**FACTS, "frame_rate_hz": 60.0}, STAGE.params())
    assert still.groups[0].labels["names"] == ["X", "C", "Xc"]
    assert moving.groups[0].labels["names"] == ["C"]
    assert still.grid.attrs == {"shading": "smooth", "scale": "absolute", "component": "diffuse"}


def test_what_cannot_be_done_is_refused() -> None:
    with pytest.raises(StageError, match="shading: geometry needs a surface"):
        STAGE.arrange(grids(["C"]), FACTS, STAGE.params(shading="geometry"))
    with pytest.raises(StageError, match=r"reflectance needs constant light.* the session has L00 L01"):
        STAGE.arrange(grids(["L00", "L01"]), FACTS, STAGE.params())
    without = STAGE.arrange(grids(["C"]), {**FACTS, "items": []}, STAGE.params())
    assert without.grid.attrs["scale"] == "relative"
    alone = STAGE.arrange(grids(["C"]), {**FACTS, "polarisation": ["parallel"]}, STAGE.params())
    assert alone.grid.attrs["scale"] == "relative"  # half of the diffuse light, all of the gloss

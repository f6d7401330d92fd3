"""Specular intensity and roughness: a ball rendered here, noise and its predicted error."""

from typing import Any

import numpy as np
import pytest

from lightstage.kernels.appearance.gloss import Setup, gloss
from lightstage.kernels.normals.near_light import Lights
from lightstage.kernels.surface.pinhole import Pinhole
from tests.scenes import LIGHT_MM, STATIC, light_places, near_ball

INDEX, STRENGTH = 1.4, ((1.4 - 1) / (1.4 + 1)) ** 2
Array = np.ndarray[Any, Any]


def shiny_ball(alpha: Array | float, *, size: int = 96) -> tuple[dict[str, Array], dict[str, Any]]:
    """Specular pictures of a ball by illumination, and what `gloss` is told of it. GGX written out anew."""
    places, drive = light_places()
    _, normal, depth, item = near_ball(places, drive, size=size)
    camera = Pinhole.of(item, (size, size))
    points = camera.points(depth)
    n = np.moveaxis(normal, 0, 2)
    v = camera.centre - points
    v /= np.linalg.norm(v, axis=2, keepdims=True)
    pictures = {name: np.zeros((size, size)) for name in STATIC}
    for place, ideal in zip(places, drive, strict=True):
        way = place - points
        distance = np.linalg.norm(way, axis=2)
        light = way / distance[..., None]
        half = (light + v) / np.linalg.norm(light + v, axis=2, keepdims=True)
        nl, nv = np.maximum((n * light).sum(2), 0), (n * v).sum(2)
        nh, vh = (n * half).sum(2), (v * half).sum(2)
        spread = alpha**2 / (np.pi * (nh**2 * (np.square(alpha) - 1) + 1) ** 2)
        shadowing = 1.0
        for c in (nl, nv):
            tan2 = 1 / np.maximum(c, 1e-9) ** 2 - 1
            shadowing = shadowing * 2 / (1 + np.sqrt(1 + alpha**2 * tan2))
        sin_t = np.sqrt(1 - vh**2) / INDEX
        cos_t = np.sqrt(1 - sin_t**2)
        across = ((vh - INDEX * cos_t) / (vh + INDEX * cos_t)) ** 2
        along = ((INDEX * vh - cos_t) / (INDEX * vh + cos_t)) ** 2
        shown = np.pi * spread * shadowing * (across + along) / 2 / (4 * nv) * (LIGHT_MM / distance) ** 2
        shown = np.where(nl > 0, shown, 0)
        for name in STATIC:
            share = 1.0
            if name != "C":
                share = (1 + (-1 if name.endswith("c") else 1) * ideal["XYZ".index(name[0])]) / 2
            pictures[name] += share * np.nan_to_num(shown)
    told = {
        "specular_normal": {0: normal.astype(np.float32)},
        "normal": {0: normal.astype(np.float32)},
        "depth_mm": {0: depth.astype(np.float32)},
        "visibility": {},
        "setup": Setup(camera, Lights(places, drive, np.ones(len(places)))),
        "absolute": True,
        "index": INDEX,
        "spread": 0.15,
    }
    inside = np.isfinite(depth)
    return {name: np.where(inside, picture, np.nan) for name, picture in pictures.items()}, told


def call(pictures: dict[str, Array], told: dict[str, Any]) -> Any:
    return gloss({(576.0, name): np.asarray(pictures[name], np.float32) for name in STATIC}, **told)


@pytest.mark.parametrize("alpha", [0.15, 0.3, 0.5])
def test_a_ball_without_noise(alpha: float) -> None:
    pictures, told = shiny_ball(alpha)
    out = call(pictures, told)
    steep = told["normal"][0][2] > 0.3  # towards the rim a pixel is many normals in the model, and one here
    # the table of widths has steps of 17 %, interpolated; LIGHT_MM against the lights' mean distance is 0.1 %
    np.testing.assert_allclose(out["roughness"][steep], alpha, rtol=0.02)
    np.testing.assert_allclose(out["specular"][steep], STRENGTH, rtol=0.03)


def test_two_widths_and_two_strengths() -> None:
    size = 96
    alpha = np.where(np.arange(size) < size // 2, 0.2, 0.4)[None, :] * np.ones((size, 1))
    pictures, told = shiny_ball(alpha)
    half = np.where(np.arange(size) < size // 2, 1.0, 0.5)[:, None]
    out = call({name: half * picture for name, picture in pictures.items()}, told)
    left, right = np.s_[30:66, 24:38], np.s_[30:66, 58:72]
    # ten pixels from the border the narrowest neighbourhoods hardly look across
    assert np.median(out["roughness"][left]) == pytest.approx(0.2, rel=0.05)
    assert np.median(out["roughness"][right]) == pytest.approx(0.4, rel=0.05)
    strong, weak = out["specular"][24:44, 30:36], out["specular"][52:72, 30:36]
    assert np.median(weak) / np.median(strong) == pytest.approx(0.5, rel=0.03)


NOISES = range(6)


def test_noise_is_not_taken_for_roughness_and_is_predicted() -> None:
    pictures, facts = shiny_ball(0.25, size=64)
    level = 0.3 * np.nanmedian(pictures["C"])
    inner = facts["normal"][0][2] > 0.5
    width, intensity_off, width_off = [], [], []
    for seed in NOISES:
        generator = np.random.default_rng(seed)
        noisy = {
            name: p + level * generator.standard_normal(p.shape) * (0.7 if name != "C" else 1)
            for name, p in pictures.items()
        }
        out = call(noisy, facts)
        width.append(np.median(out["roughness"][inner]))
        intensity_off.append(((out["specular"][inner] - STRENGTH) / out["specular_error"][inner]).std())
        width_off.append(((out["roughness"][inner] - 0.25) / out["roughness_error"][inner]).std())
    # neighbourhoods overlap, so a picture's median is good to 5 %; without debiasing the norm it would be far below
    assert np.mean(width) == pytest.approx(0.25, rel=3 * 0.05 / np.sqrt(len(NOISES)))
    assert 0.85 < np.mean(intensity_off) < 1.15
    assert 0.8 < np.mean(width_off) < 1.2


def test_an_uncertain_surface_is_in_the_error_of_the_intensity() -> None:
    pictures, facts = shiny_ball(0.25, size=64)
    normal = facts["normal"][0].astype(float)
    inner = normal[2] > 0.5
    spread = []
    for seed in NOISES:
        tilted = normal + np.radians(1.5) * np.random.default_rng(seed).standard_normal(normal.shape)
        tilted /= np.linalg.norm(tilted, axis=0)
        out = call(pictures, facts | {"normal": {0: tilted.astype(np.float32)}})
        off = (out["specular"] - STRENGTH) / out["specular_error"]
        # a normal deviation's median is 0.6745; few pixels are far off, because a tilt bends their neighbours too
        spread.append(np.median(np.abs(off[inner])) / 0.6745)
    assert 0.85 < np.mean(spread) < 1.15


def test_bands_of_noise_count_less() -> None:
    pictures, told = shiny_ball(0.25)
    generator = np.random.default_rng(1)
    bands = [
        {name: p + level * generator.standard_normal(p.shape) for name, p in pictures.items()}
        for level in (0.01, 1.0)
    ]
    good = call(bands[0], told)
    both = gloss(
        {(nm, name): np.asarray(b[name], np.float32) for nm, b in enumerate(bands) for name in STATIC}, **told
    )
    inner = told["normal"][0][2] > 0.5
    alone = np.abs(good["specular"][inner] - STRENGTH).mean()
    assert np.abs(both["specular"][inner] - STRENGTH).mean() < 1.05 * alone


def test_without_a_surface_the_model_is_a_sphere_of_light() -> None:
    pictures, told = shiny_ball(0.3)
    told |= {"depth_mm": {}, "setup": None, "absolute": False}
    out = call(pictures, told)
    inner = told["normal"][0][2] > 0.5
    # 41 near lights are not a sphere: the norm is 0.01 higher, which is a fifth of the width
    assert np.median(out["roughness"][inner]) == pytest.approx(0.3, rel=0.25)
    assert np.nanpercentile(out["specular"], 99.5) == pytest.approx(1)


def test_inputs_are_left_alone() -> None:
    pictures, told = shiny_ball(0.3, size=48)
    given = {(576.0, name): np.asarray(pictures[name], np.float32) for name in STATIC}
    for array in [*given.values(), told["normal"][0], told["depth_mm"][0]]:
        array.setflags(write=False)
    before = {name: array.copy() for name, array in given.items()}
    gloss(given, **told)
    for name, array in given.items():
        np.testing.assert_array_equal(array, before[name])

"""Near light, depth, shadows and bounced light."""

from typing import Any

import numpy as np
import pytest

from lightstage.kernels import items
from lightstage.kernels.errors import KernelError
from lightstage.kernels.normals import near_light
from lightstage.kernels.normals.near_light import Lights, invert, measure
from lightstage.kernels.surface.pinhole import Pinhole
from tests.kernels.near_rig import lights_of, read
from tests.scenes import LIGHT_MM, STATIC, angle_deg, light_places, near_ball


def test_two_lights_by_hand() -> None:
    """Lights on +x and +z at distance 1: P = (n_x, 0, n_z) where both are up, so the direction is n itself."""
    lights = lights_of([[1, 0, 0], [0, 0, 1], [0, 1, 0]], np.eye(3)[[0, 2, 1]])
    vector = np.array([[0.6, 0.0, 0.8]])
    out = invert(vector, np.zeros((1, 3)), lights)
    np.testing.assert_allclose(out.normal, vector, atol=1e-7)
    np.testing.assert_allclose(out.direct, [1.4])
    np.testing.assert_allclose(out.norm, [1 / 1.4])


def test_a_rig_driven_from_measured_positions_has_its_weights_from_there() -> None:
    """Dutta (2010) 3.1.3: lights are driven from where they were measured, and not from the layout."""
    places, ideal = light_places(off_mm=20)
    rows = [
        {
            "id": f"L{k:02d}",
            "position_mm": list(place),
            "direction": None,
            "drive_position": list(vector),
            "power": 1.0,
        }
        for k, (place, vector) in enumerate(zip(places, ideal, strict=True))
    ]
    measured, layout = (
        Lights.of(items.lights_of({"drive": drive, "lights": rows}), near=True) for drive in ("measured", "ideal")
    )
    unit = places / np.linalg.norm(places, axis=1, keepdims=True)
    np.testing.assert_allclose(measured.drive, unit, atol=1e-12)
    np.testing.assert_allclose(layout.drive, ideal, atol=1e-12)
    # pictures of such a rig, without noise: wrong weights are a wrong normal
    pictures, truth, depth, camera = near_ball(places, unit)
    seen = read(pictures)
    mask = np.isfinite(depth) & (seen.constant[0] > 0)
    points = Pinhole.of(camera, depth.shape).points(np.where(mask, depth, 1.0))[mask]
    errors = [
        float(
            np.mean(angle_deg(invert(seen.vector[0][mask].astype(float), points, lights).normal.T, truth[:, mask]))
        )
        for lights in (measured, layout)
    ]
    assert errors[0] < 0.05  # float32 pictures
    assert errors[1] > 5 * errors[0]


def test_a_light_at_half_the_distance_is_four_times_as_bright() -> None:
    lights = lights_of([[1, 0, 0], [0, 0, 1], [0, 1, 0]], np.eye(3)[[0, 2, 1]])
    near = invert(np.array([[0.0, 0, 1]]), np.array([[0.0, 0, 0.5]]), lights)
    np.testing.assert_allclose(near.direct, [4.0], rtol=1e-6)


def test_four_numbers_of_seven_pictures_are_exact_without_noise(ball: tuple[Any, ...]) -> None:
    pictures, *_ = ball
    measured = read(pictures)
    mask = pictures["C"] > 0
    for i, axis in enumerate("XYZ"):
        wanted = pictures[axis] - pictures[axis + "c"]
        np.testing.assert_allclose(measured.vector[0, ..., i][mask], wanted[mask], atol=1e-4 * wanted.max())
    np.testing.assert_allclose(measured.constant[0][mask], pictures["C"][mask], rtol=1e-5)


@pytest.mark.parametrize("names", [("X", "Y", "Z", "C"), ("X", "Xc", "Y", "Z"), ("X", "Xc", "Yc", "Z")])
def test_smaller_sets_tell_the_same_without_noise(ball: tuple[Any, ...], names: tuple[str, ...]) -> None:
    pictures, *_ = ball
    whole, part = read(pictures), read({name: pictures[name] for name in names})
    mask = pictures["C"] > 0
    np.testing.assert_allclose(part.vector[0][mask], whole.vector[0][mask], atol=2e-4)


def test_weighting_gains_where_one_picture_of_a_pair_is_dark() -> None:
    """Shot noise: r_a' = 10 beside r_a = 400. r_c known, 2 r_a' tells m better than r_a - r_a' does."""
    generator = np.random.default_rng(3)
    level = {"X": 390.0, "Xc": 10.0, "Y": 200.0, "Yc": 200.0, "Z": 250.0, "Zc": 150.0, "C": 400.0}
    noisy = {k: generator.poisson(v, (200, 200)).astype(np.float32) for k, v in level.items()}
    weighted = measure([noisy]).vector[0, ..., 0].std()
    plain = (noisy["X"] - noisy["Xc"]).std()
    assert weighted < 0.62 * plain  # theory: sqrt of (4 x 10 + 400 / 4) over 400 is 0.59


def test_rotating_lights_and_measurement_together_rotates_the_normals() -> None:
    places, drive = light_places()
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    generator = np.random.default_rng(0)
    points, vector = generator.uniform(-80, 80, (50, 3)), generator.normal(size=(50, 3))
    straight = invert(vector, points, lights_of(places, drive)).normal
    turned = invert(vector @ turn.T, points @ turn.T, lights_of(places @ turn.T, drive @ turn.T)).normal
    np.testing.assert_allclose(turned, straight @ turn.T, atol=1e-6)


def test_permuting_lights_changes_nothing_and_scale_changes_nothing() -> None:
    places, drive = light_places()
    order = np.random.default_rng(1).permutation(len(places))
    points, vector = np.zeros((20, 3)), np.random.default_rng(2).normal(size=(20, 3))
    one = invert(vector, points, lights_of(places, drive)).normal
    np.testing.assert_allclose(
        invert(vector, points, lights_of(places[order], drive[order])).normal, one, atol=1e-9
    )
    np.testing.assert_allclose(invert(7 * vector, points, lights_of(places, drive)).normal, one, atol=1e-9)


def test_a_point_without_measurement_has_no_normal_and_inputs_stay_as_they_are() -> None:
    places, drive = light_places()
    vector, points = np.zeros((2, 3)), np.zeros((2, 3))
    vector[1] = (0, np.nan, 1)
    for array in (vector, points):
        array.flags.writeable = False
    assert np.isnan(invert(vector, points, lights_of(places, drive)).normal).all()


def test_lights_without_a_place_are_refused_for_near_models() -> None:
    row = {"id": "L00", "position_mm": None, "direction": [0, 0, 1], "drive_position": None, "power": 1.0}
    with pytest.raises(KernelError, match="L00 a direction only"):
        Lights.of({"lights": [row]}, near=True)
    with pytest.raises(KernelError, match="in one plane"):
        Lights.of({"lights": [row] * 5}, near=False)


def test_in_two_halves_equals_in_one_piece() -> None:
    places, drive = light_places()
    vector = np.random.default_rng(2).normal(size=(101, 3))
    points = np.random.default_rng(3).uniform(-80, 80, (101, 3))
    lights = lights_of(places, drive)
    whole = invert(vector, points, lights).normal
    parts = [invert(vector[part], points[part], lights).normal for part in (slice(0, 40), slice(40, None))]
    np.testing.assert_array_equal(whole, np.concatenate(parts))


def test_every_measured_band_counts_by_its_noise(ball: tuple[Any, ...]) -> None:
    pictures, *_ = ball
    generator = np.random.default_rng(0)
    noisy = [
        {k: (v + generator.normal(0, s, v.shape)).astype(np.float32) for k, v in pictures.items()}
        for s in (0.02, 0.2)
    ]
    measured = measure(noisy)
    mask = pictures["C"] > 3
    assert np.median(measured.weight[0][mask] / measured.weight[1][mask]) == pytest.approx(100, rel=0.3)
    assert set(pictures) == set(STATIC)
    assert near_light.fused(measured).vector.shape == (1, 96, 96, 3)


def test_a_direction_counts_as_a_light_at_the_usual_distance() -> None:
    drive = light_places()[1]
    rows = [
        {"id": f"L{k:02d}", "position_mm": list(p), "direction": None, "drive_position": list(d), "power": 1.0}
        for k, (p, d) in enumerate(zip(LIGHT_MM * drive, drive, strict=True))
    ]
    turned = [dict(row) for row in rows]
    turned[5] |= {"position_mm": None, "direction": list(3 * drive[5])}
    one, two = Lights.of({"lights": rows}, near=False), Lights.of({"lights": turned}, near=False)
    np.testing.assert_allclose(one.position, two.position, atol=1e-9)

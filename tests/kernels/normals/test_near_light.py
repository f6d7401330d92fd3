"""Near light, depth, shadows and bounced light."""

from typing import Any

import numpy as np
import pytest

from lightstage.kernels.errors import KernelError
from lightstage.kernels.normals import near_light, self_consistent
from lightstage.kernels.normals.near_light import Lights, LightVectors, invert, measure
from lightstage.kernels.normals.normal_filter import noise_factor, non_local_means
from lightstage.kernels.normals.rig_normals import surface_normals
from lightstage.kernels.pictures.subject_mask import find_subject
from lightstage.kernels.surface.integration import integrate
from lightstage.kernels.surface.interreflection import Tiles, without_bounces
from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.kernels.surface.visibility import visible
from tests.scenes import LIGHT_MM, STATIC, angle_deg, light_places, near_ball


def lights_of(positions: Any, drive: Any) -> Lights:
    return Lights(np.asarray(positions, float), np.asarray(drive, float), np.ones(len(positions)))


@pytest.fixture(scope="module")
def ball() -> tuple[Any, ...]:
    places, drive = light_places()
    return (*near_ball(places, drive), lights_of(places, drive))


def read(pictures: dict[str, Any]) -> LightVectors:
    return measure([{name: picture.astype(np.float32) for name, picture in pictures.items()}])


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
        Lights.of(Lights.part_of({"drive": drive, "lights": rows}), near=True) for drive in ("measured", "ideal")
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


def test_near_ball_is_exact_without_noise_and_tells_its_distance(ball: tuple[Any, ...]) -> None:
    pictures, truth, depth, camera, lights = ball
    mask = np.isfinite(depth)
    pinhole = Pinhole.of(camera, mask.shape)
    found = self_consistent.solve(read(pictures), mask, pinhole, lights, model="near")
    inner = mask & (truth[2] > 0.2)
    normal = np.full((*mask.shape, 3), np.nan)
    normal[mask] = invert(read(pictures).vector[0][mask], pinhole.points(found.depth)[mask], lights).normal
    error = angle_deg(normal[inner].T, truth[:, inner])
    assert np.mean(error) < 0.02  # what the first-order equations of the depth leave
    assert found.distance_found
    assert abs(np.median((found.depth - depth)[inner])) < 0.5
    # uncorrected, the same pictures are half a degree off and more
    plain = read(pictures).vector[0][inner]
    assert np.mean(angle_deg(plain.T, truth[:, inner])) > 0.5


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


def test_a_wall_hides_the_lights_behind_it() -> None:
    """A step of 40 mm: its foot does not see a light low over the step, its top does."""
    _, _, _, camera = near_ball(*light_places(3))
    pinhole = Pinhole.of(camera, (96, 96))
    depth = np.full((96, 96), 850.0)
    depth[:, 60:] = 810.0
    lights = np.array([[790.0, 0, 200.0], [-790.0, 0, 200.0], [0, 0, 790.0]])
    points = pinhole.points(depth)
    foot, top, far = points[48, 57], points[48, 62], points[48, 5]
    seen = visible(np.stack([foot, top, far]), depth, pinhole, lights)
    np.testing.assert_array_equal(seen[:, 0], [0, 1, 0])
    np.testing.assert_array_equal(seen[:, 1], [1, 1, 1])
    np.testing.assert_array_equal(seen[:, 2], [1, 1, 1])


def test_light_passes_behind_a_ball(ball: tuple[Any, ...]) -> None:
    """A board behind and beside a ball sees a light that shines past the ball's back."""
    _, _, depth, camera, _ = ball
    pinhole = Pinhole.of(camera, depth.shape)
    point = np.array([[85.0, 0, -100.0]])
    lights = np.array([[-790.0, 0, -100.0], [-790.0, 0, 900.0]])
    seen = visible(point, depth, pinhole, lights)
    assert seen[0, 0] == 1  # 100 mm behind the centre of a ball of 80 mm radius
    assert seen[0, 1] == 0  # through the ball


def test_the_body_goes_on_below_the_picture() -> None:
    """A neck that widens downwards: its side does not see a light far below and behind the shoulder."""
    _, _, _, camera = near_ball(*light_places(3))
    pinhole = Pinhole.of(camera, (96, 96))
    depth = np.full((96, 96), np.nan)
    for row in range(30, 96):
        half = 14 + max(0, row - 70)
        depth[row, 48 - half : 48 + half] = 850.0
    points = pinhole.points(depth)[40, 58][None]
    below = np.array([[120.0, -700.0, 10.0]])
    assert visible(points, depth, pinhole, below)[0, 0] == 0
    assert visible(points, depth, pinhole, below * [1, -1, 1])[0, 0] == 1


def test_the_spectral_line_ends_at_direct_light() -> None:
    """q = (P + a P1) / (S + a S1) over six albedos: at zero it is P / S but for the second order in a."""
    generator = np.random.default_rng(5)
    shape = (40, 40)
    direct = np.stack([np.full(shape, v) for v in (0.3, -0.2, 0.6)], axis=-1)
    bounced = np.array([0.02, 0.05, -0.03])
    albedo = np.linspace(0.2, 0.8, 6)[:, None, None] * np.ones(shape)
    ratio = (direct + albedo[..., None] * bounced) / (1 + 0.1 * albedo)[..., None]
    ratio += generator.normal(0, 1e-3, ratio.shape)
    constant = albedo * (1 + 0.1 * albedo)
    mask = np.ones(shape, bool)
    slope, around = without_bounces(ratio, np.ones((6, *shape)), constant, np.ones(shape), mask)
    free = (ratio - around[..., None] * slope).mean(axis=0)
    before = np.abs(ratio.mean(axis=0) - direct).max(axis=(0, 1))
    after = np.abs(free.mean(axis=(0, 1)) - direct[0, 0])
    assert (after < 0.3 * before).all()


def test_form_factors_of_two_facing_squares() -> None:
    """Two walls of a right angle, each as wide as the edge they share: F = 0.2 (Howell's C-14), 20 x 20 tiles.

    The centres of tiles at the edge are close for their size, which costs a tenth.
    """
    size = 64
    camera = {
        "size_px": [size, size],
        "K": [[size * 10.0, 0, 31.5], [0, size * 10.0, 31.5], [0, 0, 1]],
        "distortion": [0, 0, 0, 0, 0],
        "world_to_camera": {"R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "t_mm": [0, 0, 2000.0]},
    }
    pinhole = Pinhole.of(camera, (size, size))
    # a valley along y: both walls at 45 degrees, deepest in the middle
    x = np.arange(size) - 31.5
    mm = 2000.0 / (size * 10.0)
    depth = np.broadcast_to(2000.0 - np.abs(x) * mm, (size, size)).copy()
    normal = np.zeros((size, size, 3))
    normal[:, :32] = np.array([1, 0, 1]) / np.sqrt(2)
    normal[:, 32:] = np.array([-1, 0, 1]) / np.sqrt(2)
    tiles = Tiles(pinhole.points(depth), normal, depth, np.ones((size, size), bool), pinhole)
    left = tiles.mean(np.broadcast_to(x < 0, (size, size)).astype(float)) > 0.5
    factors = tiles._factors[np.ix_(left, ~left)].sum(axis=1).mean()
    # walls of width w = 32 sqrt(2) and length 64 of the same unit: h/l = w/l = 0.707 gives 0.2338
    assert factors == pytest.approx(0.2338, rel=0.1)


def test_the_filter_takes_noise_and_leaves_a_groove() -> None:
    generator = np.random.default_rng(0)
    x = np.mgrid[0:80, 0:80][1]
    tilt = np.where((x % 20) < 3, 0.5, 0.0)
    truth = np.stack([tilt, np.zeros_like(tilt), np.ones_like(tilt)], axis=-1)
    truth /= np.linalg.norm(truth, axis=2, keepdims=True)
    noisy = truth + generator.normal(0, 0.03, truth.shape)
    noisy /= np.linalg.norm(noisy, axis=2, keepdims=True)
    mask = np.ones((80, 80), bool)
    out = non_local_means(noisy, np.ones((80, 80)), mask)
    assert noise_factor(noisy, np.ones((80, 80)), mask) == pytest.approx(0.03, rel=0.35)
    flat = (x % 20) > 8
    before, after = (angle_deg(np.moveaxis(n, 2, 0), np.moveaxis(truth, 2, 0)) for n in (noisy, out))
    assert after[flat].mean() < 0.3 * before[flat].mean()
    assert out[..., 0][(x % 20) == 1].mean() > 0.9 * truth[0, 1, 0]


def test_the_subject_is_found_and_nothing_is_an_error() -> None:
    generator = np.random.default_rng(0)
    picture = generator.normal(0, 1, (80, 100))
    picture[20:60, 30:70] += 100
    picture[38:42, 48:52] -= 100  # a hole in it
    picture[5:8, 5:8] += 100  # something else
    mask = find_subject(picture)
    assert mask[25:55, 35:65].all()
    assert not mask[:19].any()
    with pytest.raises(KernelError, match="no subject stands out"):
        find_subject(np.zeros((50, 50)))


def test_in_two_halves_equals_in_one_piece() -> None:
    places, drive = light_places()
    vector = np.random.default_rng(2).normal(size=(101, 3))
    points = np.random.default_rng(3).uniform(-80, 80, (101, 3))
    lights = lights_of(places, drive)
    whole = invert(vector, points, lights).normal
    parts = [invert(vector[part], points[part], lights).normal for part in (slice(0, 40), slice(40, None))]
    np.testing.assert_array_equal(whole, np.concatenate(parts))


def test_the_whole_solution_is_the_same_twice(ball: tuple[Any, ...]) -> None:
    pictures, _, depth, camera, lights = ball
    mask = np.isfinite(depth)
    pinhole = Pinhole.of(camera, mask.shape)
    one, two = (self_consistent.solve(read(pictures), mask, pinhole, lights, model="full") for _ in range(2))
    np.testing.assert_array_equal(one.depth, two.depth)
    np.testing.assert_array_equal(one.seen, two.seen)


def test_depth_does_not_tell_where_its_solver_began(ball: tuple[Any, ...]) -> None:
    """So neither its last step nor its preconditioner, which hang on last bits, shows; 1e-8 is 8 nm of depth."""
    _, truth, depth, camera, _ = ball
    mask = np.isfinite(depth)
    normal = np.where(mask, truth, 0).transpose(1, 2, 0) * [1, -1, -1]
    rays = Pinhole.of(camera, mask.shape).rays
    start = np.where(mask, 7 + 0.05 * np.random.default_rng(0).normal(size=mask.shape), np.nan)
    one, other = integrate(normal, mask, rays), integrate(normal, mask, rays, start=start)
    np.testing.assert_allclose(other[mask], one[mask], rtol=0, atol=1e-8)


def test_the_camera_smaller_sees_the_same_rays() -> None:
    _, _, _, camera = near_ball(*light_places(3))
    pinhole = Pinhole.of(camera, (96, 96))
    half = pinhole.smaller(2)
    np.testing.assert_allclose(half.rays[5, 7], pinhole.rays[10:12, 14:16].mean(axis=(0, 1)), atol=1e-12)


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


@pytest.mark.parametrize("albedos", [(0.6, 0.6, 0.6), (0.6,) * 6, (0.6, 0.61, 0.62)])
def test_bands_of_one_albedo_tell_nothing_of_bounces_and_change_nothing(
    ball: tuple[Any, ...], albedos: tuple[float, ...]
) -> None:
    """A white target: the line through its bands has no slope, only noise; `full` must not follow it."""
    pictures, truth, depth, camera, lights = ball
    generator = np.random.default_rng(0)
    top = max(p.max() for p in pictures.values())
    measured = measure(
        [
            {k: (a * v + generator.normal(0, 0.004 * top, v.shape)).astype(np.float32) for k, v in pictures.items()}
            for a in albedos
        ]
    )
    mask = np.isfinite(depth)
    pinhole = Pinhole.of(camera, mask.shape)
    inner = mask & (truth[2] > 0.2)
    errors = {}
    for model in ("near", "full"):
        found = self_consistent.solve(measured, mask, pinhole, lights, model=model)
        direct = np.ones(mask.shape)
        one = near_light.fused(found.without_bounces(measured, direct))
        normal = np.full((*mask.shape, 3), np.nan)
        points = pinhole.points(found.depth)[found.mask]
        normal[found.mask] = invert(one.vector[0][found.mask], points, lights, found.seen).normal
        errors[model] = np.nanmean(angle_deg(normal[inner].T, truth[:, inner]))
    # the noise of one map is 0.6 degrees; bands that differ by 1.5 % may add as much
    assert errors["full"] < errors["near"] + 0.6


def test_two_parts_of_a_subject_have_a_distance_each(ball: tuple[Any, ...]) -> None:
    """A ball behind a bar: what is left and right of it touches nothing, and each part tells its own distance."""
    pictures, truth, depth, camera, lights = ball
    mask = np.isfinite(depth)
    mask[:, 46:50] = False
    pinhole = Pinhole.of(camera, mask.shape)
    found = self_consistent.solve(read(pictures), mask, pinhole, lights, model="near")
    for half in (np.s_[:, :46], np.s_[:, 50:]):
        inside = mask[half] & (truth[2][half] > 0.3)
        assert abs(np.median((found.depth - depth)[half][inside])) < 2


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


def test_small_pictures_do_not_crash_the_filter_or_the_integration() -> None:
    normal = np.zeros((5, 100, 3))
    normal[..., 2] = 1
    assert non_local_means(normal, np.ones((5, 100)), np.ones((5, 100), bool)).shape == normal.shape
    rays = np.dstack([np.zeros((40, 1)), np.linspace(-0.1, 0.1, 40)[:, None], np.ones((40, 1))])
    flat = np.zeros((40, 1, 3))
    flat[..., 2] = -1
    assert np.ptp(integrate(flat, np.ones((40, 1), bool), rays)) < 1e-6


def test_a_lit_backdrop_is_no_subject() -> None:
    generator = np.random.default_rng(0)
    picture = generator.normal(10, 1, (80, 100))
    picture[20:60, 30:70] += 90
    mask = find_subject(picture)
    assert mask[25:55, 35:65].all()
    assert mask.mean() < 0.25


def test_normals_of_the_integrated_surface_are_those_of_the_ball(ball: tuple[Any, ...]) -> None:
    _, truth, depth, camera, _ = ball
    mask = np.isfinite(depth)
    found = surface_normals(Pinhole.of(camera, mask.shape).points(depth), mask)
    inner = mask & (truth[2] > 0.3)
    # differences over two pixels of a ball of 80 px: a chord is a third of a pixel's turn off at the steep side
    assert np.mean(angle_deg(found[inner].T, truth[:, inner])) < 0.2
    assert np.isnan(found[~mask]).all()

"""Normals: closed forms, truth that no kernel had a part in, invariances, and refusals."""

import itertools
from typing import Any

import numpy as np
import pytest
import quadprog
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from lightstage.dag.stage import Grid, StageError
from lightstage.kernels.normals import one_light
from lightstage.kernels.normals.quantised import FILL, STEPS
from lightstage.kernels.normals.spherical_gradients import GRADIENTS, solve, table
from lightstage.kernels.pictures.band_fusion import fuse, noise_model
from lightstage.stages.normals import STAGE, Choice, NormalsParams, choose, light_directions, normals, view_vectors
from tests.scenes import STATIC, angle_deg, decoded, ideal_gradient, sphere_normals

TWELVE = [
    (base, (base, base + "c", *others))
    for base in "XYZ"
    for others in itertools.product(*[(a, a + "c") for a in "XYZ" if a != base])
]
# int16 steps of 1/32767 leave at most 0.002 degrees; float32 arithmetic less
QUANTISED = 0.004


def pictures(names: tuple[str, ...], normal: NDArray[Any], albedo: Any = 1.0) -> list[NDArray[np.float32]]:
    return [ideal_gradient(normal, name, albedo).astype(np.float32) for name in names]


def run(method: str, names: tuple[str, ...], normal: NDArray[Any], *, base: str = "") -> Any:
    how = table(method, base, names)
    by_name = dict(zip(names, pictures(names, normal), strict=True))
    return solve([by_name[n] for n in how.pictures], how)


def test_difference_by_hand() -> None:
    """One pixel: r - r' = (3, 4, 0) and r_c = 10, so n = (0.6, 0.8, 0) and norm = 5 / 20."""
    values = {"X": 6.5, "Xc": 3.5, "Y": 7, "Yc": 3, "Z": 5, "Zc": 5, "C": 10}
    how = table("difference", "", list(values))
    out = solve([np.full((1, 1), values[name], np.float32) for name in how.pictures], how)
    np.testing.assert_allclose(out.normal[:, 0, 0] / STEPS, [0.6, 0.8, 0], atol=1 / STEPS)
    assert out.norm[0, 0] == pytest.approx(0.25)
    assert out.constant[0, 0] == 10


def test_ratio_by_hand() -> None:
    """r / r_c - 1/2 = (0.3, 0, 0.4): n = (0.6, 0, 0.8), norm 0.5."""
    values = {"X": 8, "Y": 5, "Z": 9, "C": 10}
    how = table("ratio", "", list(values))
    out = solve([np.full((1, 1), values[name], np.float32) for name in how.pictures], how)
    np.testing.assert_allclose(out.normal[:, 0, 0] / STEPS, [0.6, 0, 0.8], atol=1 / STEPS)
    assert out.norm[0, 0] == pytest.approx(0.5)


def test_minimal_by_hand_with_complements() -> None:
    """Base Y: n_y = r_y - r_y' = 2, r_y + r_y' = 10; X': -(2 * 3 - 10) = 4; Z: 2 * 7 - 10 = 4; (4, 2, 4) / 6."""
    values = {"Y": 6, "Yc": 4, "Xc": 3, "Z": 7}
    how = table("minimal", "Y", list(values))
    out = solve([np.full((1, 1), values[name], np.float32) for name in how.pictures], how)
    np.testing.assert_allclose(out.normal[:, 0, 0] / STEPS, np.array([4, 2, 4]) / 6, atol=1 / STEPS)
    assert out.constant[0, 0] == 10


@pytest.mark.parametrize("method", ["ratio", "difference"])
def test_ideal_shading_gives_the_truth_and_a_norm_of_one_third(method: str) -> None:
    truth, mask = sphere_normals()
    out = run(method, STATIC, truth)
    assert angle_deg(decoded(out.normal), truth)[mask].max() < QUANTISED
    np.testing.assert_allclose(out.norm[mask], 1 / 3, rtol=1e-5)


@pytest.mark.parametrize(("base", "names"), TWELVE)
def test_all_twelve_minimal_sets(base: str, names: tuple[str, ...]) -> None:
    truth, mask = sphere_normals()
    assert choose(names).base == base
    out = run("minimal", names, truth, base=base)
    assert angle_deg(decoded(out.normal), truth)[mask].max() < QUANTISED
    np.testing.assert_allclose(out.norm[mask], 1 / 3, rtol=1e-5)


def test_without_noise_a_still_subject_has_one_answer() -> None:
    """Light adds, r_a + r_a' = r_c, whatever the lobe: ratio, difference and QP cannot differ in direction."""
    generator = np.random.default_rng(3)
    constant = generator.uniform(100, 900, (20, 20))
    share = {axis: generator.uniform(0.1, 0.9, (20, 20)) for axis in "XYZ"}
    values = {"C": constant}
    for axis in "XYZ":
        values[axis], values[axis + "c"] = constant * share[axis], constant * (1 - share[axis])
    found = []
    for method, qp in (("ratio", False), ("difference", False), ("difference", True), ("ratio", True)):
        how = table(method, "", STATIC, qp=qp)
        found.append(decoded(solve([values[n].astype(np.float32) for n in how.pictures], how).normal))
    for other in found[1:]:
        assert angle_deg(other, found[0]).max() < 0.02  # float32 differences of numbers that nearly cancel


def noisy(seed: int = 0, sigma: float = 0.02) -> dict[str, NDArray[np.float32]]:
    generator = np.random.default_rng(seed)
    truth, _ = sphere_normals(16)
    return {
        n: (ideal_gradient(truth, n) + generator.normal(0, sigma, truth.shape[1:])).astype(np.float32)
        for n in STATIC
    }


@pytest.mark.parametrize(
    ("method", "base"), [("difference", ""), ("ratio", ""), ("minimal", "X"), ("minimal", "Z")]
)
def test_the_closed_form_qp_is_the_solvers_solution(method: str, base: str) -> None:
    """min |x - x0|^2 s.t. A x = b by Goldfarb and Idnani's solver, all nine unknowns at once."""
    values = noisy()
    how = table(method, base, STATIC)
    start = solve([values[n] for n in how.pictures], how)
    n0 = decoded(start.normal).astype(float)
    eye, zero = np.eye(3), np.zeros((3, 3))
    a = np.vstack([np.hstack([eye, zero, eye / 3]), np.hstack([zero, -eye, 2 * eye / 3])])
    closed = _closed_form(values, n0)
    for y, x in itertools.product(range(0, 16, 5), range(0, 16, 5)):
        r = {n: float(values[n][y, x]) for n in STATIC}
        b1 = [r[k] / r["C"] - 0.5 for k in "XYZ"]
        b2 = [(r[k] - r[k + "c"]) / r["C"] for k in "XYZ"]
        x0 = np.concatenate([np.zeros(6), n0[:, y, x]])
        solution = quadprog.solve_qp(np.eye(9), x0, a.T, np.array(b1 + b2), 6)[0]
        np.testing.assert_allclose(closed[:, y, x], solution[6:], atol=1e-6)


def _closed_form(values: dict[str, NDArray[np.float32]], n0: NDArray[Any]) -> NDArray[Any]:
    b1 = np.stack([values[a] / values["C"] - 0.5 for a in "XYZ"]).astype(float)
    b2 = np.stack([(values[a] - values[a + "c"]) / values["C"] for a in "XYZ"]).astype(float)
    return (9 * n0 + 3 * b1 + 6 * b2) / 14


@pytest.mark.parametrize(("method", "base"), [("difference", ""), ("ratio", ""), ("minimal", "Y")])
def test_the_kernel_computes_that_closed_form(method: str, base: str) -> None:
    values = noisy(1)
    plain, corrected = (table(method, base, STATIC, qp=qp) for qp in (False, True))
    start = decoded(solve([values[n] for n in plain.pictures], plain).normal)
    found = decoded(solve([values[n] for n in corrected.pictures], corrected).normal)
    # n0 in the kernel is not quantised, the one here is
    assert angle_deg(found, _closed_form(values, start)).max() < 2 * QUANTISED
    assert angle_deg(found, start).mean() > 0.01  # with noise the correction does something


def test_dark_and_invalid_pixels_have_no_normal() -> None:
    values = {n: np.full((1, 3), 0.5, np.float32) for n in STATIC}
    values["X"][0, 1] = np.nan
    how = table("difference", "", STATIC)
    out = solve([values[n] for n in how.pictures], how)
    assert (out.normal == FILL).all()  # no difference at all: no direction
    assert np.isnan(out.norm).all()
    assert not out.valid.any()


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_blocks_equal_one_piece_and_inputs_stay(dtype: Any) -> None:
    generator = np.random.default_rng(2)
    values = [generator.integers(1, 900, (37, 53)).astype(dtype) for _ in range(7)]
    for value in values:
        value.flags.writeable = False
    how = table("difference", "", STATIC)
    whole = solve(values, how)
    for rows in (slice(0, 11), slice(11, 37)):
        part = solve([value[rows] for value in values], how)
        np.testing.assert_array_equal(part.normal, whole.normal[:, rows])
        np.testing.assert_array_equal(part.norm, whole.norm[rows])


@settings(max_examples=25, deadline=None)
@given(st.floats(1e-3, 1e3), st.sampled_from(["ratio", "difference"]))
def test_scaling_the_light_changes_only_the_albedo(scale: float, method: str) -> None:
    values = noisy(4)
    how = table(method, "", STATIC)
    one = solve([values[n] for n in how.pictures], how)
    other = solve([values[n] * np.float32(scale) for n in how.pictures], how)
    assert np.abs(one.normal.astype(int) - other.normal).max() <= 1
    np.testing.assert_allclose(other.constant, one.constant * scale, rtol=1e-5)
    np.testing.assert_allclose(other.norm, one.norm, rtol=1e-4)


@settings(max_examples=25, deadline=None)
@given(st.permutations(list(range(5))), st.integers(0, 2**20))
def test_one_light_at_a_time_is_exact_and_does_not_mind_the_order(order: list[int], seed: int) -> None:
    generator = np.random.default_rng(seed)
    lights = generator.standard_normal((5, 3)) + np.array([0, 0, 3.0])
    truth = generator.standard_normal((3, 4, 4)) * 0.2 + np.array([0, 0, 1.0])[:, None, None]
    albedo = generator.uniform(0.5, 2, (4, 4))
    unit = truth / np.linalg.norm(truth, axis=0)
    images = [(albedo * np.einsum("a,ayx->yx", light, unit)).astype(np.float32) for light in lights]
    out = one_light.solve([images[i] for i in order], lights[order])
    assert angle_deg(decoded(out.normal), unit).max() < 0.05  # float32 through a pseudo-inverse
    np.testing.assert_allclose(out.constant, albedo, rtol=1e-3)


def test_one_light_at_a_time_does_without_saturated_pictures() -> None:
    truth, mask = sphere_normals(24)
    lights = np.array([[0, 0, 1.0], [0.5, 0, 1], [0, 0.5, 1], [-0.5, -0.3, 1], [0.3, -0.5, 1]])
    images = [np.einsum("a,ayx->yx", light, truth).astype(np.float32) for light in lights]
    images[1][5:15, 5:15] = np.nan
    images[3][10:20, 10:20] = np.nan
    out = one_light.solve(images, lights)
    assert angle_deg(decoded(out.normal), truth)[mask].max() < 0.05
    images[0][0, 0] = images[2][0, 0] = images[1][0, 0] = np.nan
    assert not one_light.solve(images, lights).valid[0, 0]


def test_rotating_lights_and_surface_together_rotates_the_normals() -> None:
    truth, mask = sphere_normals(24)
    a = np.radians(20)
    rotation = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    lights = np.array([[0, 0, 1.0], [0.5, 0, 1], [0, 0.5, 1], [-0.5, -0.3, 1]])
    images = [np.einsum("a,ayx->yx", light, truth).astype(np.float32) for light in lights]
    one = decoded(one_light.solve(images, lights).normal)
    other = decoded(one_light.solve(images, lights @ rotation.T).normal)
    rotated = np.einsum("ab,byx->ayx", rotation, one)
    assert angle_deg(other, rotated)[mask].max() < 0.02


def mirror_pictures(truth: NDArray[Any], view: NDArray[Any]) -> dict[str, NDArray[np.float32]]:
    """A perfect mirror under gradients shows (1 + u_a) / 2, u the mirrored view direction."""
    u = 2 * np.einsum("ayx,ayx->yx", truth, view) * truth - view
    shown = {"C": np.ones(truth.shape[1:])}
    for i, axis in enumerate("XYZ"):
        shown[axis], shown[axis + "c"] = (1 + u[i]) / 2, (1 - u[i]) / 2
    return {name: value.astype(np.float32) for name, value in shown.items()}


CAMERA = {
    "size_px": [48, 48],
    "K": [[60.0, 0, 23.5], [0, 60.0, 23.5], [0, 0, 1]],
    "distortion": [0.0] * 5,
    "world_to_camera": {"R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]]},
}


@pytest.mark.parametrize("method", ["ratio", "difference"])
def test_specular_normals_are_half_vectors_with_each_pixels_own_view(method: str) -> None:
    truth, mask = sphere_normals()
    view = view_vectors(CAMERA, (48, 48))
    np.testing.assert_allclose(np.linalg.norm(view, axis=0), 1, rtol=1e-6)
    values = mirror_pictures(truth, view)
    how = table(method, "", STATIC)
    out = solve([values[n] for n in how.pictures], how, view=view)
    facing = mask & (np.einsum("ayx,ayx->yx", truth, view) > 0.15)
    assert angle_deg(decoded(out.normal), truth)[facing].max() < 0.05
    # a mirror's lobe has no width: its norm is 1/2, not the diffuse 1/3
    np.testing.assert_allclose(out.norm[facing], 0.5, rtol=1e-4)
    wrong = solve(
        [values[n] for n in how.pictures],
        how,
        view=np.broadcast_to(np.array([0, 0, 1.0])[:, None, None], view.shape),
    )
    assert np.median(angle_deg(decoded(wrong.normal), truth)[facing]) > 3


def test_the_view_vector_points_to_the_camera() -> None:
    """World x right, y up: the left, upper pixel sees a point to the left and above, so v points right and down."""
    view = view_vectors(CAMERA, (48, 48))
    assert view[0, 0, 0] > 0 > view[1, 0, 0]
    assert view[2].min() > 0
    centre = view[:, 23:25, 23:25].mean(axis=(1, 2))
    np.testing.assert_allclose(centre, [0, 0, 1], atol=1e-3)
    with pytest.raises(StageError, match="is for 48 x 48; the pictures are 30 x 20"):
        view_vectors(CAMERA, (20, 30))


@pytest.mark.parametrize(
    ("have", "expected"),
    [
        ("C X Y Z Xc Yc Zc", ("difference", "")),
        ("X Y Z Xc Yc Zc", ("difference", "")),
        ("C X Y Z", ("ratio", "")),
        ("C X Y Z Yc", ("minimal", "Y")),
        ("X Z C Y Xc", ("minimal", "X")),
        ("L00 L01 L02 L03", ("least_squares", "")),
    ],
)
def test_auto_takes_the_best_that_the_frames_support(have: str, expected: tuple[str, str]) -> None:
    choice = choose(have.split())
    assert (choice.method, choice.base) == expected


@pytest.mark.parametrize(
    ("have", "ask", "parts"),
    [
        ("C X Y", {}, ["any method needs", "the session has C, X, Y", "no method works"]),
        ("C X Y Z", {"method": "difference"}, ["difference needs X Y Z Xc Yc Zc", "method: ratio would work"]),
        ("C X Y Z Xc", {"method": "minimal", "base": "Z"}, ["minimal with base Z needs Z and Zc", "ratio"]),
        ("C X Y Z", {"correct": "qp"}, ["Xc, Yc, Zc missing", "correct: none works with ratio"]),
        ("L00 L01 L02", {"correct": "qp"}, ["gradient methods"]),
        ("L00 L01", {}, ["at least three one-light pictures"]),
    ],
)
def test_a_missing_illumination_says_what_is_needed_what_there_is_and_what_would_work(
    have: str, ask: dict[str, str], parts: list[str]
) -> None:
    with pytest.raises(StageError) as caught:
        choose(have.split(), **ask)
    assert all(part in str(caught.value) for part in parts), str(caught.value)


def test_the_qp_correction_is_for_diffuse_light() -> None:
    """Its 1/3 and 2/3 are the diffuse lobe's; a specular lobe has up to 1/2 and 1, by its roughness."""
    sizes = {"illumination": len(STATIC), "band": 1, "component": 2, "y": 4, "x": 4}
    labels: dict[str, Any] = {
        "illumination": (("illumination",), list(STATIC)),
        "frame": (("illumination",), list(range(len(STATIC)))),
        "band": (("band",), [0.0]),
        "component": (("component",), ["diffuse", "specular"]),
    }
    stacked = Grid(sizes, labels, arrays=frozenset({"radiance"}))
    facts = {"frame_rate_hz": None, "illumination": list(STATIC), "time_s": [None] * len(STATIC), "items": []}
    with pytest.raises(StageError, match="constants of the diffuse lobe"):
        STAGE.arrange([stacked], facts, NormalsParams(correct="qp", component="specular"))
    assert STAGE.arrange([stacked], facts, NormalsParams(correct="qp")).groups


def test_lights_by_position_fall_off_and_by_direction_do_not() -> None:
    item = {
        "lights": [
            {"id": "L00", "position_mm": [0, 0, 100.0], "direction": None, "power": 2.0},
            {"id": "L01", "position_mm": [200.0, 0, 0], "direction": None, "power": 1.0},
            {"id": "L02", "position_mm": [0, 150.0, 0], "direction": None, "power": 1.0},
        ]
    }
    found = light_directions(item, ["L0", "L01", "L02"])
    np.testing.assert_allclose(found, [[0, 0, 2 * 2.25], [0.5625, 0, 0], [0, 1, 0]])
    with pytest.raises(StageError, match="has no L07"):
        light_directions(item, ["L00", "L01", "L07"])
    with pytest.raises(StageError, match="lie in one plane"):
        light_directions(item, ["L00", "L01"])


def band(seed: int, level: float, names: tuple[str, ...], shape: tuple[int, int] = (64, 64)) -> dict[str, Any]:
    """A band of known noise: variance 4e-4 + 0.01 r."""
    generator = np.random.default_rng(seed)
    truth, _ = sphere_normals(shape[0])
    clean = {n: ideal_gradient(truth, n, level) for n in names}
    return {
        n: (v + np.sqrt(4e-4 + 0.01 * v) * generator.standard_normal(shape)).astype(np.float32)
        for n, v in clean.items()
    }


def test_the_noise_is_measured_from_the_complement_residual() -> None:
    """24,576 differences of sums: the fit is known to about 5 %."""
    generator = np.random.default_rng(0)
    levels = np.linspace(0.2, 8, 64)[:, None] * np.ones((1, 64))
    clean = {"C": levels, **{a + c: levels / 2 for a in "XYZ" for c in ("", "c")}}
    noisy_band = {
        n: (v + np.sqrt(4e-3 + 0.01 * v) * generator.standard_normal(v.shape)).astype(np.float32)
        for n, v in clean.items()
    }
    alpha, beta = noise_model(noisy_band)
    assert beta == pytest.approx(0.01, rel=0.15)
    assert alpha == pytest.approx(4e-3, rel=0.5)


def test_the_noise_hangs_on_no_order_and_on_no_last_bit() -> None:
    """Counts are whole, so levels are tied; which of them come first tells nothing."""
    generator = np.random.default_rng(3)
    level = {"X": 390.0, "Xc": 10.0, "Y": 200.0, "Yc": 200.0, "C": 400.0}
    counts = {name: generator.poisson(mean, (64, 64)).astype(np.float32) for name, mean in level.items()}
    order = generator.permutation(64 * 64)
    shuffled = {name: picture.reshape(-1)[order].reshape(64, 64) for name, picture in counts.items()}
    moved = {name: np.nextafter(picture, np.float32(1e6)) for name, picture in counts.items()}
    fit = noise_model(counts)
    np.testing.assert_allclose(noise_model(shuffled), fit, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(noise_model(moved), fit, rtol=1e-5, atol=1e-5)


def test_one_level_tells_read_noise_from_shot_noise() -> None:
    """Variance 30 + 0.1 x 400 at one level: 3 alpha + 2 beta r alone could be all of either."""
    generator = np.random.default_rng(4)
    level = {name: 200.0 for a in "XYZ" for name in (a, a + "c")} | {"C": 400.0}
    pictures = {
        name: (mean + generator.normal(0, np.sqrt(30 + 0.1 * mean), (200, 200))).astype(np.float32)
        for name, mean in level.items()
    }
    alpha, beta = noise_model(pictures)
    assert alpha == pytest.approx(30, rel=0.1)
    assert beta == pytest.approx(0.1, rel=0.25)


def test_what_moves_or_saturates_does_not_pull_the_noise() -> None:
    """A twentieth of the pixels is off by 100 sigma: in the mean of squares that is 500 times the variance."""
    generator = np.random.default_rng(5)
    pictures = {name: (5 + generator.normal(0, 0.1, (64, 64))).astype(np.float32) for name in ("X", "Xc")}
    pictures["C"] = (10 + generator.normal(0, 0.1, (64, 64))).astype(np.float32)
    clean = noise_model(pictures)
    pictures["C"][::20] += 10
    pulled = noise_model(pictures)
    at = [alpha + 10 * beta for alpha, beta in (clean, pulled)]
    assert at[1] == pytest.approx(at[0], rel=0.35)


def test_fusing_bands_beats_the_best_band() -> None:
    """Six equal bands: noise falls by sqrt(6) = 2.4; tolerance for the finite sample."""
    truth, mask = sphere_normals(64)
    bands = [band(seed, 4.0, STATIC) for seed in range(6)]
    how = table("difference", "", STATIC)

    def error(values: dict[str, Any]) -> float:
        return float(np.mean(angle_deg(decoded(solve([values[n] for n in how.pictures], how).normal), truth)[mask]))

    fused = dict(zip(STATIC, fuse([[b[n] for n in STATIC] for b in bands], STATIC), strict=True))
    assert error(bands[0]) / error(fused) == pytest.approx(np.sqrt(6), rel=0.1)


def test_a_noisy_band_is_given_little_weight_and_a_saturated_one_none() -> None:
    truth, mask = sphere_normals(64)
    good, poor = band(1, 4.0, STATIC), band(2, 0.05, STATIC)
    how = table("difference", "", STATIC)
    good_alone = dict(good)

    def error(values: dict[str, Any]) -> float:
        return float(np.mean(angle_deg(decoded(solve([values[n] for n in how.pictures], how).normal), truth)[mask]))

    fused = dict(zip(STATIC, fuse([[b[n] for n in STATIC] for b in (good, poor)], STATIC), strict=True))
    assert error(fused) < 1.02 * error(good_alone)
    good["X"][10:20, 10:20] = np.nan
    fused = dict(zip(STATIC, fuse([[b[n] for n in STATIC] for b in (good, poor)], STATIC), strict=True))
    assert np.isfinite(fused["X"]).all()


def test_the_kernel_fuses_and_reads_the_diffuse_constant() -> None:
    truth, mask = sphere_normals()
    choice = Choice("ratio", "", ("X", "Y", "Z", "C"))
    names = table("ratio", "", choice.pictures).pictures
    one = pictures(names, truth)
    constant = np.full(truth.shape[1:], 7.0, np.float32)
    out = normals(
        [*one, *one, constant, constant], choice=choice, names=names, diffuse_constant=True, lights=None, view=None
    )
    assert angle_deg(decoded(out["normal"]), truth)[mask].max() < QUANTISED
    np.testing.assert_allclose(out["albedo"], 7, rtol=1e-6)


def test_the_table_reads_only_what_it_uses() -> None:
    assert set(table("ratio", "", STATIC).pictures) == {"C", "X", "Y", "Z"}
    assert set(table("minimal", "Z", [*GRADIENTS]).pictures) == {"X", "Y", "Z", "Zc"}

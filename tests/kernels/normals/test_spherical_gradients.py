"""The gradient methods: closed forms, ideal shading, an independent QP solver, invariances."""

import itertools
from typing import Any

import numpy as np
import pytest
import quadprog
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from lightstage.kernels.encodings import NORMAL_FILL, NORMAL_STEPS
from lightstage.kernels.normals.gradient_methods import table
from lightstage.kernels.normals.spherical_gradients import solve
from lightstage.kernels.pictures.picture_sets import choose
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
    np.testing.assert_allclose(out.normal[:, 0, 0] / NORMAL_STEPS, [0.6, 0.8, 0], atol=1 / NORMAL_STEPS)
    assert out.norm[0, 0] == pytest.approx(0.25)
    assert out.constant[0, 0] == 10


def test_ratio_by_hand() -> None:
    """r / r_c - 1/2 = (0.3, 0, 0.4): n = (0.6, 0, 0.8), norm 0.5."""
    values = {"X": 8, "Y": 5, "Z": 9, "C": 10}
    how = table("ratio", "", list(values))
    out = solve([np.full((1, 1), values[name], np.float32) for name in how.pictures], how)
    np.testing.assert_allclose(out.normal[:, 0, 0] / NORMAL_STEPS, [0.6, 0, 0.8], atol=1 / NORMAL_STEPS)
    assert out.norm[0, 0] == pytest.approx(0.5)


def test_minimal_by_hand_with_complements() -> None:
    """Base Y: n_y = r_y - r_y' = 2, r_y + r_y' = 10; X': -(2 * 3 - 10) = 4; Z: 2 * 7 - 10 = 4; (4, 2, 4) / 6."""
    values = {"Y": 6, "Yc": 4, "Xc": 3, "Z": 7}
    how = table("minimal", "Y", list(values))
    out = solve([np.full((1, 1), values[name], np.float32) for name in how.pictures], how)
    np.testing.assert_allclose(out.normal[:, 0, 0] / NORMAL_STEPS, np.array([4, 2, 4]) / 6, atol=1 / NORMAL_STEPS)
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
    assert (out.normal == NORMAL_FILL).all()  # no difference at all: no direction
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


def mirror_pictures(truth: NDArray[Any], view: NDArray[Any]) -> dict[str, NDArray[np.float32]]:
    """A perfect mirror under gradients shows (1 + u_a) / 2, u the mirrored view direction."""
    u = 2 * np.einsum("ayx,ayx->yx", truth, view) * truth - view
    shown = {"C": np.ones(truth.shape[1:])}
    for i, axis in enumerate("XYZ"):
        shown[axis], shown[axis + "c"] = (1 + u[i]) / 2, (1 - u[i]) / 2
    return {name: value.astype(np.float32) for name, value in shown.items()}


@pytest.mark.parametrize("method", ["ratio", "difference"])
def test_specular_normals_are_half_vectors_with_each_pixels_own_view(method: str) -> None:
    truth, mask = sphere_normals()
    y, x = np.mgrid[:48, :48] - 23.5
    view = np.stack([-0.014 * x, 0.014 * y, np.ones_like(x)])  # a camera two pictures' widths away
    view = (view / np.linalg.norm(view, axis=0)).astype(np.float32)
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

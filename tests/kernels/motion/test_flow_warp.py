"""Warps and inverse flows: closed forms, SciPy's splines, analytic inverses, folds, tears, holes."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from lightstage.kernels.motion.flow_warp import INTERPOLATIONS, invert, seen, unit, warp, warp_vectors

Array = NDArray[Any]
SHAPE = (40, 52)
Y, X = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(float)


def flow_of(fx: Any, fy: Any) -> NDArray[np.float32]:
    return np.stack(np.broadcast_arrays(fx, fy, X)[:2]).astype(np.float32)


def inside(picture: Array, margin: int = 5) -> Array:
    return picture[..., margin:-margin, margin:-margin]


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_whole_pixels_are_copied(interpolation: Any) -> None:
    """out(x) = picture(x + (2, -1)), and nothing comes from outside."""
    picture = np.random.default_rng(0).standard_normal(SHAPE).astype(np.float32)
    out = warp(picture, flow_of(2, -1), interpolation=interpolation)
    # float32 arithmetic of the spline's prefilter
    np.testing.assert_allclose(out[1:, :-2], picture[:-1, 2:], atol=2e-6)
    assert np.isnan(out[0]).all()
    assert np.isnan(out[:, -2:]).all()


def test_half_a_pixel_by_hand() -> None:
    """A single 16 halfway between samples: linear gives 8 and 8, Keys with a = -1/2 gives -1, 9, 9, -1."""
    picture = np.zeros(SHAPE, np.float32)
    picture[20, 20] = 16
    half = flow_of(0.5, 0)
    np.testing.assert_allclose(warp(picture, half, interpolation="linear")[20, 18:22], [0, 8, 8, 0])
    np.testing.assert_allclose(warp(picture, half)[20, 17:23], [0, -1, 9, 9, -1, 0])


@pytest.mark.parametrize(("interpolation", "degree"), [("linear", 1), ("cubic", 2), ("spline", 3)])
def test_polynomials_are_exact(interpolation: Any, degree: int) -> None:
    flow = flow_of(0.31 + 0.02 * np.sin(Y), -0.44 + 0.03 * X / SHAPE[1])

    def polynomial(x: Array, y: Array) -> Array:
        return ((x - 25) / 25) ** degree - 0.5 * ((y - 20) / 25) ** degree + 0.1 * (x - y) / 25

    out = warp(polynomial(X, Y).astype(np.float32), flow, interpolation=interpolation)
    truth = polynomial(X + flow[0], Y + flow[1])
    # the spline's mirrored border is no polynomial: its trace fades by 0.27 a pixel
    margin = 14 if interpolation == "spline" else 3
    np.testing.assert_allclose(inside(out, margin), inside(truth, margin), atol=3e-6)


def test_spline_is_scipys() -> None:
    picture = np.random.default_rng(1).standard_normal(SHAPE).astype(np.float32)
    flow = flow_of(1.3 * np.sin(Y / 7), 1.1 * np.cos(X / 9))
    truth = ndimage.map_coordinates(picture.astype(float), [Y + flow[1], X + flow[0]], order=3, mode="mirror")
    out = warp(picture, flow, interpolation="spline")
    np.testing.assert_allclose(inside(out), inside(truth), atol=2e-5)


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_an_unknown_sample_stays_in_its_place(interpolation: Any) -> None:
    """Only the place that falls on it is unknown; beside it the known ones count, far off nothing changes."""
    picture = (X + 2 * Y).astype(np.float32)
    holed = picture.copy()
    holed[20, 25] = np.nan
    flow = flow_of(0.1, 0.1)
    whole, out = (warp(p, flow, interpolation=interpolation) for p in (picture, holed))
    unknown = np.argwhere(np.isnan(inside(out)) & ~np.isnan(inside(whole)))
    np.testing.assert_array_equal(unknown, [[15, 20]])
    far = (abs(X - 25) > 10) | (abs(Y - 20) > 10)
    # the spline's filled sample fades by 0.27 a pixel
    np.testing.assert_allclose(out[far], whole[far], atol=1e-3 if interpolation == "spline" else 0)
    near = inside(np.abs(out - whole))
    assert np.nanmax(near) < 2  # never more than the step to a neighbour


def test_known_ones_beside_unknown_are_averaged_by_hand() -> None:
    """Row (2, NaN) at 1/4: only the 2 counts; at 7/8 its weight 1/8 is too little."""
    picture = np.full((1, 2), 2, np.float32)
    picture[0, 1] = np.nan
    flow = np.zeros((2, 1, 2), np.float32)
    flow[0] = [[0.25, -0.125]]
    np.testing.assert_array_equal(warp(picture, flow), [[2, np.nan]])


def test_unknown_flow_gives_unknown() -> None:
    flow = flow_of(0.2, 0)
    flow[0, 10, 10], flow[1, 10, 11] = np.nan, np.inf
    out = warp(np.ones(SHAPE, np.float32), flow)
    np.testing.assert_array_equal(np.argwhere(np.isnan(inside(out))), [[5, 5], [5, 6]])


def test_vectors_stay_unit() -> None:
    turn = 0.2 * X
    vectors = np.stack([np.sin(turn), 0 * X, np.cos(turn)]).astype(np.float32)
    out = warp_vectors(vectors, flow_of(0.5, 0.25), interpolation="linear")
    truth = np.stack([np.sin(turn + 0.1), 0 * X, np.cos(turn + 0.1)])
    # halfway between two samples their mean has the direction, and only its length is short
    np.testing.assert_allclose(inside(out), inside(truth), atol=1e-6)


def test_a_vector_without_length_is_unknown() -> None:
    assert np.isnan(unit(np.zeros((3, 1, 1), np.float32))).all()


def test_other_interpolations_are_refused() -> None:
    with pytest.raises(ValueError, match="interpolation is 'nearest'; it must be one of linear, cubic, spline"):
        warp(np.zeros(SHAPE, np.float32), flow_of(0, 0), interpolation="nearest")  # type: ignore[arg-type]


@settings(max_examples=25, deadline=None)
@given(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(0.85, 1.2), st.floats(-6, 6), st.floats(-6, 6))
def test_an_affine_flow_has_its_own_inverse(turn: float, shear: float, zoom: float, dx: float, dy: float) -> None:
    """f = (A - 1)(x - c) + b, so g = (1/A - 1)(y - c) - b/A."""
    matrix = zoom * np.array([[np.cos(turn), shear - np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    centre, shift = np.array([25.0, 20.0]), np.array([dx, dy])
    place = np.stack([X, Y]) - centre[:, None, None]
    flow = np.einsum("ij,jyx->iyx", matrix - np.eye(2), place) + shift[:, None, None]
    back = np.linalg.inv(matrix)
    truth = np.einsum("ij,jyx->iyx", back - np.eye(2), place) - (back @ shift)[:, None, None]
    inverse = invert(flow.astype(np.float32), tolerance_px=1e-3, rounds=50)
    source = np.stack([X, Y]) + truth
    seen = (source[0] >= 0) & (source[1] >= 0) & (source[0] <= SHAPE[1] - 1) & (source[1] <= SHAPE[0] - 1)
    assert inverse.valid[seen].all()
    # the tolerance is on y; zoom and turn change it by less than half
    np.testing.assert_allclose(inverse.flow[:, seen], truth[:, seen], atol=2e-3)


def test_inverse_leads_back_where_minus_the_flow_does_not() -> None:
    """A wave whose equation x + f(x) = y is checked in closed form, without interpolation of f."""

    def fx(x: Array, y: Array) -> Array:
        return 2.5 * np.sin(x / 8 + y / 11)

    def fy(x: Array, y: Array) -> Array:
        return 1.5 * np.cos(x / 10)

    flow = flow_of(fx(X, Y), fy(X, Y))
    inverse = invert(flow)

    def gap(g: Array) -> Array:
        x, y = X + g[0], Y + g[1]
        return np.hypot(fx(x, y) + g[0], fy(x, y) + g[1])

    assert inside(inverse.valid).all()
    # the tolerance of 0.01, and the flow's curvature between samples: 2.5 / 8**2 / 8 = 0.005
    assert inside(gap(inverse.flow)).max() < 0.016
    assert inside(gap(-flow)).max() > 0.5


def fold() -> NDArray[np.float32]:
    """The left part goes 8 to the right, the right part stays: x = 12..19 and x = 20..27 land on one another."""
    return flow_of(np.where(X < 20, 8, 0), 0)


def test_a_fold_is_unknown_without_confidence() -> None:
    inverse = invert(fold())
    assert not inverse.valid[:, 20:28].any()
    np.testing.assert_array_equal(inverse.flow[0, :, 8:19], -8)
    np.testing.assert_array_equal(inverse.flow[0, :, 29:], 0)
    assert not inverse.valid[:, :7].any()


@pytest.mark.parametrize(("left", "right", "flow"), [(1.0, 0.5, -8), (0.5, 1.0, 0), (1.0, 0.0, -8)])
def test_in_a_fold_the_confident_one_is_taken(left: float, right: float, flow: float) -> None:
    confidence = np.where(X < 20, left, right).astype(np.float32)
    inverse = invert(fold(), confidence)
    assert inverse.valid[:, 21:27].all()
    np.testing.assert_array_equal(inverse.flow[0, :, 21:27], flow)


def test_a_tear_is_unknown() -> None:
    """The right part goes 8 to the right: nothing came to x = 20..27."""
    inverse = invert(flow_of(np.where(X < 20, 0, 8), 0))
    assert not inverse.valid[:, 21:27].any()
    np.testing.assert_array_equal(inverse.flow[0, :, :19], 0)
    np.testing.assert_array_equal(inverse.flow[0, :, 29:], -8)


@pytest.mark.parametrize(("factor", "within", "beyond"), [(1.8, 2.0, 1.5), (0.4, 2.6, 2.0)])
def test_what_stretches_too_far_is_unknown(factor: float, within: float, beyond: float) -> None:
    """x = 10..30 becomes `factor` times as wide, all else follows: g = (y - 10) / factor + 10 - y."""
    flow = flow_of((factor - 1) * (np.clip(X, 10, 30) - 10), 0)
    y = np.arange(12, 9 + round(20 * factor))
    kept, dropped = invert(flow, stretch=within), invert(flow, stretch=beyond)
    assert kept.valid[:, y].all()
    assert not dropped.valid[:, y].any()
    truth = np.broadcast_to((y - 10) / factor + 10 - y, (SHAPE[0], len(y)))
    np.testing.assert_allclose(kept.flow[0][:, y], truth, atol=0.01 / factor + 1e-5)


def test_where_the_flow_is_unknown_nothing_comes_from() -> None:
    flow = flow_of(3, 0)
    flow[:, 10:20, 20:30] = np.nan
    confidence = np.ones(SHAPE, np.float32)
    confidence[30, 40], confidence[35, 40] = np.nan, 0
    inverse = invert(flow, confidence)
    assert not inverse.valid[10:20, 23:33].any()
    assert inverse.valid[:10, 3:].all()
    assert not inverse.valid[[30, 35], 43].any()
    assert inverse.valid[32, 43]
    np.testing.assert_array_equal(np.isnan(inverse.flow[0]), ~inverse.valid)


def test_inputs_are_not_written() -> None:
    rng = np.random.default_rng(3)
    picture, flow = rng.standard_normal(SHAPE).astype(np.float32), flow_of(0.3, 0.2)
    confidence = np.ones(SHAPE, np.float32)
    picture[5, 5] = np.nan
    copies = [a.copy() for a in (picture, flow, confidence)]
    for array in (picture, flow, confidence):
        array.setflags(write=False)
    for interpolation in INTERPOLATIONS:
        warp(picture, flow, interpolation=interpolation)
    invert(flow, confidence)
    for array, copy in zip((picture, flow, confidence), copies, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_what_leaves_the_picture_is_not_seen() -> None:
    """All moves 4 px to the right: the last 4 columns are beyond the border."""
    visible = seen(flow_of(4, 0))
    assert visible[:, 2:-6].min() == 1
    assert visible[:, -4:].max() == 0


def test_what_is_folded_under_something_else_is_not_seen() -> None:
    """From column 26 on all moves 6 px to the left, over what stands still: one of the two is hidden."""
    visible = seen(flow_of(np.where(X < 26, 0.0, -6.0), 0))
    assert visible[5:-5, 21:25].max() == 0 or visible[5:-5, 27:31].max() == 0
    assert visible[5:-5, 2:18].min() == 1

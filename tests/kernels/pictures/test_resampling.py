"""Counts to signal, and one resampling for mount and homography together."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.kernels.encodings import SIGNAL_STEP
from lightstage.kernels.pictures.resampling import correct, reorient, undone_shape, view_fraction, warp


def test_counts_by_hand() -> None:
    raw = np.array([[100, 1023, 20]], np.uint16)
    found = correct(raw, np.full((1, 3), 20, np.float32), np.array([[1.25, 1, 1]], np.float32), 1023)
    np.testing.assert_array_equal(found, [[100, np.nan, 0]])


def test_whole_pixels_move_exactly_and_the_rim_is_unknown() -> None:
    picture = np.random.default_rng(0).integers(0, 200, (12, 15)).astype(np.float32)
    picture.flags.writeable = False
    move = np.array([[1.0, 0, 2], [0, 1, 1], [0, 0, 1]])
    found = warp(picture, move, 8, 10)
    np.testing.assert_array_equal(found[1:8, 1:10], picture[2:9, 3:12])
    assert np.isnan(warp(picture, np.eye(3), 12, 15)[0]).all()


@given(st.floats(-0.002, 0.002), st.floats(-0.1, 0.1), st.floats(2, 4), st.floats(2, 4))
@settings(max_examples=25)
def test_a_parabola_is_resampled_exactly_where_a_homography_leads(
    p: float, turn: float, dx: float, dy: float
) -> None:
    def surface(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 50 + 0.7 * x - 0.4 * y + 0.02 * x * x - 0.03 * x * y + 0.01 * y * y

    y, x = np.mgrid[:40, :50].astype(float)
    matrix = np.array([[np.cos(turn), -np.sin(turn), dx], [np.sin(turn), np.cos(turn), dy], [p, -p / 2, 1.0]])
    found = warp(surface(x, y).astype(np.float32), matrix, 30, 40)
    v, u = np.mgrid[:30, :40].astype(float)
    w = matrix[2, 0] * u + matrix[2, 1] * v + 1
    sx, sy = (matrix[0, 0] * u + matrix[0, 1] * v + dx) / w, (matrix[1, 0] * u + matrix[1, 1] * v + dy) / w
    known = np.isfinite(found)
    assert known.sum() > 500
    inside = (sx >= 1) & (sy >= 1) & (sx < 48) & (sy < 38)
    np.testing.assert_array_equal(known, inside)
    np.testing.assert_allclose(found[known], surface(sx, sy)[known], atol=SIGNAL_STEP / 2 + 2e-4)


def test_an_unknown_pixel_spreads_to_its_sixteen_neighbourhoods() -> None:
    picture = np.ones((20, 20), np.float32)
    picture[10, 10] = np.nan
    found = warp(picture, np.array([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]]), 18, 18)
    assert np.isnan(found[8:12, 8:12]).all()
    assert np.isfinite(found[4:8, 4:16]).all()


@pytest.mark.parametrize("rotate", [0, 90, 180, 270])
def test_a_mount_is_undone_clockwise_then_mirrored(rotate: int) -> None:
    picture = np.arange(6, dtype=np.float32).reshape(2, 3)
    by_hand = {
        0: [[0, 1, 2], [3, 4, 5]],
        90: [[3, 0], [4, 1], [5, 2]],
        180: [[5, 4, 3], [2, 1, 0]],
        270: [[2, 5], [1, 4], [0, 3]],
    }[rotate]
    found = reorient(picture, rotate, False)
    np.testing.assert_array_equal(found, by_hand)
    assert found.shape == undone_shape(rotate, (2, 3))
    np.testing.assert_array_equal(reorient(picture, rotate, True), np.array(by_hand)[:, ::-1])


def test_half_of_the_view() -> None:
    half = np.array([[1.0, 0, 50], [0, 1, 0], [0, 0, 1]])
    assert view_fraction(half, (100, 100), (100, 100)) == pytest.approx(0.5, abs=0.03)
    assert view_fraction(np.eye(3), (100, 100), (100, 100)) == 1

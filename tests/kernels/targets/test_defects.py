"""Moments of repeated frames against numpy's, planted defects, and their repair by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.defects import find_dead, find_hot, interpolate, moments


def test_by_hand() -> None:
    out = moments([np.array([[1, 10]], np.uint16), np.array([[3, 1023]], np.uint16)], white_level=1023)
    np.testing.assert_array_equal(out.mean, [[2, 516.5]])
    np.testing.assert_array_equal(out.variance, [[2, 1013**2 / 2]])
    np.testing.assert_array_equal(out.saturated, [[False, True]])
    assert out.frames == 2
    assert np.isnan(moments([np.zeros((1, 2))], white_level=9).variance).all()


@given(st.integers(0, 2**32 - 1), st.integers(2, 9))
@settings(max_examples=20)
def test_moments_are_numpys(seed: int, count: int) -> None:
    frames = np.random.default_rng(seed).integers(0, 1024, (count, 5, 6)).astype(np.uint16)
    frames.flags.writeable = False
    out = moments(iter(frames), white_level=1023)
    np.testing.assert_allclose(out.mean, frames.mean(axis=0))
    np.testing.assert_allclose(out.variance, frames.astype(float).var(axis=0, ddof=1), atol=1e-9)
    np.testing.assert_array_equal(out.saturated, (frames == 1023).any(axis=0))


@pytest.mark.parametrize("seed", range(4))
def test_planted_hot_pixels_are_found_and_no_others(seed: int) -> None:
    random = np.random.default_rng(seed)
    dark = 20 + random.normal(0, 0.4, (80, 100))
    where = np.unravel_index(random.choice(8000, 12, replace=False), dark.shape)
    dark[where] += random.uniform(12, 200, 12)
    found, threshold = find_hot(dark, white_level=1023)
    assert set(zip(*np.nonzero(found), strict=True)) == set(zip(*where, strict=True))
    assert 2 < threshold <= 10


@pytest.mark.parametrize("seed", range(4))
def test_planted_dead_pixels_are_found_also_where_the_lens_darkens(seed: int) -> None:
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:80, :100]
    light = 600 * np.exp(-((x - 50) ** 2 + (y - 40) ** 2) / 5000)
    flat = 20 + light + random.normal(0, 2, light.shape)
    where = (np.array([5, 40, 41, 70]), np.array([10, 50, 50, 90]))
    flat[where] = 20 + 0.3 * light[where]
    found, threshold = find_dead(flat, np.full(light.shape, 20.0))
    assert set(zip(*np.nonzero(found), strict=True)) == set(zip(*where, strict=True))
    assert 0.5 <= threshold <= 0.9


def test_a_hot_pixel_is_no_neighbour_of_a_dead_one() -> None:
    flat = np.full((9, 9), 500.0)
    hot = np.zeros((9, 9), bool)
    hot[4, 5] = True
    flat[hot] = 1e6
    assert not find_dead(flat, np.zeros((9, 9)), bad=hot)[0].any()


def test_a_bad_pixel_takes_the_mean_of_its_neighbours_by_distance() -> None:
    image = np.array([[1.0, 2, 3], [4, 99, 6], [7, 8, 9]])
    bad = np.zeros((3, 3), bool)
    bad[1, 1] = True
    # the four beside it count 1, the four across the corners 1/2
    expected = ((2 + 4 + 6 + 8) + (1 + 3 + 7 + 9) / 2) / 6
    out = interpolate(image, bad)
    assert out[1, 1] == pytest.approx(expected)
    assert image[1, 1] == 99
    slope = np.add.outer(np.arange(9.0), 2 * np.arange(9.0))
    hole = np.zeros((9, 9), bool)
    hole[3:6, 3:6] = True
    np.testing.assert_allclose(interpolate(slope, hole)[4, 4], slope[4, 4], atol=1e-9)


def test_refusals() -> None:
    with pytest.raises(KernelError, match="at least one frame"):
        moments([], white_level=1023)
    with pytest.raises(KernelError, match="differ in size"):
        moments([np.zeros((2, 2)), np.zeros((2, 3))], white_level=1023)
    with pytest.raises(KernelError, match="which is no light; light the target"):
        find_dead(np.full((9, 9), 20.0), np.full((9, 9), 20.0))
    with pytest.raises(KernelError, match="every pixel is bad"):
        interpolate(np.ones((4, 4)), np.ones((4, 4), bool))

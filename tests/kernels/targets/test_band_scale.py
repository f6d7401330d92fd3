"""Scales of bands from flat targets of known reflectance, and charts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.band_scale import (
    band_scale,
    biweight,
    checker_reflectance,
    find_checker,
    find_target,
    response_of,
)

SHAPE = (60, 80)
TARGET = np.zeros(SHAPE, bool)
TARGET[15:45, 20:60] = True
ONE = np.ones(SHAPE)


def test_by_hand() -> None:
    # 500 counts at half the reflectance, 400 at 0.8, dark 20
    pictures = np.stack([np.full(SHAPE, 520), np.full(SHAPE, 420)]).astype(np.uint16)
    pictures.flags.writeable = False
    found = band_scale(pictures, np.array([0.5, 0.8]), TARGET, dark=20 * ONE, response=ONE)
    np.testing.assert_allclose(found.scale, [1000, 500])
    np.testing.assert_allclose(found.unevenness, 0, atol=1e-12)
    assert found.pixels == 1200


@pytest.mark.parametrize("seed", range(4))
def test_noise_ends_within_the_standard_error_and_dust_does_not_count(seed: int) -> None:
    random = np.random.default_rng(seed)
    picture = random.poisson(4000, SHAPE) / 10 + 20
    picture[30, 30:42] = 900
    found = band_scale(picture[None].astype(np.uint16), np.array([0.5]), TARGET, dark=20 * ONE, response=ONE)
    # whole counts, cut: half a count less
    assert abs(found.scale[0] - 2 * 399.5) < 4 * found.scale_se[0] + 0.2


def test_vignetting_is_divided_out_and_a_slope_is_uneven() -> None:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    fall_off = np.exp(-((x - 40) ** 2 + (y - 30) ** 2) / 6000)
    flat = 50 + 600 * fall_off
    response = response_of(flat, 50 * ONE)
    assert response.max() == pytest.approx(1, abs=0.01)
    picture = (50 + 500 * fall_off)[None]
    found = band_scale(picture, np.array([1.0]), TARGET, dark=50 * ONE, response=response)  # type: ignore[arg-type]
    assert found.unevenness[0] < 1e-3
    tilted = band_scale(
        (20 + 500 * (1 + (x - 40) / 200))[None], np.array([1.0]), TARGET, dark=20 * ONE, response=ONE
    )  # type: ignore[arg-type]
    # a ramp of 40 px over 200: standard deviation 40 / 200 / sqrt(12)
    assert tilted.unevenness[0] == pytest.approx(0.2 / np.sqrt(12), rel=0.05)


@given(st.floats(-50, 50), st.floats(0.1, 20))
@settings(max_examples=25)
def test_the_biweight_mean_moves_and_grows_with_its_numbers(shift: float, gain: float) -> None:
    values = np.random.default_rng(2).normal(size=200)
    values[:5] = 40
    mean, error = biweight(values)
    assert abs(mean) < 0.3, "the five do not count"
    other, wider = biweight(gain * values + shift)
    assert other == pytest.approx(gain * mean + shift, abs=1e-6)
    assert wider == pytest.approx(gain * error, rel=1e-6)


def test_the_white_target_is_found_without_its_edge() -> None:
    picture = np.full((120, 160), 5.0)
    picture[30:90, 40:120] = 100
    picture[5:10, 5:10] = 110
    found = find_target(picture)
    assert found[60, 80]
    assert not found[:31].any()
    assert found.sum() > 0.7 * 60 * 80


def test_patches_are_read_at_their_middle() -> None:
    values = np.zeros((2, 40, 60))
    values[0, 5:15, 5:25], values[1, 5:15, 5:25] = 0.3, 0.6
    corners = np.array([[[5.0, 5], [24, 5], [24, 14], [5, 14]]])
    np.testing.assert_allclose(checker_reflectance(values, corners), [[0.3, 0.6]])


def test_refusals() -> None:
    picture = np.full((1, *SHAPE), 500, np.uint16)
    one = {"dark": 20 * ONE, "response": ONE}
    with pytest.raises(KernelError, match="need as many reflectances above 0 and up to 1"):
        band_scale(picture, np.array([1.2]), TARGET, **one)
    with pytest.raises(KernelError, match="covers 0 pixels; 100 are the least"):
        band_scale(picture, np.array([0.5]), np.zeros(SHAPE, bool), **one)
    with pytest.raises(KernelError, match=r"100.0 % of the target is saturated"):
        band_scale(np.full((1, *SHAPE), 1023, np.uint16), np.array([0.5]), TARGET, **one)
    with pytest.raises(KernelError, match="expose it more"):
        band_scale(np.full((1, *SHAPE), 25, np.uint16), np.array([0.5]), TARGET, **one)
    with pytest.raises(KernelError, match="not brighter than the dark"):
        response_of(ONE, ONE)
    with pytest.raises(KernelError, match="no white target stands out"):
        find_target(np.random.default_rng(0).normal(0, 1, SHAPE))
    with pytest.raises(KernelError, match="no ColorChecker"):
        find_checker(np.full((3, 60, 80), 0.4), red=2, green=1, blue=0)

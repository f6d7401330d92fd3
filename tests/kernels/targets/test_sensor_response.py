"""Gain, read noise and linearity of sensors that numpy plays: electrons are counted, read, and rounded."""

import numpy as np
import pytest

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.defects import Moments, moments
from lightstage.kernels.targets.sensor_response import fit_linearity, photon_transfer

WHITE = 1023


def frames(random: np.random.Generator, electrons: float, gain: float, read: float, count: int) -> Moments:
    """Of a sensor with an offset of 30 counts; gain in electrons a count, read noise in electrons."""
    shape = (count, 60, 80)
    counts = (random.poisson(electrons, shape) + random.normal(0, read, shape)) / gain + 30
    return moments(np.clip(np.round(counts), 0, WHITE).astype(np.uint16), white_level=WHITE)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("gain", "read"), [(10.0, 12.0), (3.0, 5.0)])
def test_gain_and_read_noise_are_those_of_the_sensor(seed: int, gain: float, read: float) -> None:
    random = np.random.default_rng(seed)
    dark = frames(random, 0, gain, read, 6)
    flats = [frames(random, part * 800 * gain, gain, read, 6) for part in (0.2, 0.5, 0.8)]
    found = photon_transfer(dark, flats)
    assert abs(found.electrons_per_count - gain) < 4 * found.electrons_per_count_sd + 0.003 * gain
    assert found.read_noise_electrons == pytest.approx(read, rel=0.05)


def test_pixels_that_saturate_or_are_bad_do_not_count() -> None:
    random = np.random.default_rng(9)
    dark = frames(random, 0, 10.0, 12.0, 6)
    good, full = frames(random, 4000, 10.0, 12.0, 6), frames(random, 9950, 10.0, 12.0, 6)
    bad = np.zeros((60, 80), bool)
    bad[:30] = True
    half = Moments(good.mean, np.where(bad, 1e6, good.variance), good.frames, good.saturated)
    found = photon_transfer(dark, [half, full], bad=bad)
    assert found.electrons_per_count == pytest.approx(10, rel=0.05)


def test_a_line_by_hand() -> None:
    found = fit_linearity(np.array([4.0, 1, 2, 3]), np.array([430.0, 130, 230, 330]), white_level=WHITE)
    assert (found.offset_counts, found.slope_counts_per_s) == pytest.approx((30, 100))
    assert found.deviation_percent == pytest.approx(0, abs=1e-9)
    assert found.saturates_at_counts is None


def test_saturation_ends_the_line_and_a_curve_is_told() -> None:
    times = np.arange(1.0, 9.0)
    straight = np.minimum(30 + 200 * times, WHITE)
    found = fit_linearity(times, straight, white_level=WHITE)
    assert found.slope_counts_per_s == pytest.approx(200)
    assert found.saturates_at_counts == WHITE
    assert np.isnan(found.deviation_counts[4:]).all()
    bent = 30 + 100 * times + 4 * (times - 4.5) ** 2
    assert fit_linearity(times, bent, white_level=WHITE).deviation_percent == pytest.approx(2.4, abs=0.8)


def test_frames_are_read_where_the_light_is() -> None:
    random = np.random.default_rng(3)
    light = np.where(np.arange(80) < 40, 10.0, 100.0) * np.ones((60, 1))
    times = np.array([1.0, 2, 4, 8])
    counts = 30 + times[:, None, None] * light + random.normal(0, 1, (4, 60, 80))
    found = fit_linearity(times, counts, white_level=WHITE)
    assert found.slope_counts_per_s == pytest.approx(100, rel=0.02)
    assert found.offset_counts == pytest.approx(30, abs=1)


def test_refusals() -> None:
    random = np.random.default_rng(1)
    dark, one = frames(random, 0, 10, 12, 3), frames(random, 4000, 10, 12, 1)
    with pytest.raises(KernelError, match="two dark frames are the least"):
        photon_transfer(one, [dark])
    with pytest.raises(KernelError, match="two flat frames of every level"):
        photon_transfer(dark, [one])
    with pytest.raises(KernelError, match="not noisier than the dark"):
        photon_transfer(dark, [frames(random, 1e6, 10, 12, 3)])
    with pytest.raises(KernelError, match="three different ones are the least"):
        fit_linearity(np.array([1.0, 1, 2]), np.array([10.0, 10, 20]), white_level=WHITE)

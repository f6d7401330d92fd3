"""The sensor: counts worked out by hand, its noise counted, and what its dark and flat frames hold."""

import numpy as np
import pytest

from lightstage.hw.sensor import ELECTRONS_PER_COUNT, OFFSET, READ_NOISE_ELECTRONS, Sensor


def even(size: int, dark: float = OFFSET, response: float = 1.0) -> Sensor:
    return Sensor(np.full((size, size), dark), np.full((size, size), response))


def test_noise_is_shot_and_read_noise() -> None:
    """Variance = counts / gain + read noise + rounding; 160,000 pixels know it to 0.4 %, so 2 % on every level."""
    generator = np.random.default_rng(0)
    for counts in (0.0, 50.0, 500.0):
        shown = even(400, dark=100).expose(np.full((400, 400), counts), generator).astype(float)
        expected = counts / ELECTRONS_PER_COUNT + (READ_NOISE_ELECTRONS / ELECTRONS_PER_COUNT) ** 2 + 1 / 12
        assert shown.mean() == pytest.approx(counts + 100, abs=0.1)
        assert shown.var() == pytest.approx(expected, rel=0.02)


def test_response_scales_the_light_and_not_the_dark() -> None:
    generator = np.random.default_rng(1)
    shown = even(200, response=0.5).expose(np.full((200, 200), 400.0), generator)
    assert shown.mean() == pytest.approx(16 + 200, abs=0.15)  # deviation 4.6 over 200


def test_counts_end_at_the_range() -> None:
    generator = np.random.default_rng(2)
    assert (even(20).expose(np.full((20, 20), 5000.0), generator) == 1023).all()
    assert (even(20, dark=-50).expose(np.zeros((20, 20)), generator) == 0).all()
    assert even(20).expose(np.full((20, 20), -300.0), generator).max() < 30  # light is never negative


def test_dark_and_flat_frames_by_hand() -> None:
    sensor = Sensor(np.array([[16.0, 15.5]]), np.array([[1.0, 0.9]]))
    assert sensor.dark_frame().tolist() == [[256, 248]]
    # level 0.7 x (1023 - 16) = 704.9: (16 + 704.9) x 16 = 11534.4; (15.5 + 634.41) x 16 = 10398.56
    assert sensor.flat_frame().tolist() == [[11534, 10399]]


def test_a_made_sensor_darkens_towards_its_corners_and_has_hot_pixels() -> None:
    hot = []
    for seed in range(4):
        sensor = Sensor.made((200, 400), np.random.default_rng(seed))
        # 0.27 of the square of the way, in widths: 0.0169 at the corner of 2:1; the pattern's 0.4 % over 400 pixels
        corner = sensor.response[:20, :20].mean() / sensor.response[90:110, 190:210].mean()
        assert corner == pytest.approx(1 - 0.27 * (0.475**2 + 0.225**2), abs=0.002)
        usual = sensor.dark[sensor.dark < OFFSET + 10]
        assert usual.std() == pytest.approx(0.4, rel=0.02)
        hot.append(int((sensor.dark > OFFSET + 25).sum()))
    assert hot == [2, 2, 2, 2]  # one in 40,000 of 80,000
    assert Sensor.made((8, 8), np.random.default_rng(0)).dark.max() > OFFSET + 25  # and never none

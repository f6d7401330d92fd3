"""Where spots are that were put at known places."""

import numpy as np
import pytest

from lightstage.kernels.targets.highlights import highlights
from tests.kernels.targets.spots import circle, picture

RING = {0: circle(70.0, 60.0, 45.0)}
WHITE = 1023


def test_a_spot_is_placed_to_hundredths_of_a_pixel() -> None:
    spot = highlights({0.0: picture([(75.37, 52.81)], [600])}, RING, white_level=WHITE)
    np.testing.assert_allclose(spot["at_px"][0], [75.37, 52.81], atol=0.02)  # counts are whole
    assert spot["peak"][0] == pytest.approx(600, rel=0.1)  # the middle lies between pixels
    assert spot["width_px"][0] == pytest.approx(1.2, rel=0.1)
    assert spot["saturated_px"][0] == 0
    assert np.isnan(spot["at_px"][1]).all()


def test_the_stronger_of_two_spots_comes_first() -> None:
    spot = highlights({0.0: picture([(60.0, 45.0), (85.0, 70.0)], [300, 700])}, RING, white_level=WHITE)
    np.testing.assert_allclose(spot["at_px"], [[85, 70], [60, 45]], atol=0.03)
    assert spot["flux"][0] > spot["flux"][1]


def test_a_saturated_spot_is_placed_by_its_area() -> None:
    spot = highlights({0.0: picture([(75.3, 52.8)], [8000], width_px=2.0)}, RING, white_level=WHITE)
    assert spot["saturated_px"][0] > 3
    np.testing.assert_allclose(spot["at_px"][0], [75.3, 52.8], atol=0.1)


def test_a_hot_pixel_and_what_is_beside_the_ball_are_no_spots() -> None:
    counts = picture([(10.0, 10.0)], [800])
    counts[60, 70] = 1000
    counts.flags.writeable = False
    spot = highlights({0.0: counts}, RING, white_level=WHITE)
    assert np.isnan(spot["at_px"]).all()
    assert np.isnan(spot["flux"]).all()


def test_the_mean_of_the_bands_is_measured() -> None:
    bands = {434.0: picture([(75.3, 52.8)], [200]), 576.0: picture([(75.3, 52.8)], [600])}
    both = highlights(bands, RING, white_level=WHITE)
    mean = highlights({0.0: picture([(75.3, 52.8)], [400])}, RING, white_level=WHITE)
    np.testing.assert_allclose(both["at_px"][0], mean["at_px"][0], atol=0.02)
    assert both["flux"][0] == pytest.approx(mean["flux"][0], rel=0.02)

"""Lights as they are written, and where they stand."""

import numpy as np
import pytest

from lightstage.kernels.appearance.distant_lights import DistantLight, parse_lights


def test_azimuth_goes_right_and_elevation_up() -> None:
    np.testing.assert_allclose(DistantLight(90, 0, 1).direction, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(DistantLight(0, 90, 1).direction, [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(DistantLight(0, 0, 1).direction, [0, 0, 1], atol=1e-12)


def test_lights_are_read_in_order() -> None:
    assert parse_lights("-30,15,0.5  30,15,1") == (DistantLight(-30, 15, 0.5), DistantLight(30, 15, 1))


@pytest.mark.parametrize("text", ["", "0,0", "0,0,0", "0,95,1", "a,b,c", "0,0,nan", "0,0,1 1,2"])
def test_a_wrong_light_is_named(text: str) -> None:
    with pytest.raises(ValueError, match="expected azimuth,elevation,strength"):
        parse_lights(text)

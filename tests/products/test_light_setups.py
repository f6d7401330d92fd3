"""The lights of relit pictures: where they are, how strong, and which of them make a picture."""

import numpy as np
import pytest

from lightstage.kernels.appearance.relighting import FAR_MM
from lightstage.products.errors import ProductError
from lightstage.products.light_setups import (
    Distant,
    direction,
    environment_lamps,
    led_pictures,
    one_picture,
    rig_lamps,
    turned,
)

PLACES = ((0, 0, 800.0), (600.0, 0, 0), (0, 600.0, 0), (0, -800.0, 0))
ITEM = {
    "lights": [
        {"id": f"L{k:02d}", "channel": k, "position_mm": list(place), "direction": None, "drive_position": None}
        | {"power": 1.0 - 0.5 * (k == 1), "seen": True}
        for k, place in enumerate(PLACES)
    ]
}


def test_directions() -> None:
    np.testing.assert_allclose(direction(0, 0), (0, 0, 1), atol=1e-12)
    np.testing.assert_allclose(direction(90, 0), (1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(direction(-30, 90), (0, 1, 0), atol=1e-12)
    np.testing.assert_allclose(turned(np.array([[0.0, 0.6, 0.8]]), 90), [[0.8, 0.6, 0]], atol=1e-12)


def test_distant_lights_and_an_environment_make_one_picture() -> None:
    sky = np.zeros((8, 16, 3), np.float32)
    sky[3, 8] = 1
    lamps = environment_lamps(sky, 4, rotate_deg=30)
    assert np.linalg.norm(lamps.places, axis=1) == pytest.approx(FAR_MM)
    (both,) = one_picture([Distant(90, 0, 2)], lamps, "sky.hdr turned by 30")
    assert (both.name, both.text) == ("environment_lights", "sky.hdr turned by 30 + (90, 0, 2)")
    assert both.turning == len(lamps.places)
    np.testing.assert_allclose(both.lamps.places[-1] / FAR_MM, (1, 0, 0), atol=1e-12)
    assert both.lamps.strength[-1].tolist() == [2, 2, 2]
    (alone,) = one_picture([Distant(0, 0, 1), Distant(0, 90, 1)], None)
    assert (alone.name, alone.turning, len(alone.lamps.places)) == ("lights", 0, 2)
    assert one_picture([], None) == []


def test_the_rig_s_lights_have_their_power_at_their_mean_distance() -> None:
    lamps = rig_lamps(ITEM)
    np.testing.assert_allclose(lamps["L01"].places, [[600, 0, 0]])
    assert lamps["L01"].strength.tolist() == [[0.5] * 3]
    assert lamps["L00"].reach_mm == pytest.approx(700)


def test_pictures_by_name() -> None:
    every = led_pictures(["all"], ITEM)
    assert [setup.name for setup in every] == ["L00", "L01", "L02", "L03"]
    (both,) = led_pictures(["L00+L01", "L00+L01"], ITEM)  # named twice, made once
    assert len(both.lamps.places) == 2
    with pytest.raises(
        ProductError, match=r"L07: the rig has no light 'L07'; did you mean 'L0.'.; it has L00 to L03"
    ):
        led_pictures(["L07"], ITEM)

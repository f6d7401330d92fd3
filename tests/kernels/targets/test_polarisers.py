"""Polarisers whose angles are known."""

import numpy as np
import pytest

from lightstage.kernels.targets.photometry import Aperture
from lightstage.kernels.targets.polarisers import Sensor, item, polarisers, verdict
from tests.kernels.targets.spots import OFFSET, circle, picture

PLACES = {0: (55.3, 50.6), 1: (80.1, 71.4), 2: (90.0, 45.7)}
BRIGHTEST_DEG = {0: 20.0, 1: 95.0, 2: 160.0}
LEFT = 0.02
"""Part of the highlight that remains at the right angle."""
ANGLES = (0.0, 30.0, 60.0, 90.0, 120.0, 150.0)


def highlight(light: int, angle: float) -> float:
    """Malus' law above what remains."""
    return 700 * (LEFT + (1 - LEFT) * float(np.cos(np.radians(angle - BRIGHTEST_DEG[light])) ** 2))


@pytest.fixture(scope="module")
def arrays() -> dict:
    names = [(light, angle) for light in PLACES for angle in ANGLES]
    spot = np.array([[np.nan, np.nan], [np.nan, np.nan]])
    shown = {name: np.array([PLACES[name[0]], spot[1]]) if highlight(*name) > 60 else spot for name in names}
    return dict(
        polarisers(
            {name: picture([PLACES[name[0]]], [highlight(*name)]) for name in names},
            shown,
            {name: np.array([highlight(*name) if highlight(*name) > 60 else np.nan, np.nan]) for name in names},
            {0: circle(70.0, 60.0, 45.0)},
            exposure=[1.0] * len(names),
            material="dielectric",
            sensor=Sensor(1023, np.full((120, 140), OFFSET)),
            aperture=Aperture(2.5, 10.0, 1.0),
        )
    )


def test_the_right_angle_is_across_the_brightest(arrays: dict) -> None:
    for k, light in enumerate(PLACES):
        off = (arrays["least_deg"][k] - BRIGHTEST_DEG[light] - 90 + 90) % 180 - 90
        assert abs(off) < 0.3  # counts are whole
    np.testing.assert_allclose(arrays["residual"], LEFT, atol=0.004)
    assert not arrays["grazing"].any()


def test_incidence_is_told_by_the_place_on_the_ball(arrays: dict) -> None:
    away = np.hypot(*(np.array(PLACES[0]) - [70, 60])) / 45
    assert arrays["incidence_deg"][0] == pytest.approx(np.degrees(np.arcsin(away)), abs=0.05)


def test_the_item_has_the_lights_with_a_fit(arrays: dict) -> None:
    labels = {"light": ["L00", "L01", "L02"]}
    unseen = {**arrays, "least_deg": np.array([np.nan, *arrays["least_deg"][1:]])}
    content = item(arrays=unseen, labels=labels)
    assert [light["id"] for light in content["lights"]] == ["L01", "L02"]
    assert content["lights"][0]["angle_deg"] == pytest.approx(5, abs=0.3)
    grazing = {**arrays, "grazing": np.array([False, True, False])}
    findings = verdict(arrays=grazing, labels=labels)
    assert any(severity == "doubtful" and "L01" in sentence for severity, sentence in findings)

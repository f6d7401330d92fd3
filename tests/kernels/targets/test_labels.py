"""Labels mean what the arrays beside them hold: OpenCV's order, and the lengths that kernels give."""

import cv2
import numpy as np
import pytest

from lightstage.hw import illuminations
from lightstage.kernels.targets import labels
from lightstage.kernels.targets.flat import flat
from lightstage.kernels.targets.highlights import highlights
from tests.kernels.targets.spots import circle, picture

X, Y = 0.3, 0.2
R2 = X * X + Y * Y
# Brown's model: what one part of each coefficient moves a point (x, y) of the unit plane by
BROWN = {
    "k1": (X * R2, Y * R2),
    "k2": (X * R2**2, Y * R2**2),
    "p1": (2 * X * Y, R2 + 2 * Y * Y),
    "p2": (R2 + 2 * X * X, 2 * X * Y),
    "k3": (X * R2**3, Y * R2**3),
}


def projected(values: dict[str, float]) -> np.ndarray:
    """OpenCV's projection with its parameters in the order of the labels."""
    fx, fy, cx, cy, *lens = (values.get(name, 0.0) for name in labels.CAMERA_PARAMETERS)
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    point = np.array([[[X, Y, 1.0]]])
    return cv2.projectPoints(point, np.zeros(3), np.zeros(3), matrix, np.array(lens))[0].ravel()


@pytest.mark.parametrize("name", BROWN)
def test_a_lens_coefficient_is_where_opencv_has_it(name: str) -> None:
    plain = {"fx": 1000.0, "fy": 800.0, "cx": 100.0, "cy": 50.0}
    np.testing.assert_allclose(projected(plain), [1000 * X + 100, 800 * Y + 50])
    moved = projected({**plain, name: 0.01}) - projected(plain)
    np.testing.assert_allclose(moved, 0.01 * np.array(BROWN[name]) * [1000, 800], atol=1e-9)


def test_an_outline_has_a_point_every_half_degree() -> None:
    assert 360 / labels.OUTLINE_POINTS == 0.5


def test_test_patterns_are_illuminations_and_dark() -> None:
    assert all(illuminations.is_known(name) for name in labels.TEST_PATTERNS)
    assert [illuminations.test_number(name) for name in labels.TEST_PATTERNS[:-1]] == list(
        range(illuminations.TEST_PATTERNS)
    )
    assert labels.TEST_PATTERNS[-1] == illuminations.DARK


def test_kernels_give_as_many_values_as_there_are_labels() -> None:
    frames = {(0.1, 0): np.full((8, 8), 500, np.uint16)}
    numbers = flat(frames, {}, white_level=1023, dark_picture=np.full((8, 8), 16.0))["numbers"]
    assert np.shape(numbers) == (len(labels.FLAT_NUMBERS),)
    assert numbers[labels.FLAT_NUMBERS.index("frames")] == 1
    assert numbers[labels.FLAT_NUMBERS.index("dark_known")] == 1
    spots = highlights({0.0: picture([(75.0, 52.0)], [600])}, {0: circle(70.0, 60.0, 45.0)}, white_level=1023)
    assert spots["at_px"].shape == (labels.SPOTS, 2)


def test_no_label_stands_twice() -> None:
    for names in (labels.LIGHT_STATUS, labels.CAMERA_PARAMETERS, labels.FLAT_NUMBERS, labels.TEST_PATTERNS):
        assert len(set(names)) == len(names)
    assert labels.LIGHT_STATUS[0] == "seen"

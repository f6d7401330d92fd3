"""The reference camera, by hand."""

import pytest

from lightstage.hw.cameras import reference_camera, reference_index


@pytest.mark.parametrize(
    ("cameras", "name", "index"),
    [
        ({"parallel": "CAM0", "cross": "CAM1"}, "CAM1", 1),
        ({"cross": "CAM1", "parallel": "CAM0"}, "CAM1", 0),
        ({"parallel": "CAM0"}, "CAM0", 0),
        ({"unpolarised": "CAM"}, "CAM", 0),
    ],
)
def test_it_is_the_cross_camera_or_the_only_one(cameras: dict[str, str], name: str, index: int) -> None:
    assert reference_camera(cameras) == name
    assert reference_index(list(cameras)) == index

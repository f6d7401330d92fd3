"""Which part of the calibration items a picture's registration reads."""

from typing import Any

import numpy as np
import pytest

from lightstage.dag.stage import StageError
from lightstage.stages.register import STAGE, RegisterParams

FACTS: dict[str, Any] = {
    "cameras": {"parallel": "CAM0", "cross": "CAM1"},
    "polarisation": ["parallel", "cross"],
    "mount": {},
    "shape": (6, 8),
    "white_level": 1023,
}
MAP = np.array([[1.002, 0.004, -2.3], [-0.003, 0.998, 1.4], [1e-5, -2e-5, 1]])


def homography(matrix: Any, start: str = "CAM0", end: str = "CAM1") -> Any:
    assert STAGE.context is not None
    item = {"from": start, "to": end, "matrix": np.asarray(matrix, float).tolist()}
    return STAGE.context({}, FACTS, {"homography": item}, RegisterParams())["homography"]


def test_equal_maps_are_one_map() -> None:
    """Scaled by a power of two, and by a shift the other way round, to the bit; otherwise to the last digits."""
    assert homography(4 * MAP) == homography(MAP)
    shift = [[1, 0, -1], [0, 1, 0], [0, 0, 1]]
    assert homography([[2, 0, 2], [0, 2, 0], [0, 0, 2]], "CAM1", "CAM0") == homography(shift)
    np.testing.assert_allclose(
        homography(np.linalg.inv(MAP), "CAM1", "CAM0"), homography(MAP), rtol=1e-12, atol=1e-14
    )


def test_a_map_that_sends_the_origin_to_infinity_has_a_scale() -> None:
    np.testing.assert_array_equal(
        homography([[0, 0, 4], [0, 2, 0], [4, 0, 0]]), [[0, 0, 1], [0, 0.5, 0], [1, 0, 0]]
    )


def test_a_map_of_other_cameras_is_refused() -> None:
    with pytest.raises(StageError, match="goes from CAM7 to CAM1; one from CAM0 to CAM1 is needed"):
        homography(MAP, "CAM7")

"""Boards seen by both cameras."""

import pytest

from lightstage.dag.stage import StageError
from lightstage.stages.calibration.homography import STAGE
from tests.stages.calibration.grids import BALL, BOARD, context, corners


def test_all_that_is_measured_of_a_board_is_read_by_camera_and_frame() -> None:
    arranged = STAGE.arrange([corners(2)], BOARD, STAGE.params())
    (group,) = arranged.groups
    boards = {
        ("parallel", 0): {"frame": 0, "polarisation": 0},
        ("parallel", 1): {"frame": 1, "polarisation": 0},
        ("cross", 0): {"frame": 0, "polarisation": 1},
        ("cross", 1): {"frame": 1, "polarisation": 1},
    }
    assert group.reads == dict.fromkeys(("points", "covariance", "first_is_black"), boards)
    assert arranged.grid.sizes["corner"] == 2 * 3 * 4


def test_it_is_told_how_the_parallel_camera_is_mounted() -> None:
    # upright it is 12 rows of 8
    assert context(STAGE, {}, BOARD, {}) == {
        "size": [12, 8],
        "mount": {"rotate": 90, "mirror": True},
        "camera": "CAM0",
    }


def test_one_camera_alone_and_another_target_are_refused() -> None:
    with pytest.raises(StageError, match=r"seen by the parallel and the cross camera; this capture has cross$"):
        STAGE.arrange([corners(2, ["cross"])], BOARD, STAGE.params())
    with pytest.raises(StageError, match=r"measuring the homography needs .* this one shows mirror_ball"):
        STAGE.arrange([corners(2)], BALL, STAGE.params())
    with pytest.raises(ValueError, match="sampson"):
        STAGE.params(method="algebraic")

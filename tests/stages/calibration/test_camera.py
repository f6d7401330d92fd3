"""Which boards tell the camera."""

import pytest

from lightstage.dag.stage import StageError
from lightstage.stages.calibration.camera import STAGE
from tests.stages.calibration.grids import BALL, BOARD, context, corners


def test_all_boards_of_the_reference_camera_are_read_by_their_frame() -> None:
    arranged = STAGE.arrange([corners(3)], BOARD, STAGE.params())
    (group,) = arranged.groups
    assert group.reads == {"points": {i: {"frame": i, "polarisation": 1} for i in range(3)}}
    assert arranged.grid.attrs["size_px"] == [12, 8]
    assert arranged.grid.sizes["picture"] == 3
    assert arranged.grid.along("parameter") == ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"]


def test_a_single_camera_is_the_reference_and_upright() -> None:
    facts = {**BOARD, "cameras": {"parallel": "CAM0"}}  # mounted on its side
    arranged = STAGE.arrange([corners(1, ["parallel"])], facts, STAGE.params())
    assert arranged.groups[0].reads["points"] == {0: {"frame": 0, "polarisation": 0}}
    assert arranged.grid.attrs["size_px"] == [8, 12]


def test_of_the_items_it_gets_the_matrix_alone() -> None:
    matrix = [[1.0, 0, 2], [0, 1, 0], [0, 0, 1]]
    items = {"homography": {"from": "CAM0", "to": "CAM1", "matrix": matrix, "residuals": {"rms_px": 1}}}
    assert context(STAGE, {}, BOARD, items) == {"square_mm": 12.0, "size": [8, 12], "homography": matrix}
    assert context(STAGE, {}, BOARD, {})["homography"] is None


def test_another_target_is_refused() -> None:
    with pytest.raises(StageError, match=r"measuring the camera needs .* this one shows mirror_ball"):
        STAGE.arrange([corners(1)], BALL, STAGE.params())
    with pytest.raises(ValueError, match="greater than 0"):
        STAGE.params(distance_mm=0.0)

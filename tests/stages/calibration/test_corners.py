"""One block a frame and a camera, with how that camera is mounted."""

import pytest

from lightstage.dag.stage import StageError
from lightstage.stages.calibration.corners import STAGE
from tests.stages.calibration.grids import BOARD, FACTS, context, raw


def test_a_block_reads_all_bands_of_one_camera_in_one_frame() -> None:
    arranged = STAGE.arrange([raw(["C", "C"], bands=(434.0, 576.0))], BOARD, STAGE.params())
    assert len(arranged.groups) == 4  # C order: frame, then camera
    assert arranged.groups[1].reads["raw"] == {
        434.0: {"frame": 0, "band": 0, "polarisation": 1},
        576.0: {"frame": 0, "band": 1, "polarisation": 1},
    }
    assert arranged.groups[2].reads["raw"][434.0] == {"frame": 1, "band": 0, "polarisation": 0}
    # inner_corners are columns x rows
    assert dict(arranged.grid.sizes) == {"frame": 2, "polarisation": 2, "row": 3, "column": 4, "xy": 2, "value": 4}
    assert set(arranged.grid.labels) == {"illumination", "polarisation"}


def test_each_camera_is_told_its_own_mount() -> None:
    common = {"inner_corners": [4, 3], "white_level": 1023}
    assert context(STAGE, {"polarisation": "parallel"}, BOARD, {}) == {
        **common, "camera": "CAM0", "rotate": 90, "mirror": True,
    }  # fmt: skip
    assert context(STAGE, {"polarisation": "cross"}, BOARD, {}) == {
        **common, "camera": "CAM1", "rotate": 0, "mirror": False,
    }  # fmt: skip


def test_a_capture_without_a_board_is_refused() -> None:
    with pytest.raises(StageError, match=r"measuring corners needs a capture with target: {kind: checkerboard"):
        STAGE.arrange([raw(["C"])], FACTS, STAGE.params())

"""Which pictures show the ball's outline, place by place."""

from typing import Any

import pytest

from lightstage.dag.stage import StageError
from lightstage.stages.calibration.outline import STAGE, picked
from tests.stages.calibration.grids import BALL, BOARD, CAMERA, context, raw


def test_points_by_hand_are_read() -> None:
    assert picked(" ") is None
    assert picked("1,2 3.5,4") == [[1.0, 2.0], [3.5, 4.0]]
    for text in ("1,2 3", "1,2,3", "a,b", "nan,1"):
        with pytest.raises(StageError, match="is not x,y"):
            picked(text)


def test_every_place_is_told_by_its_pictures_under_all_lights() -> None:
    grid = raw(["L00", "C", "C", "L00", "C"], bands=(434.0, 576.0))
    arranged = STAGE.arrange([grid], {**BALL, "part": [0, 0, 0, 5, 5]}, STAGE.params())
    assert arranged.grid.along("part") == [0, 5]
    assert [sorted({name[0] for name in group.reads["raw"]}) for group in arranged.groups] == [[1, 2], [4]]  # type: ignore[index]
    assert arranged.groups[1].reads["raw"] == {
        (4, 434.0): {"frame": 4, "band": 0, "polarisation": 1},
        (4, 576.0): {"frame": 4, "band": 1, "polarisation": 1},
    }


@pytest.mark.parametrize(("facts", "params"), [({"mask": "a mask"}, {}), ({}, {"points": "1,2 3,4"})])
def test_who_says_where_the_ball_is_needs_no_picture_under_all_lights(facts: Any, params: Any) -> None:
    grid = raw(["L00", "L01", "O"])
    (group,) = STAGE.arrange([grid], {**BALL, **facts}, STAGE.params(**params)).groups
    assert list(group.reads["raw"]) == [(0, 0.0), (1, 0.0)]


def test_otherwise_the_missing_picture_is_named() -> None:
    with pytest.raises(StageError, match=r"illumination C\) is missing; add it, or a mask"):
        STAGE.arrange([raw(["L00"])], BALL, STAGE.params())
    with pytest.raises(StageError, match=r"illumination C\) is missing at place 1 of the ball; add it"):
        STAGE.arrange([raw(["C", "L00"])], {**BALL, "part": [0, 1]}, STAGE.params())
    with pytest.raises(StageError, match=r"finding the ball needs .* this one shows checkerboard"):
        STAGE.arrange([raw(["C"])], BOARD, STAGE.params())


def test_where_the_camera_stands_does_not_count() -> None:
    part = context(STAGE, {}, BALL, {"camera": CAMERA}, points="1,2")
    assert set(part["camera"]) == {"size_px", "K", "distortion"}
    assert (part["mask"], part["by_hand"]) == (None, [[1.0, 2.0]])
    assert "world_to_camera" in CAMERA
    assert context(STAGE, {}, BALL, {})["camera"] is None

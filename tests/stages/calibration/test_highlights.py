"""Each picture with the outline at its place."""

from lightstage.stages.calibration.highlights import STAGE
from tests.stages.calibration.grids import BALL, context, outline, raw


def test_an_outline_is_read_at_the_place_of_the_picture_by_whatever_number_it_has() -> None:
    grids = [raw(["L00", "L01", "O"], bands=(434.0, 576.0)), outline(0, 2)]
    arranged = STAGE.arrange(grids, {"part": [0, 2, 2]}, STAGE.params())
    assert [dict(group.reads["ring"]) for group in arranged.groups] == [
        {0: {"part": 0}},
        {2: {"part": 1}},
        {2: {"part": 1}},
    ]
    assert arranged.groups[1].reads["raw"] == {
        434.0: {"frame": 1, "band": 0, "polarisation": 1},
        576.0: {"frame": 1, "band": 1, "polarisation": 1},
    }


def test_two_spots_of_every_picture_are_told() -> None:
    grid = STAGE.arrange([raw(["L00", "C"]), outline(0)], BALL, STAGE.params()).grid
    assert dict(grid.sizes) == {"frame": 2, "spot": 2, "xy": 2}
    assert grid.labels["frame"] == (("frame",), [0, 1])
    assert grid.along("illumination") == ["L00", "C"]


def test_a_block_is_told_the_white_level_alone() -> None:
    assert context(STAGE, {}, BALL, {}) == {"white_level": 1023}

"""One picture a light, one without, and the sequence under test."""

from typing import Any

import pytest

from lightstage.dag.stage import Grid, StageError
from lightstage.stages.calibration.synchronisation import STAGE
from tests.stages.calibration.grids import BALL, FACTS, context, raw

ANYTHING = Grid({}, {})
NAMES = ["L00", "L01", "C", "O", "T0", "T1", "O"]


def arranged(names: list[str], facts: dict[str, Any] = BALL) -> Any:
    return STAGE.arrange([raw(names), ANYTHING], facts, STAGE.params())


def test_single_lights_go_by_number_and_tests_by_frame_and_what_was_meant() -> None:
    arrangement = arranged(NAMES)
    (group,) = arrangement.groups

    def at(i: int) -> dict[str, int]:
        return {"frame": i, "band": 0, "polarisation": 1}

    assert group.reads == {
        "one_light": {0: at(0), 1: at(1)},
        "unlit": {3: at(3)},  # the first that has no light
        "test": {(4, "T0"): at(4), (5, "T1"): at(5)},
        "at_px": {0: {"frame": 0}, 1: {"frame": 1}},
    }
    assert arrangement.grid.labels["frame"] == (("frame",), [4, 5])
    assert arrangement.grid.along("light") == ["L00", "L01"]


@pytest.mark.parametrize(
    ("names", "counts"),
    [(["O", "T0", "T1"], "0, 1 and 2"), (["L00", "T0", "T1"], "1, 0 and 2"), (["L00", "O", "T0"], "1, 1 and 1")],
)
def test_what_is_missing_is_counted(names: list[str], counts: str) -> None:
    with pytest.raises(StageError, match=f"this capture has {counts} of them"):
        arranged(names)


@pytest.mark.parametrize("names", [["L01", "L00", *NAMES[2:]], ["L00", "L00", *NAMES[2:]]])
def test_lights_out_of_order_or_twice_are_refused(names: list[str]) -> None:
    with pytest.raises(StageError, match="each light needs one picture, in the order of their numbers"):
        arranged(names)


def test_another_target_is_refused_and_a_block_is_told_the_white_level_alone() -> None:
    with pytest.raises(StageError, match=r"checking the synchronisation needs .* names no target"):
        arranged(NAMES, FACTS)
    assert context(STAGE, {}, BALL, {}) == {"white_level": 1023}

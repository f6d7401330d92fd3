"""Which frames are dark, and of which exposure."""

from typing import Any

import pytest

from lightstage.dag.stage import StageError
from lightstage.stages.calibration.dark import STAGE, dark_frames
from tests.stages.calibration.grids import FACTS, context, raw

TIMED: dict[str, Any] = {**FACTS, "exposure_s": [0.1, 0.2, 0.2, 0.1, 0.2]}
FRAMES = raw(["O", "O", "O", "C", "O"], bands=(434.0, 576.0))


@pytest.mark.parametrize(("asked", "frames"), [(0.0, [1, 2, 4]), (0.1, [0]), (0.2, [1, 2, 4])])
def test_dark_frames_are_those_of_the_most_frequent_exposure_or_the_one_asked_for(
    asked: float, frames: list[int]
) -> None:
    assert dark_frames(TIMED, FRAMES, asked) == frames


def test_a_target_called_dark_is_dark_whatever_its_illumination() -> None:
    facts = {**FACTS, "target": {"kind": "dark"}}
    assert dark_frames(facts, raw(["C", "C"]), 0.0) == [0, 1]


def test_one_block_a_camera_reads_every_band_of_every_dark_frame() -> None:
    arranged = STAGE.arrange([FRAMES], TIMED, STAGE.params(exposure_s=0.1))
    assert [group.reads["raw"] for group in arranged.groups] == [
        {(0, nm): {"frame": 0, "band": b, "polarisation": p} for b, nm in enumerate((434.0, 576.0))} for p in (0, 1)
    ]
    assert arranged.grid.attrs == {"frames": 1, "exposure_s": 0.1}
    assert "exposure_s" not in STAGE.arrange([FRAMES], FACTS, STAGE.params()).grid.attrs


def test_what_is_missing_is_named() -> None:
    with pytest.raises(StageError, match=r"exposure_s: no dark frame has 0\.5 s \(there are 0\.1, 0\.2\)"):
        dark_frames(TIMED, FRAMES, 0.5)
    with pytest.raises(StageError, match=r"no dark frame has 0\.5 s \(there are none with a time\)"):
        dark_frames(FACTS, FRAMES, 0.5)
    with pytest.raises(StageError, match="measuring the dark needs frames without light: illumination O"):
        dark_frames(FACTS, raw(["C", "X"]), 0.0)


def test_a_block_is_told_the_white_level_alone() -> None:
    assert context(STAGE, {"polarisation": "cross"}, TIMED, {}) == {"white_level": 1023}

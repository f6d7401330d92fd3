"""Which pictures tell the bands, and how bright the target is in each."""

from typing import Any

import pytest

from lightstage.dag.stage import StageError
from lightstage.stages.calibration.bands import STAGE
from tests.stages.calibration.grids import FACTS, context, raw, stored

NM = (434.0, 576.0)


def white(reflectance: Any = None) -> dict[str, Any]:
    return {**FACTS, "target": {"kind": "white", **({} if reflectance is None else {"reflectance": reflectance})}}


def test_one_block_reads_the_first_frame_of_the_reference_camera_in_every_band() -> None:
    arranged = STAGE.arrange([raw(["C", "C"], bands=NM)], white(0.99), STAGE.params())
    (group,) = arranged.groups
    assert group.reads["raw"] == {
        434.0: {"frame": 0, "band": 0, "polarisation": 1},
        576.0: {"frame": 0, "band": 1, "polarisation": 1},
    }
    assert arranged.grid.along("band") == list(NM)
    assert arranged.grid.sizes["patch"] == len(arranged.grid.along("patch")) == 24


@pytest.mark.parametrize(
    ("captured", "asked", "used"),
    [(0.99, 0.0, [0.99, 0.99]), ([0.9, 0.95], 0.0, [0.9, 0.95]), (0.99, 0.5, [0.5, 0.5]), (None, 0.5, [0.5, 0.5])],
)
def test_reflectance_is_the_captures_unless_somebody_says_otherwise(captured: Any, asked: float, used: Any) -> None:
    arranged = STAGE.arrange([raw(["C"], bands=NM)], white(captured), STAGE.params(reflectance=asked))
    assert arranged.groups[0].labels == {"reflectances": used}


def test_what_is_not_known_or_does_not_fit_is_refused() -> None:
    with pytest.raises(StageError, match="the white target's reflectance is not known; write target"):
        STAGE.arrange([raw(["C"], bands=NM)], white(), STAGE.params())
    with pytest.raises(StageError, match="the target names 3 reflectances for 2 bands"):
        STAGE.arrange([raw(["C"], bands=NM)], white([0.9, 0.9, 0.9]), STAGE.params())
    with pytest.raises(StageError, match=r"measuring the bands needs a capture with target: {kind: white"):
        STAGE.arrange([raw(["C"], bands=NM)], {**FACTS, "target": {"kind": "flat"}}, STAGE.params())


def test_of_the_items_it_gets_the_pictures_of_its_camera() -> None:
    items = stored("dark", "CAM0", "CAM1") | stored("flat", "CAM1", dark_included=True)
    part = context(STAGE, {"reflectances": [0.9]}, white(0.9), items)
    assert part["target_reflectance"] == [0.9]
    assert part["white_level"] == 1023
    assert part["dark"]["picture"].digest == "dark-CAM1"
    assert (part["flat"]["picture"].digest, part["flat"]["dark_included"]) == ("flat-CAM1", True)
    bare = context(STAGE, {"reflectances": [0.9]}, white(0.9), {})
    assert (bare["dark"], bare["flat"]) == (None, None)

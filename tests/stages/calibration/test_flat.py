"""Lit frames by their exposure, unlit ones beside them."""

import pytest

from lightstage.dag.stage import StageError
from lightstage.stages.calibration.flat import STAGE
from tests.stages.calibration.grids import FACTS, context, raw, stored

EVEN = {**FACTS, "target": {"kind": "flat"}}


def test_lit_frames_are_called_by_exposure_and_frame_and_unlit_ones_by_frame() -> None:
    facts = {**EVEN, "exposure_s": [0.1, None, 0.2, 0.1]}
    arranged = STAGE.arrange([raw(["C", "C", "C", "O"])], facts, STAGE.params())
    assert len(arranged.groups) == 2  # one a camera
    assert arranged.groups[1].reads == {
        "lit": {
            (0.1, 0): {"frame": 0, "band": 0, "polarisation": 1},
            (0.0, 1): {"frame": 1, "band": 0, "polarisation": 1},
            (0.2, 2): {"frame": 2, "band": 0, "polarisation": 1},
        },
        "unlit": {3: {"frame": 3, "band": 0, "polarisation": 1}},
    }
    assert arranged.grid.sizes["number"] == len(arranged.grid.along("number"))


def test_without_unlit_frames_there_are_none_to_read() -> None:
    white = {**FACTS, "target": {"kind": "white"}}
    (group,) = STAGE.arrange([raw(["C"], cameras=["unpolarised"])], white, STAGE.params()).groups
    assert group.reads["unlit"] == {}


@pytest.mark.parametrize(("facts", "names"), [(EVEN, ["O", "X"]), (FACTS, ["C"])])
def test_no_even_target_or_no_light_is_refused(facts: dict[str, object], names: list[str]) -> None:
    with pytest.raises(StageError, match=r"needs frames of an even target under C, and target: {kind: flat}"):
        STAGE.arrange([raw(names)], facts, STAGE.params())


def test_each_camera_gets_its_own_dark() -> None:
    items = stored("dark", "CAM0")
    part = context(STAGE, {"polarisation": "parallel"}, EVEN, items)
    assert (part["white_level"], part["dark"]["picture"].digest) == (1023, "dark-CAM0")
    assert context(STAGE, {"polarisation": "cross"}, EVEN, items)["dark"] is None

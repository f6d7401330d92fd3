"""What the calibration stages say of themselves, and what they ask of a session."""

import subprocess
import sys
from importlib import import_module
from typing import Any

import pytest

from lightstage.dag.stage import Grid, Result, Stage, StageError, evaluate, function
from lightstage.stages import TABLE
from lightstage.stages.calibration import MEASURED, STEPS, highlights, lights, outline, polarisers
from lightstage.stages.calibration.dark import dark_frames
from lightstage.store.calibration import KINDS


def stage_of(name: str) -> Stage:
    found: Stage = import_module(TABLE[name]).STAGE
    return found


def test_what_is_measured_has_a_verdict_and_items_are_kinds_of_the_store() -> None:
    assert {name for name in MEASURED if stage_of(name).verdict is None} == set()
    assert {name for name in MEASURED if stage_of(name).item is not None} == set(KINDS)
    assert all(stage_of(name).item is None and stage_of(name).verdict is None for name in STEPS)


@pytest.mark.parametrize("name", [*MEASURED, *STEPS])
def test_all_that_a_stage_names_is_there(name: str) -> None:
    stage = stage_of(name)
    for named in (stage.kernel, stage.prepare, stage.item, stage.verdict):
        assert named is None or callable(function(named))


def test_declarations_load_no_numerics() -> None:
    code = (
        "import sys; from importlib import import_module; from lightstage.stages import TABLE\n"
        "from lightstage.stages.calibration import MEASURED, STEPS\n"
        "for name in (*MEASURED, *STEPS): import_module(TABLE[name])\n"
        "print(*(name for name in ('numpy', 'cv2', 'scipy', 'numba') if name in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_a_function_gets_the_fields_of_a_result_that_it_names() -> None:
    result = Result({"matrix": [[1.0]]}, {}, {}, {"cameras": {"parallel": "CAM0", "cross": "CAM1"}}, {})
    arrays = dict.fromkeys(("rms_px", "sampson_px", "geometric_px"), 0.0)
    content = evaluate(
        stage_of("homography").item or "", Result({**result.arrays, **arrays}, {}, {}, result.facts, {})
    )
    assert (content["from"], content["matrix"]) == ("CAM0", [[1.0]])


@pytest.mark.parametrize(
    ("count", "layout", "sphere"),
    [
        (41, "auto", {"frequency": 2, "whole": False}),
        (42, "auto", {"frequency": 2, "whole": True}),
        (161, "4", {"frequency": 4, "whole": False}),
        (40, "auto", None),
        (41, "none", None),
    ],
)
def test_a_layout_is_told_by_the_number_of_lights(count: int, layout: str, sphere: object) -> None:
    assert lights.geodesic(count, layout) == sphere


def test_a_layout_of_another_number_of_lights_is_refused() -> None:
    with pytest.raises(StageError, match="layout: 3 has 91 or 92 lights, the capture names 41"):
        lights.geodesic(41, "3")


def test_points_by_hand_are_read() -> None:
    assert outline.picked(" ") is None
    assert outline.picked("1,2 3.5,4") == [[1.0, 2.0], [3.5, 4.0]]
    for text in ("1,2 3", "1,2,3", "a,b", "nan,1"):
        with pytest.raises(StageError, match="is not x,y"):
            outline.picked(text)


def raw(illumination: list[str]) -> Grid:
    return Grid(
        {"frame": len(illumination), "band": 1, "polarisation": 2, "y": 8, "x": 8},
        {
            "illumination": (("frame",), illumination),
            "band": (("band",), [0.0]),
            "polarisation": (("polarisation",), ["parallel", "cross"]),
        },
    )


def places(*part: int) -> Grid:
    return Grid({"part": len(part)}, {"part": (("part",), list(part))})


def test_an_outline_is_read_at_the_place_of_the_picture_by_whatever_number_it_has() -> None:
    arrangement = highlights.STAGE.arrange(
        [raw(["L00", "L01"]), places(0, 2)], {"part": [0, 2]}, highlights.HighlightsParams()
    )
    assert [dict(group.reads["ring"]) for group in arrangement.groups] == [{0: {"part": 0}}, {2: {"part": 1}}]
    assert arrangement.groups[0].reads["raw"] == {0.0: {"frame": 0, "band": 0, "polarisation": 1}}


BALL: dict[str, Any] = {"target": {"kind": "mirror_ball"}}


def test_a_place_without_a_picture_under_one_light_is_refused() -> None:
    grids = [raw(["C", "L00", "L01", "C"]), Grid({}, {}), places(0, 1)]
    with pytest.raises(StageError, match="place 1 of the ball has no picture under one light"):
        lights.STAGE.arrange(grids, {**BALL, "part": [0, 0, 0, 1]}, lights.LightsParams())


def test_a_light_that_is_seen_twice_at_one_angle_is_refused() -> None:
    facts = {**BALL, "polariser_deg": [0.0, 30.0, 30.0]}
    with pytest.raises(StageError, match=r"L00 has two pictures at 30 degrees \(frames 1 and 2\)"):
        polarisers.STAGE.arrange([raw(["L00"] * 3), Grid({}, {}), places(0)], facts, polarisers.PolarisersParams())


def test_dark_frames_are_those_of_the_most_frequent_exposure_or_the_one_asked_for() -> None:
    facts = {"target": None, "exposure_s": [0.1, 0.2, 0.2, 0.1, 0.2]}
    frames = raw(["O", "O", "O", "C", "O"])
    assert dark_frames(facts, frames, 0.0) == [1, 2, 4]
    assert dark_frames(facts, frames, 0.1) == [0]
    with pytest.raises(StageError, match=r"no dark frame has 0\.5 s \(there are 0\.1, 0\.2\)"):
        dark_frames(facts, frames, 0.5)

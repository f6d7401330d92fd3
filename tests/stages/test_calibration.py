"""What holds for all stages that measure the rig; each has a file of its own in `calibration/`."""

from importlib import import_module

from lightstage.dag.stage import Result, Stage, evaluate
from lightstage.stages import TABLE
from lightstage.stages.calibration import MEASURED, STEPS
from lightstage.store.calibration import KINDS


def stage_of(name: str) -> Stage:
    found: Stage = import_module(TABLE[name]).STAGE
    return found


def test_what_is_measured_has_a_verdict_and_items_are_kinds_of_the_store() -> None:
    assert {name for name in MEASURED if stage_of(name).verdict is None} == set()
    assert {name for name in MEASURED if stage_of(name).item is not None} == set(KINDS)
    assert all(stage_of(name).item is None and stage_of(name).verdict is None for name in STEPS)


def test_a_function_gets_the_fields_of_a_result_that_it_names() -> None:
    result = Result({"matrix": [[1.0]]}, {}, {}, {"cameras": {"parallel": "CAM0", "cross": "CAM1"}}, {})
    arrays = dict.fromkeys(("rms_px", "sampson_px", "geometric_px"), 0.0)
    content = evaluate(
        stage_of("homography").item or "", Result({**result.arrays, **arrays}, {}, {}, result.facts, {})
    )
    assert (content["from"], content["matrix"]) == ("CAM0", [[1.0]])

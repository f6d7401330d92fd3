"""Each light at each angle once."""

from typing import Any

import pytest

from lightstage.dag.stage import Grid, StageError
from lightstage.stages.calibration.polarisers import STAGE
from tests.stages.calibration.grids import BALL, FACTS, context, outline, raw, stored

ANYTHING = Grid({}, {})
NAMES = ["L00", "L00", "L03", "C"]


def arranged(names: list[str], places: Grid | None = None, **facts: Any) -> Any:
    return STAGE.arrange([raw(names), ANYTHING, places or outline(0)], {**BALL, **facts}, STAGE.params())


def test_pictures_are_called_by_light_and_angle() -> None:
    arrangement = arranged(NAMES, polariser_deg=[0, 30, 0, None], exposure_s=[0.5, None, 2.0, 1.0])
    (group,) = arrangement.groups
    frames = {(0, 0.0): 0, (0, 30.0): 1, (3, 0.0): 2}
    assert group.reads["raw"] == {name: {"frame": i, "band": 0, "polarisation": 1} for name, i in frames.items()}
    assert group.reads["at_px"] == group.reads["peak"] == {name: {"frame": i} for name, i in frames.items()}
    assert group.reads["ring"] == {0: {"part": 0}}
    assert group.labels == {"exposure": [0.5, 1.0, 2.0]}  # in the order of the pictures; one where it is not said
    assert arrangement.grid.along("light") == ["L00", "L03"]
    assert arrangement.grid.along("angle") == [0.0, 30.0]


@pytest.mark.parametrize(
    ("names", "facts", "sentence"),
    [
        (
            ["L00"] * 3,
            {"polariser_deg": [0.0, 30.0, 30.0]},
            r"L00 has two pictures at 30 degrees \(frames 1",
        ),
        (NAMES, {}, "needs frames with polariser_deg"),
        (["C"], {"polariser_deg": [0.0]}, "needs frames with polariser_deg"),
        (["L00", "L00"], {"polariser_deg": [0.0, 30.0], "part": [0, 1]}, "needs the ball at one place"),
        (["C"], {"target": {"kind": "white"}}, "measuring the polarisers needs .* this one shows white"),
    ],
)
def test_what_is_wrong_is_named(names: list[str], facts: dict[str, Any], sentence: str) -> None:
    with pytest.raises(StageError, match=sentence):
        arranged(names, **facts)


def test_a_ball_at_two_places_is_refused() -> None:
    with pytest.raises(StageError, match="measure each place by itself"):
        arranged(["L00"], outline(0, 1), polariser_deg=[0.0])


def test_a_ball_is_metal_unless_the_capture_says_otherwise() -> None:
    part = context(STAGE, {"exposure": [1.0]}, BALL, stored("dark", "CAM1"))
    assert (part["material"], part["exposure"], part["white_level"]) == ("metal", [1.0], 1023)
    assert part["dark"]["picture"].digest == "dark-CAM1"
    plastic = {**FACTS, "target": {"kind": "mirror_ball", "material": "dielectric"}}
    assert context(STAGE, {"exposure": [1.0]}, plastic, {})["material"] == "dielectric"

"""Which pictures tell the lights, on which sphere they may be, and what is refused before anything is computed."""

from typing import Any

import pytest

from lightstage.dag.stage import Grid, StageError
from lightstage.stages.calibration.lights import STAGE, geodesic
from tests.stages.calibration.grids import BALL, CAMERA, FACTS, context, outline, raw

ANYTHING = Grid({}, {})


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
    assert geodesic(count, layout) == sphere


def test_a_layout_of_another_number_of_lights_is_refused() -> None:
    with pytest.raises(StageError, match="layout: 3 has 91 or 92 lights, the capture names 41"):
        geodesic(41, "3")


def arranged(names: list[str], part: list[int] | None = None, **params: Any) -> Any:
    part = part or [0] * len(names)
    grids = [raw(names), ANYTHING, outline(*sorted(set(part)))]
    return STAGE.arrange(grids, {**BALL, "part": part}, STAGE.params(**params))


def test_pictures_are_called_by_place_and_light() -> None:
    arrangement = arranged(["C", "L00", "L01", "C", "L01", "L00"], [0, 0, 0, 3, 3, 3])
    (group,) = arrangement.groups
    frames = {(0, 0): 1, (0, 1): 2, (3, 1): 4, (3, 0): 5}
    assert group.reads["raw"] == {name: {"frame": i, "band": 0, "polarisation": 1} for name, i in frames.items()}
    for array in ("at_px", "flux", "peak", "width_px", "saturated_px", "noise"):
        assert group.reads[array] == {name: {"frame": i} for name, i in frames.items()}
    assert group.reads["ring"] == {0: {"part": 0}, 3: {"part": 1}}
    assert group.labels == {"count": 2}
    assert arrangement.grid.along("light") == ["L00", "L01"]
    assert (arrangement.grid.sizes["light"], arrangement.grid.sizes["part"]) == (2, 2)


@pytest.mark.parametrize(
    ("names", "part", "sentence"),
    [
        (["C", "O"], None, "needs pictures under one light each"),
        (["L00", "L00"], None, r"L00 has two pictures \(frames 0 and 1\); keep one"),
        (["L00", "L02"], None, "the picture of L01 is missing .*or its direction stays unknown"),
        (["L00", "L04", "L05", "L08"], None, r"the picture of L01 is missing and 4 more .*its position stays"),
        (["L00", "L01", "C"], [0, 0, 1], "place 1 of the ball has no picture under one light"),
        ([f"L{i:02d}" for i in range(40)], None, r"40 lights are named; a geodesic stage has 41 \(or 42\)"),
    ],
)
def test_what_is_missing_is_named(names: list[str], part: list[int] | None, sentence: str) -> None:
    with pytest.raises(StageError, match=sentence):
        arranged(names, part)


def test_forty_lights_are_taken_by_whoever_wants_directions_alone() -> None:
    assert arranged([f"L{i:02d}" for i in range(40)], layout="none").groups[0].labels == {"count": 40}


def test_of_the_camera_it_gets_the_lens_and_needs_the_balls_size() -> None:
    part = context(STAGE, {"count": 41}, BALL, {"camera": CAMERA})
    assert set(part["camera"]) == {"size_px", "K", "distortion", "world_to_camera"}
    assert (part["ball_radius_mm"], part["geodesic"]) == (38.1, {"frequency": 2, "whole": False})
    unsized = {**FACTS, "target": {"kind": "mirror_ball"}}
    assert context(STAGE, {"count": 41}, unsized, {})["ball_radius_mm"] is None
    with pytest.raises(StageError, match="the ball's size is not known; write target"):
        context(STAGE, {"count": 41}, unsized, {"camera": CAMERA})

"""What calibration stages ask of a session."""

from typing import Any

import pytest

from lightstage.dag.stage import StageError
from lightstage.stages.calibration import session
from tests.stages.calibration.grids import BALL, CAMERA, FACTS, raw, stored


@pytest.mark.parametrize(
    ("cameras", "index", "name"),
    [
        ({"parallel": "A", "cross": "B"}, 1, "B"),
        ({"parallel": "A"}, 0, "A"),
        ({"unpolarised": "U"}, 0, "U"),
    ],
)
def test_the_reference_camera_is_cross_or_the_only_one(cameras: dict[str, str], index: int, name: str) -> None:
    assert session.reference(raw(["C"], cameras=list(cameras))) == index
    assert session.reference_camera({"cameras": cameras}) == name


def test_a_mount_turns_the_shape_by_quarters() -> None:
    assert session.mount_of(FACTS, "CAM0") == {"rotate": 90, "mirror": True}
    assert session.mount_of(FACTS, "CAM1") == {"rotate": 0, "mirror": False}
    assert session.upright_shape(FACTS, "CAM0") == (12, 8)
    assert session.upright_shape(FACTS, "CAM1") == (8, 12)
    upside_down = {**FACTS, "mount": {"CAM0": {"rotate": 180, "mirror": False}}}
    assert session.upright_shape(upside_down, "CAM0") == (8, 12)


def test_places_and_exposures_are_those_of_the_frames_or_unknown() -> None:
    assert session.parts({}, 3) == [0, 0, 0]
    assert session.parts({"part": [0, 2, 2]}, 3) == [0, 2, 2]
    assert session.exposures_s({}, 2) == [None, None]
    assert session.exposures_s({"exposure_s": [0.1, None]}, 2) == [0.1, None]


def test_frames_by_illumination() -> None:
    grid = raw(["C", "L03", "O", "L00", "C", "L03", "X"])
    assert session.frames_of(grid, "C") == [0, 4]
    assert session.frames_of(grid, "Y") == []
    assert session.single_lights(grid) == [1, 3, 5]
    assert session.light_numbers(list(grid.along("illumination"))) == [0, 3]


def test_another_target_is_refused_by_what_it_shows() -> None:
    assert session.need_target(BALL, "mirror_ball", "measuring lights")["radius_mm"] == 38.1
    with pytest.raises(StageError, match=r"measuring the camera needs a capture with target: \{kind: checkerboard"):
        session.need_target(BALL, "checkerboard", "measuring the camera")
    with pytest.raises(StageError, match="this one names no target"):
        session.need_target(FACTS, "mirror_ball", "measuring lights")


def test_of_the_camera_item_geometry_gets_what_it_reads() -> None:
    assert session.intrinsics({}, (8, 12)) is None
    lens = session.intrinsics({"camera": CAMERA}, (8, 12))
    assert lens is not None
    assert set(lens) == {"size_px", "K", "distortion", "world_to_camera"}  # residuals enter no key
    with pytest.raises(StageError, match="the camera item is for 12 x 8; the pictures are 8 x 12"):
        session.intrinsics({"camera": CAMERA}, (12, 8))


def test_a_stored_picture_comes_with_its_steps() -> None:
    items: Any = stored("dark", "CAM1")
    picture = session.stored_picture(items, "dark", "CAM1")
    assert picture is not None
    assert (picture["picture"].digest, picture["scale"]) == ("dark-CAM1", 16)
    assert session.stored_picture(items, "dark", "CAM0") is None
    assert session.stored_picture(items, "flat", "CAM1") is None

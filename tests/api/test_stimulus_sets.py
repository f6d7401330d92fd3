"""Sets of faces: their points, what is refused, what matching could not keep."""

from pathlib import Path

import numpy as np
import pytest
import xarray

import lightstage
from lightstage.api.stimulus_sets import captures, shortfalls
from tests.scenes import sphere_normals

POINTS = "a: {left_eye: [10, 12], right_eye: [30, 12]}\n"
DIFFERENCE = {"mean_linear": 0.1, "contrast_linear": 0.2, "mean_code": 0.3, "contrast_code": 0.4, "spectrum": 0.002}


def relief() -> xarray.Dataset:
    return xarray.Dataset(
        {"normal": (("tracking", "band", "xyz", "y", "x"), sphere_normals(48)[0].astype(np.float32)[None, None])}
    )


def test_points_that_are_given_are_used_as_they_are(tmp_path: Path) -> None:
    file = tmp_path / "points.yaml"
    file.write_text(POINTS)
    sentences: list[str] = []
    (capture,) = captures({"a": ("pictures", relief(), "folder")}, file, sentences.append).values()
    assert (capture.found_by, capture.pictures, capture.result, sentences) == ("given", "pictures", "folder", [])
    np.testing.assert_array_equal(capture.points["right_eye"], [30, 12])


@pytest.mark.parametrize("place", ["[47.5, 12]", "[30, 48]", "[30, -1]"])
def test_a_point_outside_its_picture_is_named(tmp_path: Path, place: str) -> None:
    file = tmp_path / "points.yaml"
    file.write_text(POINTS.replace("[30, 12]", place))
    with pytest.raises(
        lightstage.RequestError, match=r"'a', right_eye: .* is outside the picture of 48 x 48 pixels"
    ):
        captures({"a": (None, relief(), "")}, file, print)


def test_where_there_is_no_face_the_points_are_asked_for() -> None:
    flat = relief()
    flat.normal.values[:] = np.array([0, 0, 1])[None, None, :, None, None]
    with pytest.raises(
        lightstage.RequestError, match=r"^session 'a': .*; give the eyes by hand with --points FILE"
    ):
        captures({"a": (None, flat, "")}, None, print)


def test_what_matching_kept_is_not_spoken_of() -> None:
    assert shortfalls("the set", DIFFERENCE, "mean-contrast") == []
    unequal = {**DIFFERENCE, "mean_code": 3.25, "spectrum": 0.031}
    assert shortfalls("the set", unequal, "none") == []
    (levels,) = shortfalls("the set", unequal, "mean-contrast")
    assert levels.startswith("the set is matched to 3.25 grey levels only, not to ")
    assert shortfalls("the set", unequal, "histogram,spectrum") == [
        levels,
        "spectra of the set are matched to 3.1 % only, not to 1 %",
    ]

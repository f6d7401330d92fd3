"""Points in a file."""

from pathlib import Path

import numpy as np
import pytest

from lightstage.api.face_points import read_points
from lightstage.products.face_points import as_yaml
from lightstage.store.errors import RequestError


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    """Also names that YAML would take for numbers or truth values."""
    points = {
        name: {"left_eye": np.array([10.25, 20]), "right_eye": np.array([30.5, 21]), "mole": np.array([3.0, 4])}
        for name in ("007", "no", "anna")
    }
    path = tmp_path / "points.yaml"
    path.write_text(as_yaml(points))
    again = read_points(path, list(points))
    assert list(again) == list(points)
    for name, named in points.items():
        assert list(again[name]) == list(named)
        for key, at in named.items():
            np.testing.assert_array_equal(again[name][key], at)


def test_a_point_that_is_no_number_is_named(tmp_path: Path) -> None:
    path = tmp_path / "points.yaml"
    path.write_text("a: {left_eye: [.nan, 2], right_eye: [10, 2]}\n")
    with pytest.raises(RequestError, match="'a', left_eye: expected"):
        read_points(path, ["a"])

"""Films of a result: what series there are, how fast they run, what they say, and what is no film."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import xarray

from lightstage.products.errors import ProductError
from lightstage.products.film import (
    Subject,
    check,
    file_names,
    frames_per_second,
    open_series,
    pace,
    scale_top_deg,
    write_series,
)

SUBJECT = Subject("head", ("X", "C", "Y", "C"), 60.0)


def turning(frames: int = 3, bands: tuple[float, ...] = (0.0,), **more: Any) -> Any:
    """Normals at tracking frames, each 8 degrees further up than the last."""
    angle = np.radians(8.0 * np.arange(frames))
    normal = np.zeros((frames, len(bands), 3, 6, 8), np.float32)
    normal[:, :, 1] = np.sin(angle)[:, None, None, None]
    normal[:, :, 2] = np.cos(angle)[:, None, None, None]
    dims = ("tracking", "band", "xyz", "y", "x")
    return xarray.Dataset({"normal": (dims, normal), **more}, {"tracking": np.arange(frames), "band": list(bands)})


def test_a_series_a_band_with_what_each_frame_is() -> None:
    (one,) = open_series(turning(), "normals", SUBJECT)
    assert (one.name, one.frames, one.illumination) == ("head_normals", (0, 1, 2), ("X", "C", "Y"))
    assert one.caption(1) == "head    normals    frame 1    light C"
    two = open_series(turning(bands=(434.0, 576.0)), "normals", SUBJECT)
    assert [series.name for series in two] == ["head_normals_434nm", "head_normals_576nm"]
    assert "576 nm" in two[1].caption(0)


def test_the_background_has_no_normals() -> None:
    albedo = np.full((3, 1, 6, 8), 1.0, np.float32)
    albedo[:, :, :2] = 0.01
    (series,) = open_series(turning(albedo=(("tracking", "band", "y", "x"), albedo)), "normals", SUBJECT)
    normal = series.normal(0)
    assert np.isnan(normal[:2]).all()
    assert np.isfinite(normal[2:]).all()


def test_the_scale_is_the_next_round_angle() -> None:
    (series,) = open_series(turning(), "normals", SUBJECT)
    assert scale_top_deg(series) == 10
    (still,) = open_series(turning(frames=1), "normals", SUBJECT)
    assert scale_top_deg(still) == 1


def test_rates() -> None:
    (series,) = open_series(turning(), "normals", SUBJECT)
    assert frames_per_second(series, None) == 10  # 60 / 6
    assert frames_per_second(series, 24) == 24
    (slow,) = open_series(turning(), "normals", Subject("head", ("C",), None))
    assert frames_per_second(slow, None) == 5
    for wrong in (0.0, 121.0, float("nan")):
        with pytest.raises(ProductError, match=r"between 0.1 and 120"):
            frames_per_second(series, wrong)
    timed = turning().rename(tracking="frame").assign_coords(time_s=("frame", np.arange(3) / 60))
    (series,) = open_series(timed, "upsample", SUBJECT)
    assert pace(series, 10) == "10 frames a second, 6 times slower than captured"
    assert pace(series, 60) == "60 frames a second, as fast as captured"


@pytest.mark.parametrize("form", ["mp4", "png"])
def test_what_is_written_and_said(tmp_path: Path, form: str) -> None:
    every = open_series(turning(), "normals", SUBJECT)
    (film,) = write_series(tmp_path, every, form=form)
    assert list(film.files) == file_names(every, form) == sorted(path.name for path in tmp_path.iterdir())
    assert (film.frames, film.top_deg) == (3, 10)
    assert film.fps == (10 if form == "mp4" else None)
    video = cv2.VideoCapture(str(tmp_path / film.files[0]))
    there, first = video.read()
    assert there
    assert first.shape[1] == 3 * 360 + 4 * 12


def test_what_is_no_film() -> None:
    with pytest.raises(ProductError, match="'stack' of session 'head' has no normals in time"):
        open_series(xarray.Dataset({"radiance": (("y", "x"), np.zeros((2, 2)))}), "stack", SUBJECT)
    with pytest.raises(ProductError, match="has no frame; there is nothing to show"):
        open_series(turning(frames=0), "normals", SUBJECT)
    one = open_series(turning(frames=1), "normals", SUBJECT)
    with pytest.raises(ProductError, match="has one frame, and a film needs two"):
        check(one, "mp4", None)
    check(one, "png", None)

"""Films of normals: what is in the file, read back by another program, and what is refused."""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import imageio.v3 as imageio
import numpy as np
import pytest
import xarray

from tests.conftest import Answer, put_result
from tests.scenes import one_camera_capture

Lightstage = Callable[..., Answer]
LIGHTS = ("X", "C", "Y")
TURNED = np.array([0.0, 0.5, np.sqrt(0.75)])
"""30 degrees up from the camera's direction."""


@pytest.fixture
def moving(lightstage: Lightstage, tmp_path: Path) -> str:
    """A session with a result of three frames: twice the same normals, then turned by 30 degrees."""
    folder = one_camera_capture(tmp_path / "head", LIGHTS, frame_rate_hz=60)
    assert lightstage("import", folder).code == 0
    normal = np.zeros((3, 3, 12, 16), np.float32)
    normal[:2, 2] = 1
    normal[2] = TURNED[:, None, None]
    normal[:, :, :4, :4] = np.nan
    dataset = xarray.Dataset(
        {"normal": (("frame", "xyz", "y", "x"), normal)},
        {
            "frame": [0, 1, 2],
            "illumination": ("frame", np.array(LIGHTS, object)),
            "time_s": ("frame", np.arange(3) / 60),
        },
    )
    put_result(dataset, tmp_path / "store", "head", "upsample")
    return "head"


def read_mp4(path: str) -> Any:
    """(frame, y, x, rgb), decoded by OpenCV."""
    video = cv2.VideoCapture(path)
    frames = []
    while True:
        there, frame = video.read()
        if not there:
            break
        frames.append(frame[..., ::-1])
    video.release()
    return np.stack(frames)


def panels(picture: Any) -> list[Any]:
    """The middle of each panel, and its corner without normals."""
    width, height = 368, 276  # 16 x 12, times 23
    return [
        (picture[60 + height // 2, left + width // 2].astype(int), picture[60 + 40, left + 40].astype(int))
        for left in (12 + i * (width + 12) for i in range(3))
    ]


@pytest.mark.parametrize("form", ["mp4", "gif", "png"])
def test_the_film_shows_the_normals(lightstage: Lightstage, moving: str, tmp_path: Path, form: str) -> None:
    done = lightstage(
        "export", "upsample", "--session", moving, "--to", tmp_path / "out", "--format", form, "--json"
    )
    assert done.code == 0, done.err
    files = done.json["files"]
    if form == "png":
        film = np.stack([imageio.imread(file) for file in files])
        assert [Path(file).name for file in files] == [f"head_upsample_{i:04d}.png" for i in range(3)]
    else:
        film = read_mp4(files[0]) if form == "mp4" else imageio.imread(files[0], mode="RGB")
        assert done.json["fps"] == 10  # 60 / 6
    assert film.shape == (3, 60 + 276 + 48, 3 * 368 + 4 * 12, 3)
    near = {"mp4": 4, "gif": 12, "png": 1}[form]
    purple, yellow = (68, 1, 84), (253, 231, 37)  # the ends of viridis
    for frame, colour, grey, change in (
        (0, (128, 128, 255), 208, (56, 56, 56)),
        (1, (128, 128, 255), 208, purple),
        (2, (128, 191, 238), 218, None),
    ):
        (seen, none), (shade, dark), (scale, _) = panels(film[frame])
        assert np.abs(seen - colour).max() <= near
        assert np.abs(shade - grey).max() <= near
        assert max(none.max(), dark.max()) <= near
        if change is not None:
            assert np.abs(scale - change).max() <= near
        else:
            assert np.abs(scale - purple).sum() > 100 < np.abs(scale - yellow).sum()
    assert done.json["change_top_deg"] == [45]  # the next above 30
    assert not [name for name in os.listdir(tmp_path / "out") if ".part" in name]


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("upsampel", "--format", "mp4"), "no result of a node 'upsampel'"),
        (("capture", "--format", "mp4"), "has no normals in time"),
        (("upsample", "--format", "mp4", "--fps", "0"), "between 0.1 and 120"),
        (("upsample", "--format", "mp4", "--fps", "nan"), "a finite number"),
        (("upsample", "--format", "png", "--fps", "5"), "only a film has it"),
    ],
)
def test_a_wrong_request_is_one_sentence(
    lightstage: Lightstage, moving: str, tmp_path: Path, words: tuple[str, ...], part: str
) -> None:
    done = lightstage("export", *words, "--session", moving, "--to", tmp_path / "out")
    assert done.code == 2
    assert part in done.err
    assert len(done.err.strip().splitlines()) == 1


def test_a_film_of_somebody_else_stays(lightstage: Lightstage, moving: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "head_upsample.mp4").write_bytes(b"old")
    words = ("export", "upsample", "--session", moving, "--to", out, "--format", "mp4")
    refused = lightstage(*words)
    assert refused.code == 2
    assert (
        "head_upsample.mp4 is there already, and no export.json beside it says that it was delivered" in refused.err
    )
    assert {path.name: path.read_bytes() for path in out.iterdir()} == {"head_upsample.mp4": b"old"}
    (out / "head_upsample.mp4").unlink()
    assert lightstage(*words).code == 0
    first = (out / "head_upsample.mp4").read_bytes()
    assert lightstage(*words, "--fps", "7").code == 0  # its own film is made anew
    assert (out / "head_upsample.mp4").read_bytes() != first


def test_a_full_disk_is_named_and_leaves_the_old_film(
    lightstage: Lightstage, moving: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    words = ("export", "upsample", "--session", moving, "--to", out, "--format", "mp4")
    assert lightstage(*words).code == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    make = tempfile.mkdtemp

    def full(**where: Any) -> str:
        folder = make(**where)
        os.symlink("/dev/full", os.path.join(folder, "head_upsample.mp4"))
        return folder

    monkeypatch.setattr("tempfile.mkdtemp", full)
    done = lightstage(*words, "--fps", "7")
    assert done.code == 1
    assert "is full" in done.err
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_a_still_subject_has_no_film(lightstage: Lightstage, sphere: Path) -> None:
    done = lightstage("performance", sphere)
    assert done.code == 2
    assert "is static" in done.err

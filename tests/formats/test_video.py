"""Films read back by OpenCV, and encoders that give up."""

import errno
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import imageio.v3 as imageio
import numpy as np
import pytest
from numpy.typing import NDArray

from lightstage.formats.video import even, write_film


def greys(levels: tuple[int, ...] = (40, 200)) -> Iterator[NDArray[np.uint8]]:
    for level in levels:
        yield np.full((16, 24, 3), level, np.uint8)


def test_pictures_come_back(tmp_path: Path) -> None:
    write_film(tmp_path / "a.mp4", greys(), (24, 16), 7.5)
    video = cv2.VideoCapture(str(tmp_path / "a.mp4"))
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(7.5)
    for level in (40, 200):
        there, frame = video.read()
        assert there
        assert frame.shape == (16, 24, 3)
        assert np.abs(frame.astype(int) - level).max() <= 3
    write_film(tmp_path / "a.gif", greys(), (24, 16), 10)
    film = imageio.imread(tmp_path / "a.gif", mode="RGB")
    assert film.shape == (2, 16, 24, 3)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.gif", "a.mp4"]


def test_even() -> None:
    assert [even(size) for size in (3, 4)] == [4, 4]


def encoder(folder: Path, words: str, code: int) -> Path:
    """A program in the encoder's place that says something and ends."""
    script = folder / "encoder"
    script.write_text(f"#!{sys.executable}\nimport sys\nprint({words!r}, file=sys.stderr)\nsys.exit({code})\n")
    script.chmod(0o755)
    return script


@pytest.mark.parametrize(
    ("words", "number", "sentence"),
    [
        ("av_write: No space left on device", errno.ENOSPC, "the disk is full"),
        ("first\nsomething odd", errno.EIO, r"cannot be encoded \(ffmpeg: something odd\)"),
    ],
)
def test_what_the_encoder_says_is_told_and_the_old_film_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str, number: int, sentence: str
) -> None:
    (tmp_path / "a.mp4").write_bytes(b"old")
    program = encoder(tmp_path, words, 1)
    monkeypatch.setattr("imageio_ffmpeg.get_ffmpeg_exe", lambda: str(program))
    with pytest.raises(OSError, match=sentence) as failed:
        write_film(tmp_path / "a.mp4", greys(tuple([9] * 300)), (24, 16), 10)
    assert (failed.value.errno, failed.value.filename) == (number, str(tmp_path / "a.mp4"))
    assert {path.name for path in tmp_path.iterdir()} == {"a.mp4", "encoder"}
    assert (tmp_path / "a.mp4").read_bytes() == b"old"


def test_no_encoder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none() -> str:
        raise RuntimeError("no ffmpeg")

    monkeypatch.setattr("imageio_ffmpeg.get_ffmpeg_exe", none)
    with pytest.raises(OSError, match="there is no ffmpeg to write films with; install imageio-ffmpeg"):
        write_film(tmp_path / "a.mp4", greys(), (24, 16), 10)
    monkeypatch.setattr("imageio_ffmpeg.get_ffmpeg_exe", lambda: str(tmp_path / "gone"))
    with pytest.raises(OSError, match="the encoder does not start") as failed:
        write_film(tmp_path / "a.mp4", greys(), (24, 16), 10)
    assert failed.value.filename == str(tmp_path / "gone")


def test_pictures_that_fail_end_the_encoder(tmp_path: Path) -> None:
    def broken() -> Iterator[NDArray[np.uint8]]:
        yield from greys()
        raise KeyError("third")

    with pytest.raises(KeyError, match="third"):
        write_film(tmp_path / "a.mp4", broken(), (24, 16), 10)
    assert not list(tmp_path.iterdir())

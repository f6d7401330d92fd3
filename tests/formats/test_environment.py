"""Environment maps, written by hand and by OpenEXR: what is in them, and what is no environment."""

import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from lightstage.formats.environment import read_environment
from lightstage.formats.errors import FormatError
from tests.environments import noise, white, write_hdr, write_map

AP1 = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)


@pytest.mark.parametrize("form", ["hdr", "exr"])
def test_environments_are_read(tmp_path: Path, form: str) -> None:
    values = noise()
    file = (write_hdr if form == "hdr" else write_map)(tmp_path / f"sky.{form}", values)
    # RGBE has 8 bits for the largest channel, rounded down
    tolerance = values.max(axis=2, keepdims=True) / 128 if form == "hdr" else 1e-5 * np.ones((1, 1, 1))
    assert (np.abs(read_environment(file) - values) <= tolerance).all()


def test_a_wide_map_keeps_its_light(tmp_path: Path) -> None:
    values = np.zeros((1024, 2048, 3))
    values[300, 700] = 4000.0
    made = read_environment(write_map(tmp_path / "sun.exr", values))
    assert made.shape == (512, 1024, 3)
    assert made.sum() == pytest.approx(3 * 4000 / 4)
    assert made[150, 350, 0] > 0


def declaring(file: Path, width: int, height: int) -> Path:
    file.write_bytes(re.sub(rb"-Y \d+ \+X \d+", b"-Y %d +X %d" % (height, width), file.read_bytes()))
    return file


def damaged(file: Path, *, keep: float) -> Path:
    data = file.read_bytes()
    file.write_bytes(data[: int(keep * len(data))])
    return file


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda p: declaring(write_hdr(p / "a.hdr", white()), 60000, 30000), "is no picture that can be read"),
        (lambda p: write_hdr(p / "a.hdr", np.ones((16, 30, 3))), "is 30 x 16; a map in latitude and"),
        (lambda p: damaged(write_hdr(p / "a.hdr", white()), keep=0.5), "is damaged or cut short"),
        (lambda p: damaged(write_map(p / "a.exr", noise()), keep=0.7), "is damaged or cut short"),
        (lambda p: damaged(write_hdr(p / "a.hdr", white()), keep=0.01), "is no picture that can be read"),
        (lambda p: write_map(p / "a.exr", white() * np.nan), "1536 values are NaN or infinite"),
        (lambda p: write_map(p / "a.exr", -white()), "1536 values are negative, down to -1"),
        (lambda p: write_map(p / "a.exr", 0 * white()), "is black; there is no light in it"),
        (lambda p: write_map(p / "a.exr", white(), chromaticities=AP1), "its chromaticities are other primaries"),
        (lambda p: write_map(p / "a.exr", white(), colorInteropID="lin_ap1_scene"), "colour space lin_ap1_scene"),
    ],
)  # fmt: skip
def test_wrong_environments(tmp_path: Path, make: Callable[[Path], Path], said: str) -> None:
    file = make(tmp_path)
    with pytest.raises(FormatError) as refused:
        read_environment(file)
    assert str(refused.value).startswith(str(file))
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("limit", "said"), [("WIDEST_READ", "a side has at most 8"), ("LARGEST_READ", "MiB are")])
def test_an_environment_out_of_all_measure_is_not_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str, said: str
) -> None:
    monkeypatch.setattr(f"lightstage.formats.environment.{limit}", 8)
    with pytest.raises(FormatError, match=said):
        read_environment(write_map(tmp_path / "a.exr", white()))


def test_eight_bits_are_no_radiance(tmp_path: Path) -> None:
    assert cv2.imwrite(str(tmp_path / "a.png"), np.zeros((16, 32, 3), np.uint8))
    with pytest.raises(FormatError, match="holds uint8, which ends at white"):
        read_environment(tmp_path / "a.png")

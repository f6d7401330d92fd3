"""lightstage sequence: what it prints, writes and refuses."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import pytest
import yaml

from lightstage.store.capture import CaptureFile
from lightstage.store.document import check, load, parse
from tests.conftest import Answer

Lightstage = Callable[..., Answer]
TWENTY = ("--exposure-ms", "20", "--setup-ms", "23", "--readout-ms", "7")
REST = {
    "format": "lightstage-capture/1",
    "session": "s",
    "bits": 10,
    "cameras": {"cross": "CAM1"},
    "bands_nm": [576],
    "files": "{frame:04d}_{illumination}_{band}nm_{camera}.png",
}


def as_capture(plan: Path) -> CaptureFile:
    """The written part with the rest of a capture.yaml, through the reader of captures."""
    part: dict[str, Any] = yaml.safe_load(plan.read_text())
    return check(parse(yaml.safe_dump({**REST, **part}), name="capture.yaml"), CaptureFile)


def test_a_sequence_without_times(lightstage: Lightstage) -> None:
    done = lightstage("sequence", "minimal", "--tracking", "4")
    assert done.code == 0
    assert done.out.splitlines()[0] == "X Z C Y Xc C Zc Yc C Xc Z C Y X"
    assert "14 images, 4 tracking frame(s)" in done.out
    assert "was not judged" in done.err
    mixed = lightstage("sequence", "minimal", "--tracking", "4", "--sets", "mixed", "--json").json
    assert " ".join(mixed["sequence"]) == "X Z C Y Xc C Zc Yc C X Z C Y Xc"
    assert (mixed["flashes"], mixed["frame_rate_hz"], mixed["accepted"]) == (None, None, None)
    assert len(lightstage("sequence", "wilson", "--tracking", "5", "--json").json["sequence"]) == 23


def test_flashing_is_refused_until_somebody_answers_for_it(lightstage: Lightstage, tmp_path: Path) -> None:
    plan = tmp_path / "plan.yaml"
    refused = lightstage("sequence", "wilson", *TWENTY, "--to", plan)
    assert refused.code == 2
    assert "flashes within 3 to 30 Hz" in refused.err
    assert "photosensitive epilepsy" in refused.err
    assert "--accept-flashing" in refused.err
    assert len(refused.err.strip().splitlines()) == 1
    assert refused.out == ""
    assert not plan.exists()
    for empty in ("", " \n "):
        said = lightstage("sequence", "wilson", *TWENTY, "--accept-flashing", empty)
        assert (said.code, "who decided" in said.err) == (2, True)
    reason = 'the PI; subject screened "twice"\nframes: []'
    done = lightstage("sequence", "wilson", *TWENTY, "--accept-flashing", reason, "--to", plan, "--json")
    assert done.code == 0
    assert done.json["flashes"] is True
    assert done.json["accepted"] == 'the PI; subject screened "twice" frames: []'
    assert done.json["frame_rate_hz"] == pytest.approx(20)
    assert done.json["tracking_rate_hz"] == pytest.approx(5)
    (line,) = (line for line in plan.read_text().splitlines() if "accepted" in line)
    assert json.loads(line.removeprefix("# flashing accepted: ")) == done.json["accepted"]


def test_what_is_written_is_a_part_of_a_capture(lightstage: Lightstage, tmp_path: Path) -> None:
    plan = tmp_path / "new" / "plan.yaml"
    words = ("sequence", "minimal", "--tracking", "3", *TWENTY, "--accept-flashing", "the lab; nobody is in it")
    assert lightstage(*words, "--to", plan).code == 0
    capture = as_capture(plan)
    assert " ".join(frame.illumination for frame in capture.frames) == "X Z C Y Xc C Zc Yc C Xc Z"
    assert [frame.time_s for frame in capture.frames] == pytest.approx([0.05 * i for i in range(11)])
    assert capture.frame_rate_hz == pytest.approx(20)
    before = plan.read_bytes()
    assert lightstage(*words, "--to", plan).code == 0
    plan.write_bytes(before + b"# mine\n")
    assert "there already" in lightstage(*words, "--to", plan).err
    assert plan.read_bytes() == before + b"# mine\n"
    assert not list(plan.parent.glob(".*"))


def test_a_multispectral_plan(lightstage: Lightstage, tmp_path: Path) -> None:
    plan = tmp_path / "plan.yaml"
    words = ("sequence", "multispectral", "--bands", "655,407", "--exposure-ms", "400", "--wheel-ms", "650")
    done = lightstage(*words, "--to", plan, "--json")
    assert done.code == 0, done.err
    assert done.json["flashes"] is False
    assert [one["band_nm"] for one in done.json["exposures"]] == [655] * 7 + [407] * 7
    capture = as_capture(plan)
    assert capture.bands_nm == (655, 407)
    assert len(capture.frames) == 7
    assert capture.frames[0].time_s is None
    assert "#   407 nm C at 3.450000 s" in plan.read_text().splitlines()
    assert "655 nm: C X Y Z Xc Yc Zc" in lightstage(*words).out


def test_a_static_plan_needs_no_times_and_a_performance_does(lightstage: Lightstage, tmp_path: Path) -> None:
    assert lightstage("sequence", "static", "--to", tmp_path / "a.yaml").code == 0
    assert as_capture(tmp_path / "a.yaml").frame_rate_hz is None
    assert "was not judged" in (tmp_path / "a.yaml").read_text()
    done = lightstage("sequence", "minimal", "--to", tmp_path / "b.yaml")
    assert done.code == 2
    assert "--exposure-ms" in done.err
    assert not (tmp_path / "b.yaml").exists()


def test_check_says_what_each_tracking_frame_supports(lightstage: Lightstage) -> None:
    done = lightstage("sequence", "check", "X Z C Y Xc C Zc")
    assert done.code == 1  # the second window holds no set
    head, first, second, *_ = done.out.splitlines()
    assert head.split() == ["frame", "window", "supports", "missing"]
    assert "ratio, minimal X: Y Z" in first
    assert "difference: Yc Zc" in first
    assert "nothing" in second
    assert "minimal: X or Yc or Z" in second
    records = lightstage("sequence", "check", "X", "Z", "C", "Y", "Xc", "--json").json["tracking"]
    assert records[0]["frame"] == 2
    assert records[0]["missing"]["difference"] == ["Yc", "Zc"]
    none = lightstage("sequence", "check", "X Xc")
    assert (none.code, "no tracking frame" in none.out) == (1, True)
    slow = lightstage("sequence", "check", "C X Y Z", "--exposure-ms", "1000")
    assert "no brightness changes between 3 and 30 Hz" in slow.out


def test_check_reads_plans_and_captures(lightstage: Lightstage, tmp_path: Path, sphere: Path) -> None:
    plan = tmp_path / "plan.yaml"
    lightstage("sequence", "wilson", "--tracking", "2", *TWENTY, "--accept-flashing", "a test", "--to", plan)
    done = lightstage("sequence", "check", plan, "--json")
    assert done.code == 0
    assert len(done.json["sequence"]) == 11
    assert done.json["frame_rate_hz"] == pytest.approx(20)
    assert done.json["flashes"] is True
    assert "refused without --accept-flashing" in done.err
    folder = lightstage("sequence", "check", sphere, "--json").json
    names = [frame["illumination"] for frame in load(sphere / "capture.yaml", what="it").value["frames"]]
    assert (folder["sequence"], folder["flashes"]) == (names, None)
    other = lightstage("sequence", "check", "L345 C X Y Z", "--exposure-ms", "50")
    assert (other.code, "was not judged" in other.err) == (0, True)


def test_count_prints_and_draws(lightstage: Lightstage, tmp_path: Path) -> None:
    """The thesis' table: 5, 9, 11, 15, 17, 21 against Wilson's 7, 11, 15, 19, 23, 27."""
    plot = tmp_path / "figures" / "count.png"
    done = lightstage("sequence", "count", "--upto", "6", "--plot", plot, "--json")
    assert done.code == 0
    rows = done.json["rows"]
    assert [row["wilson"] for row in rows] == [7, 11, 15, 19, 23, 27]
    assert [row["minimal"] for row in rows] == [5, 8, 11, 14, 17, 20]
    assert [row["minimal_thesis"] for row in rows] == [5, 9, 11, 15, 17, 21]
    picture = cv2.imread(str(plot))
    assert picture is not None
    assert picture.std() > 5
    assert [path.name for path in plot.parent.iterdir()] == ["count.png"]
    assert "3n + 3 for even n" in lightstage("sequence", "count").out


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("wilson", "--tracking", "0"), "a performance has 1 to 5000"),
        (("minimal", "--sets", "both"), "'both' is not known"),
        (("wilsn",), "did you mean 'wilson'"),
        (("multispectral", "--bands", "red"), "--bands red: expected wavelengths"),
        (("multispectral", "--bands", "576,576"), "576 nm stands twice"),
        (("static", "--setup-ms", "5"), "--setup-ms stands alone"),
        (("static", "--dark-pauses"), "--dark-pauses stands alone"),
        (("static", "--exposure-ms", "0"), "exposure_ms 0"),
        (("check", "X W C"), "frame 1: the illumination 'W' is not known"),
        (("check", "no/capture.yaml"), "is missing"),
        (("count", "--upto", "0"), "from 1 to 1000"),
        (("count", "--plot", "a.txt"), "ends in .png"),
    ],
)
def test_a_wrong_request_is_one_sentence(lightstage: Lightstage, words: tuple[str, ...], part: str) -> None:
    done = lightstage("sequence", *words)
    assert done.code == 2
    assert part in done.err
    assert len(done.err.strip().splitlines()) == 1


def test_a_file_without_frames_is_named(lightstage: Lightstage, tmp_path: Path) -> None:
    file = tmp_path / "c.yaml"
    for text, part in (
        ("frames: 3\n", "c.yaml:1:1: expected a list of frames"),
        ("- 1\n", "expected a list of frames"),
        ("frames: [{illumination: Q}]\n", "'Q' is not known"),
        ("frame_rate_hz: fast\nframes: [{illumination: C}]\n", "c.yaml:1:1: frame_rate_hz: expected a number"),
    ):
        file.write_text(text)
        done = lightstage("sequence", "check", file)
        assert (done.code, part in done.err) == (2, True), done.err


def test_the_bands_are_the_thesis_wheel_unless_named(lightstage: Lightstage) -> None:
    done = lightstage("sequence", "multispectral", "--json").json
    from lightstage.hw.virtual_rig import THESIS_BANDS

    assert list(dict.fromkeys(one["band_nm"] for one in done["exposures"])) == list(THESIS_BANDS)

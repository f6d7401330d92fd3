"""Sequences: read, planned, judged and written."""

from pathlib import Path

import pytest
import yaml

from lightstage.api import sequences
from lightstage.store.errors import RequestError
from tests.scenes import one_camera_capture


def test_words_and_files_say_the_same_sequence(tmp_path: Path) -> None:
    names = ("C", "X", "L07", "T0", "O")
    folder = one_camera_capture(tmp_path / "c", names, frame_rate_hz=60.0)
    assert sequences.read_sequence(["C X L07", "T0", "O"]) == (names, None)
    assert sequences.read_sequence([str(folder)]) == (names, 60.0)
    assert sequences.read_sequence([str(folder / "capture.yaml")]) == (names, 60.0)


def test_an_illumination_is_meant_even_where_a_file_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("C", "Xc", "L07"):
        Path(name).touch()
        assert sequences.read_sequence([name]) == ((name,), None)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("frames: []\n", "expected a list of frames"),
        ("frames: [{illumination: Q}]\n", "illumination"),
        ("frames: [{illumination: C}]\nframe_rate_hz: yes\n", "frame_rate_hz: expected a number above 0"),
        ("frames: [{illumination: C}]\nframe_rate_hz: -1\n", "frame_rate_hz: expected a number above 0"),
        ("[]\n", "expected a list of frames"),
    ],
)
def test_a_file_that_is_no_sequence_is_named(tmp_path: Path, text: str, part: str) -> None:
    file = tmp_path / "capture.yaml"
    file.write_text(text)
    with pytest.raises(RequestError, match=part) as refused:
        sequences.read_sequence([str(file)])
    assert "capture.yaml" in str(refused.value)
    with pytest.raises(RequestError, match=r"no\.yaml is missing"):
        sequences.read_sequence(["no.yaml"])


def test_images_against_tracking_frames_are_those_of_the_formulas() -> None:
    """Wilson 4n + 3; minimal 3n + 2; the thesis' table has 3n + 3 for even n."""
    rows = sequences.counts(6)
    assert rows == [(n, 4 * n + 3, 3 * n + 2, 3 * n + 2 + (n % 2 == 0)) for n in range(1, 7)]
    for upto in (0, -1, sequences.MOST_TRACKING + 1):
        with pytest.raises(RequestError, match=f"--upto {upto}: a number of tracking frames from 1 to 1000"):
            sequences.counts(upto)


def test_counts_are_drawn_where_the_file_is_a_picture(tmp_path: Path) -> None:
    sequences.draw_counts(sequences.counts(3), tmp_path / "c.svg")
    assert (tmp_path / "c.svg").read_text().startswith("<?xml")
    with pytest.raises(RequestError, match=r"c.txt: expected a file that ends in .png, .svg, .pdf"):
        sequences.draw_counts(sequences.counts(3), tmp_path / "c.txt")


def test_a_slow_sequence_is_judged_and_one_without_times_is_not() -> None:
    names = ("C", "X", "Y", "Z")
    judged, why = sequences.judge(names, sequences.timing(exposure_ms=1000))
    assert (judged.flashes, why) == (False, None)
    unknown, why = sequences.judge(names, None)
    assert (unknown.flashes, unknown.flicker, why) == (None, (), None)
    # two pictures at 20 a second: constant light and half of it, ten times a second
    flashing, _ = sequences.judge(("C", "X"), sequences.timing(exposure_ms=50))
    assert flashing.flashes
    worst = flashing.flicker[0]
    assert worst.strongest_hz == pytest.approx(10)
    sentence = sequences.flash_sentence(flashing.flicker)
    assert "most at 10.00 Hz" in sentence
    assert f"{100 * worst.swing:.0f} % of the brightest picture seen {sequences.seen(worst.view)}" in sentence


def test_lights_that_this_rig_has_not_are_not_judged() -> None:
    judged, why = sequences.judge(("C", "L9999"), sequences.timing(exposure_ms=20))
    assert judged.flashes is None
    assert why is not None
    assert "L9999" in why


def test_what_the_rig_refuses_is_a_wrong_request() -> None:
    for call in (
        lambda: sequences.plan("wilson", tracking=0),
        lambda: sequences.judge(("Q",), None),
        lambda: sequences.timing(exposure_ms=0),
        lambda: sequences.read_sequence(["C", "Q"]),
    ):
        with pytest.raises(RequestError):
            call()


def test_a_plan_is_written_once_and_nothing_is_overwritten(tmp_path: Path) -> None:
    plan = sequences.plan("wilson", tracking=2, timing=sequences.timing(exposure_ms=500))
    path = tmp_path / "new" / "plan.yaml"
    sequences.write_plan(path, plan, 'somebody "answers"\nframes: []')
    part = yaml.safe_load(path.read_text())
    assert [frame["illumination"] for frame in part["frames"]] == list(plan.names)
    assert [frame["time_s"] for frame in part["frames"]] == [0.5 * k for k in range(11)]
    assert part["frame_rate_hz"] == 2
    assert path.read_text().startswith("# planned by `lightstage sequence wilson`: a part of capture.yaml\n")
    sequences.write_plan(path, plan, 'somebody "answers"\nframes: []')  # the same
    with pytest.raises(RequestError, match="is there already and holds something else"):
        sequences.write_plan(path, plan, None)
    assert yaml.safe_load(path.read_text()) == part


def test_a_multispectral_plan_names_its_exposures_and_has_no_rate(tmp_path: Path) -> None:
    plan = sequences.plan("multispectral", bands_nm=(434, 576))
    sequences.write_plan(tmp_path / "plan.yaml", plan, None)
    text = (tmp_path / "plan.yaml").read_text()
    part = yaml.safe_load(text)
    assert part["bands_nm"] == [434, 576]
    assert part["frame_rate_hz"] is None
    assert "times: not planned; whether it flashes was not judged" in text
    order = [line.split()[1] for line in text.splitlines() if " nm " in line]
    assert order == sorted(order)  # all of one filter before the wheel turns
    assert len(order) == 2 * len(part["frames"])


@pytest.mark.parametrize(
    ("view", "words"),
    [("total", "as total light"), ("front", "facing the camera"), ("back", "facing away"), ("left", "facing left")],
)
def test_views_have_words(view: str, words: str) -> None:
    assert sequences.seen(view).startswith(words)

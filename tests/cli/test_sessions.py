"""import, sessions, calibration: what comes into the store, and what is bound to what."""

from pathlib import Path

import numpy as np
import pytest

from tests.cli.conftest import Lightstage, check_refusal
from tests.scenes import STATIC, write_capture


def test_a_truncated_picture_is_one_clear_sentence(lightstage: Lightstage, sphere: Path) -> None:
    victim = sphere / "0003_Z_576nm_CAM1.png"
    victim.write_bytes(victim.read_bytes()[:200])
    done = lightstage("import", sphere)
    assert done.code == 2
    assert (
        done.err.strip() == f"lightstage: {victim} is truncated: the PNG ends after 200 bytes without an end mark"
    )


def test_binding_another_item_is_what_later_runs_use(lightstage: Lightstage, ball: Path, tmp_path: Path) -> None:
    item = tmp_path / "new.yaml"
    item.write_text("item: homography\nfrom: CAM0\nto: CAM1\nmatrix: [[1, 0, -1.5], [0, 1, 0], [0, 0, 1]]\n")
    assert lightstage("calibration", "use", item, "--session", "ball", "--json").json["changed"]
    assert not lightstage("calibration", "use", item, "--session", "ball", "--json").json["changed"]
    assert lightstage("run", "--session", "ball", "--json").json["nodes"]["register"]["computed"] == 7
    listed = lightstage("calibration", "list", "--session", "ball", "--json").json["items"]
    assert {entry["kind"] for entry in listed} == {"homography", "bands"}


def test_an_import_says_what_changed_and_the_second_one_nothing(lightstage: Lightstage, sphere: Path) -> None:
    done = lightstage("import", sphere, "--json").json
    assert (done["session"], done["new"], done["pictures"]) == ("ball", True, 14)
    assert set(done["items"]) == {"homography", "bands"}
    assert {(row["illumination"], row["polarisation"]) for row in done["verdict"]} == {
        (name, camera) for name in STATIC for camera in ("parallel", "cross")
    }
    again = lightstage("import", sphere, "--json").json
    assert (again["new"], again["changed"], again["changes"]) == (False, False, [])
    assert "session 'ball': nothing has changed" in lightstage("import", sphere).out


def test_pictures_that_are_no_good_are_marked(lightstage: Lightstage, tmp_path: Path) -> None:
    """Saturated, dark, and a pair that does not add up to constant light."""
    level = {"C": 400, "X": 300, "Xc": 300, "Y": 1023, "O": 0}
    pictures = {(i, 0, "cross"): np.full((8, 8), value, np.uint16) for i, value in enumerate(level.values())}
    out = lightstage("import", write_capture(tmp_path / "bad", pictures, illumination=list(level))).out
    marks = {line.split()[0]: line for line in out.splitlines() if line.split()[0] in level}
    assert marks["C"].endswith("good")
    assert marks["Y"].endswith("saturated")
    assert marks["X"].endswith("moved, or the lights disagree")
    assert "dark" not in marks["O"]


def test_sessions_are_listed_shown_and_removed(lightstage: Lightstage, sphere: Path) -> None:
    lightstage("import", sphere)
    (row,) = lightstage("sessions", "list", "--json").json["sessions"]
    assert (row["session"], row["sizes"]["frame"], row["sizes"]["band"]) == ("ball", 7, 1)
    assert "48 x 48" in lightstage("sessions", "list").out
    plain = lightstage("sessions", "show", "ball").out
    assert "7 frames: C X Y Z Xc Yc Zc" in plain
    assert "parallel: CAM0, cross: CAM1" in plain
    assert Path(lightstage("sessions", "show", "ball", "--json").json["raw"]).is_dir()
    assert lightstage("sessions", "remove", "ball", "--json").json["removed"] == "ball"
    assert lightstage("sessions", "list", "--json").json["sessions"] == []
    check_refusal(lightstage("sessions", "show", "ball"), "no session 'ball'")


def test_an_item_is_shown_by_the_beginning_of_its_name(lightstage: Lightstage, standing: Path) -> None:
    done = lightstage("calibration", "show", "homography", "--json", store=standing).json
    assert done["values"]["matrix"] == [[1, 0, -1], [0, 1, 0], [0, 0, 1]]
    (entry,) = [
        item
        for item in lightstage("calibration", "list", "--json", store=standing).json["items"]
        if item["item"] == done["item"]
    ]
    assert (entry["digest"], entry["sessions"]) == (done["digest"], ["ball"])
    assert "item: homography" in lightstage("calibration", "show", done["item"], store=standing).out


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("import", "nowhere"), "nowhere is not a folder"),
        (("calibration", "show", "homograpy"), "no calibration item"),
        (("calibration", "use", "no.yaml", "--session", "ball"), "no.yaml is missing"),
        (("calibration", "list", "--session", "bal"), "no session 'bal'"),
    ],
)
def test_a_wrong_request_is_one_sentence(
    lightstage: Lightstage, standing: Path, words: tuple[str, ...], part: str
) -> None:
    check_refusal(lightstage(*words, store=standing), part)

"""The virtual rig as a capture beside its truth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

import lightstage
from lightstage.api.virtual_rig import TARGETS, Head, capture_head, capture_target, keep_truth

SMALL = Head(session="small", size=(48, 36), bands_nm=(576,), seed=5)


def test_the_same_head_is_captured_once_and_another_beside_it(store: lightstage.OpenStore) -> None:
    told: list[str] = []
    opened = store.create()
    folder = capture_head(opened, SMALL, told.append)
    assert told == ["the virtual rig captures 7 illuminations in 1 band(s)"]
    times = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    assert capture_head(opened, SMALL, told.append) == folder
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == times
    other = capture_head(opened, replace(SMALL, seed=6), told.append)
    assert (other.parent, len(told)) == (folder.parent, 2)
    assert other != folder
    described = yaml.safe_load((folder / "capture.yaml").read_text())
    assert (described["session"], described["bands_nm"]) == ("small", [576])


def test_a_head_s_truth_lies_beside_the_session_that_it_became(store: lightstage.OpenStore) -> None:
    session = store.demo("small", size=(48, 36), bands_nm=(576,), seed=5)
    with np.load(session.folder / "truth" / "ground_truth_cam1.npz") as truth:
        normal, mask = truth["normal"], truth["mask"]
    assert normal.shape == (36, 48, 3)
    np.testing.assert_allclose(np.linalg.norm(normal[mask], axis=1), 1, atol=1e-5)
    assert normal[mask][:, 2].mean() > 0.5  # it looks at the camera


def test_truth_of_another_capture_is_taken_away(store: lightstage.OpenStore, sphere: Path, tmp_path: Path) -> None:
    session = store.import_capture(sphere).session
    for name, files in (("one", "ab"), ("two", "bc")):
        (tmp_path / name / "truth").mkdir(parents=True)
        for file in files:
            (tmp_path / name / "truth" / file).write_text(name)
        truth = keep_truth(session.opened, "ball", tmp_path / name)
    assert truth == session.folder / "truth"
    assert {path.name: path.read_text() for path in truth.iterdir()} == {"b": "two", "c": "two"}
    assert (tmp_path / "one" / "truth" / "b").read_text() == "one"


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ({"session": "../x"}, "--session '../x': a name has"),
        ({"bands_nm": (434, 434)}, "--bands 434,434: a wavelength stands twice"),
        ({"bands_nm": (20,)}, "390 to 760 nm"),
        ({"size": (8, 8)}, "32 to 8192 pixels"),
        ({"seed": -1}, "seed -1"),
        ({"sequence": "wilson", "tracking": 0}, "--tracking"),
        ({"sequence": "minimal", "bands_nm": (434, 576)}, "a performance has one band"),
    ],
)
def test_what_the_rig_cannot_capture_is_a_wrong_request(
    store: lightstage.OpenStore, options: dict[str, object], part: str
) -> None:
    with pytest.raises(lightstage.RequestError, match=part.replace("(", r"\(")):
        capture_head(store.create(), replace(SMALL, **options), print)  # type: ignore[arg-type]
    assert not list(store.root.glob("captures/*"))


def test_a_target_is_a_folder_that_says_what_it_shows(store: lightstage.OpenStore) -> None:
    told: list[str] = []
    folder = capture_target(store.create(), "dark", SMALL, told.append)
    described = yaml.safe_load((folder / "capture.yaml").read_text())
    assert described["target"] == {"kind": "dark"}
    assert {frame["illumination"] for frame in described["frames"]} == {"O"}
    assert (folder / "truth" / "truth.yaml").is_file()
    assert told == ["the virtual rig captures: dark"]
    assert set(TARGETS.values()) >= {"dark", "flat", "homography", "lights"}

"""The files of a set: tables, page, copies of jsPsych, digests."""

import csv
import hashlib
import io
import json
from pathlib import Path

import pytest

from lightstage.products.errors import ProductError
from lightstage.products.stimulus_folder import COLUMNS, Screen, assemble, jspsych_files, manifest, sha256

ROW = dict.fromkeys(COLUMNS, "") | {
    "subject": "a", "kind": "shape", "file": "a_shape.png", "width_px": 112, "height_px": 152,
    "width_deg": 2.97654321, "height_deg": 4.0, "mean": 1 / 3,
}  # fmt: skip


def test_the_folder() -> None:
    files = assemble([ROW], {"a_shape.png": b"png"}, {"format": "x"}, "points", jspsych={})
    assert set(files) == {
        "a_shape.png", "stimuli.csv", "conditions.csv", "stimuli.js", "experiment.html", "points.yaml",
        "recipe.json",
    }  # fmt: skip
    (row,) = csv.DictReader(io.StringIO(files["stimuli.csv"].decode()))
    assert tuple(row) == COLUMNS
    assert row["mean"] == "0.333333"
    (condition,) = csv.DictReader(io.StringIO(files["conditions.csv"].decode()))
    assert all(name.isidentifier() for name in condition)
    assert condition["width_deg"] == "2.9765"
    (told,) = json.loads(files["stimuli.js"].decode().removeprefix("const stimuli = ").rstrip().removesuffix(";"))
    assert told["file"] == "a_shape.png"
    assert b"unpkg.com" in files["experiment.html"]
    assert json.loads(files["recipe.json"]) == {"format": "x"}


def test_a_local_copy_of_jspsych_goes_into_the_set(tmp_path: Path) -> None:
    with pytest.raises(ProductError, match="is no copy of jsPsych"):
        jspsych_files(tmp_path)
    for name in ("jspsych.css", "jspsych.js", "plugin-image-keyboard-response.js"):
        (tmp_path / name).write_text(name)
    copied = jspsych_files(tmp_path)
    files = assemble([ROW], {}, {}, "", jspsych=copied)
    assert files["jspsych/jspsych.js"] == b"jspsych.js"
    assert b"unpkg.com" not in files["experiment.html"]
    assert b'src="jspsych/jspsych.js"' in files["experiment.html"]


def test_degrees_and_digests() -> None:
    assert Screen(57.0, 37.8).degrees(38) == pytest.approx(1.01, abs=0.01)  # a centimetre, 57 cm away
    assert sha256(b"a") == hashlib.sha256(b"a").hexdigest()
    assert manifest({"a": b"1"}) != manifest({"a": b"2"}) != manifest({"b": b"2"})

"""A pipeline as it is read: its nodes, what differs from the defaults, and its drawing."""

from pathlib import Path

import pytest

import lightstage
from lightstage.api.pipelines import drawing, read_pipeline

TEXT = """
stages:
  pictures: {uses: capture}
  clean: {uses: register, from: pictures, params: {flat_smoothing_percent: 3}}
  split: {uses: split, from: clean, when: asked}
"""


def test_a_pipeline_file_is_read_and_drawn(tmp_path: Path) -> None:
    file = tmp_path / "p.yaml"
    file.write_text(TEXT)
    pipeline = read_pipeline(file)
    assert list(pipeline.nodes) == ["pictures", "clean", "split"]
    clean = pipeline.nodes["clean"]
    assert (clean.stage, clean.above, clean.asked, dict(clean.changed)) == (
        "register",
        ("pictures",),
        False,
        {"flat_smoothing_percent": 3},
    )
    assert clean.parameters["flat_smoothing_percent"] == 3
    assert clean.outputs["signal"] == ("frame", "band", "polarisation", "y", "x")
    lines = list(drawing(pipeline))
    assert lines[1].startswith("└─ clean: ")
    assert lines[1].endswith("flat_smoothing_percent: 3.0")
    assert lines[2].endswith("(when asked)")


def test_changes_are_checked_as_the_file_is(tmp_path: Path) -> None:
    with pytest.raises(lightstage.RequestError, match="there is no node 'nrmals'"):
        read_pipeline(changes=["nrmals.method=ratio"])
    assert read_pipeline(changes=["normals.method=ratio"]).nodes["normals"].changed["method"] == "ratio"

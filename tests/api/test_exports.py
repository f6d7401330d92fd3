"""An export is all there or not at all, and says whose files are."""

import json
from pathlib import Path

import pytest

from lightstage.api.exports import exported
from lightstage.store.errors import RequestError


def export(folder: Path, node: str, *files: str) -> list[Path]:
    with exported(folder, "head", node, files) as export:
        for name in files:
            (export.work / name).write_text(f"{node} {name}")
            export.add([name])
    return export.files


def test_an_export_is_all_there_and_says_whose_it_is(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert export(out, "normals", "a", "b") == [out / "a", out / "b"]
    assert {path.name for path in out.iterdir()} == {"a", "b", "export.json"}
    record = json.loads((out / "export.json").read_text())
    assert record["format"] == "lightstage-export/1"
    assert record["files"]["a"]["node"] == "normals"
    export(out, "stack", "c")
    with pytest.raises(RequestError, match="a is there already and is of node 'normals'"):
        export(out, "stack", "a")
    export(out, "normals", "a")


def test_half_an_export_is_none(tmp_path: Path) -> None:
    def stop() -> None:
        with exported(tmp_path, "head", "normals", ["a", "b"]) as export:
            (export.work / "a").write_text("")
            export.add(["a"])
            raise KeyError("b")

    with pytest.raises(KeyError, match="b"):
        stop()
    assert not list(tmp_path.iterdir())

"""Pictures that the store keeps, and exports."""

import json
from pathlib import Path

import pytest

from lightstage.cli.deliver import exported, keep_picture
from lightstage.formats.errors import FormatError


def test_a_picture_is_drawn_when_what_it_shows_has_changed(tmp_path: Path) -> None:
    path, drawn = tmp_path / "pictures" / "a.png", []

    def draw(where: Path) -> None:
        drawn.append(where)
        where.write_bytes(b"%d" % len(drawn))

    for results, count in (([Path("r/1")], 1), ([Path("r/1")], 1), ([Path("r/2")], 2), ([Path("r/2")], 2)):
        assert keep_picture(path, results, draw) == path
        assert len(drawn) == count
    path.write_bytes(b"painted over")
    keep_picture(path, [Path("r/2")], draw)
    assert path.read_bytes() == b"3"


def test_a_picture_that_fails_is_drawn_again(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    keep_picture(path, [Path("r/1")], lambda where: where.write_bytes(b"1"))

    def fail(where: Path) -> None:
        raise OSError("full")

    with pytest.raises(OSError, match="full"):
        keep_picture(path, [Path("r/2")], fail)
    keep_picture(path, [Path("r/1")], lambda where: where.write_bytes(b"again"))
    assert path.read_bytes() == b"again"


def export(folder: Path, node: str, *files: str) -> list[str]:
    with exported(folder, "head", node, files) as export:
        for name in files:
            (export.work / name).write_text(f"{node} {name}")
            export.add([name])
    return export.files


def test_an_export_is_all_there_and_says_whose_it_is(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert export(out, "normals", "a", "b") == [str(out / "a"), str(out / "b")]
    assert {path.name for path in out.iterdir()} == {"a", "b", "export.json"}
    record = json.loads((out / "export.json").read_text())
    assert record["format"] == "lightstage-export/1"
    assert record["files"]["a"]["node"] == "normals"
    export(out, "stack", "c")
    with pytest.raises(FormatError, match="a is there already and is of node 'normals'"):
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

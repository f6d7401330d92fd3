"""Sets of files: all or nothing, and nothing of anybody else's is lost."""

import errno
import json
import os
from pathlib import Path

import pytest

from lightstage.formats.errors import FormatError
from lightstage.formats.whole_set import WholeSet, digest, write_folder


def deliver(folder: Path, text: str, *, name: str = "a", **subject: str) -> None:
    delivery = WholeSet(folder, "record.json", subject=subject)
    delivery.claim([name])
    with delivery.making() as work:
        (work / name).write_text(text)
        assert delivery.settle(work, {"format": "x/1"}, {name: dict(subject)}) == [folder / name]


def test_a_folder_is_there_whole_and_only_once(tmp_path: Path) -> None:
    files = {"a.png": b"a", "sub/b.png": b"b"}
    assert write_folder(tmp_path / "up" / "set", files)
    assert (tmp_path / "up" / "set" / "sub" / "b.png").read_bytes() == b"b"
    assert list((tmp_path / "up").iterdir()) == [tmp_path / "up" / "set"]
    assert not write_folder(tmp_path / "up" / "set", files)
    with pytest.raises(FormatError, match="something is there already"):
        write_folder(tmp_path / "up" / "set", {"a.png": b"other"})
    (tmp_path / "gone").symlink_to("nowhere")
    with pytest.raises(FormatError, match="something is there already"):
        write_folder(tmp_path / "gone", files)


def test_a_folder_that_fails_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: Path, data: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device", str(self))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space left") as failed:
        write_folder(tmp_path / "set", {"a": b"a"})
    assert failed.value.filename == str(tmp_path / "set")
    assert not list(tmp_path.iterdir())


def test_its_own_files_are_made_anew_and_others_are_not(tmp_path: Path) -> None:
    deliver(tmp_path, "first", session="one")
    deliver(tmp_path, "second", session="one")
    assert (tmp_path / "a").read_text() == "second"
    deliver(tmp_path, "more", name="b", session="one")
    record = json.loads((tmp_path / "record.json").read_text())
    assert record["files"]["a"] == {"session": "one", "digest": digest(tmp_path / "a")}
    (tmp_path / "a").write_text("painted over")
    with pytest.raises(FormatError, match=r"a is there already and is not as record.json describes it"):
        deliver(tmp_path, "third", session="one")
    (tmp_path / "a").unlink()
    (tmp_path / "a").symlink_to("b")
    with pytest.raises(FormatError, match=r"is not as record.json"):
        deliver(tmp_path, "third", session="one")
    assert (tmp_path / "b").read_text() == "more"


def test_a_file_of_another_thing_is_not_replaced(tmp_path: Path) -> None:
    deliver(tmp_path, "first", session="one", node="normals")
    with pytest.raises(FormatError, match="a is there already and is of session 'one' and node 'normals'"):
        deliver(tmp_path, "second", session="two", node="relief")
    deliver(tmp_path, "beside", name="b", session="two", node="relief")
    assert (tmp_path / "a").read_text() == "first"


def test_a_whole_folder_can_be_of_one_session(tmp_path: Path) -> None:
    delivery = WholeSet(tmp_path, "record.json", subject={"session": "one"})
    delivery.claim(["a"])
    with delivery.making() as work:
        (work / "a").write_text("made")
        delivery.settle(work, {"session": "one"}, {"a": {}})
    with pytest.raises(FormatError, match="holds the files of session 'one'"):
        WholeSet(tmp_path, "record.json", subject={"session": "two"}).claim(["b"])


def test_what_stops_leaves_nothing(tmp_path: Path) -> None:
    delivery = WholeSet(tmp_path / "out", "record.json", subject={})
    delivery.claim(["a"])

    def stopped() -> None:
        with delivery.making() as work:
            (work / "a").write_text("half")
            raise KeyError("stopped")

    with pytest.raises(KeyError, match="stopped"):
        stopped()
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize("content", ["{}", "[]", "no json", '{"files": {"a": {}}}', '{"files": []}'])
def test_a_record_of_somebody_else_stops_it(tmp_path: Path, content: str) -> None:
    (tmp_path / "record.json").write_text(content)
    with pytest.raises(FormatError, match=r"record.json is there already and is no record of this command"):
        WholeSet(tmp_path, "record.json", subject={}).claim(["a"])


def test_places_that_are_none(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "record.json")
    with pytest.raises(FormatError, match="is no record"):
        WholeSet(tmp_path, "record.json", subject={}).claim([])
    (tmp_path / "file").write_text("")
    with pytest.raises(FormatError, match="no folder can be made there"):
        WholeSet(tmp_path / "file" / "x", "record.json", subject={}).claim([])

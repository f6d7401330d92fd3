"""What a person sees."""

import io
import json
import os
import sys
from pathlib import Path

import pytest

from lightstage.cli.show import RunWatcher, Screen, written
from lightstage.store.errors import WorkError


def test_columns_are_as_wide_as_their_widest_cell(capsys: pytest.CaptureFixture[str]) -> None:
    Screen(as_json=False).table(("name", "n"), [("a", 1), ("longer", 100)], right=(1,))
    assert capsys.readouterr().out == "name      n\na         1\nlonger  100\n"


def test_json_is_the_document_alone(capsys: pytest.CaptureFixture[str]) -> None:
    for as_json in (True, False):
        screen = Screen(as_json=as_json)
        screen.say("a line")
        screen.table(("head",), [("cell",)])
        screen.warn("a warning")
        screen.document({"path": Path("x"), "n": 1})
        captured = capsys.readouterr()
        assert captured.err == "note: a warning\n"
        if as_json:
            assert json.loads(captured.out) == {"path": "x", "n": 1}
        else:
            assert captured.out == "a line\nhead\ncell\n"


def test_nobody_watches_a_pipe() -> None:
    screen = Screen(as_json=False)
    items = [1, 2]
    assert not screen.lively
    assert screen.progress(items, 2, "pictures") is items
    with RunWatcher(screen) as watcher:
        watcher.begin({"normals": 1}, 7)
        watcher.done("normals", True)
    assert screen._live is None


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_somebody_at_a_terminal_sees_how_far_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    screen = Screen(as_json=False)
    assert list(screen.progress(iter("ab"), 2, "pictures")) == ["a", "b"]
    assert "pictures" in terminal.getvalue()
    with RunWatcher(screen) as watcher:
        watcher.begin({"normals": 2, "shape": 0}, 7)
        watcher.done("normals", True)
        watcher.done("shape", True)  # which had nothing to do, and no bar
        watcher.warn("half is [dark]")
    assert "note: half is [dark]" in terminal.getvalue()
    assert not Screen(as_json=True).lively


def test_a_letter_that_the_terminal_lacks_is_its_number(monkeypatch: pytest.MonkeyPatch) -> None:
    output = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", output)
    screen = Screen(as_json=False)
    screen.say("ä°")
    screen.flush()
    assert output.buffer.getvalue() == b"\\xe4\\xb0\n"  # type: ignore[attr-defined]


def test_a_full_disk_fails_and_a_closed_pipe_ends() -> None:
    with pytest.raises(WorkError, match=r"cannot be written to stdout \(No space left on device\)"), written():
        raise OSError(28, os.strerror(28))
    with pytest.raises(BrokenPipeError), written():
        raise BrokenPipeError

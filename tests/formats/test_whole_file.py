"""A file is there whole or not at all, and nothing is left beside it."""

import errno
import fcntl
import os
import subprocess
import sys
from pathlib import Path

import pytest

from lightstage.formats.errors import FormatError
from lightstage.formats.whole_file import PREFIX, whole_file, work_folder, write_new, write_whole


def test_it_takes_its_name_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    with whole_file(path) as beside:
        beside.write_bytes(b"half")
        assert beside.name == "a.png"  # by which writers choose a format
        assert not path.exists()
    assert path.read_bytes() == b"half"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("failure", [OSError(errno.ENOSPC, "No space left on device"), ValueError("not that")])
def test_what_fails_leaves_what_stood_there(tmp_path: Path, failure: Exception) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(b"old")

    def write() -> None:
        with whole_file(path) as beside:
            beside.write_bytes(b"half of the new")
            raise failure

    with pytest.raises(type(failure)) as caught:
        write()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
    if isinstance(caught.value, OSError):
        assert (caught.value.errno, caught.value.filename) == (errno.ENOSPC, str(path))


def test_an_error_of_another_file_keeps_its_name(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as caught, whole_file(tmp_path / "a"):
        (tmp_path / "source").read_bytes()
    assert caught.value.filename == str(tmp_path / "source")


def test_a_folder_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as caught:
        write_whole(tmp_path / "no" / "a", b"")
    assert caught.value.filename == str(tmp_path / "no" / "a")


KILLED = """
import os, sys
from pathlib import Path
from lightstage.formats.whole_file import work_folder
with work_folder(Path(sys.argv[1])) as work:
    (work / "half").write_bytes(b"half of it")
    os.kill(os.getpid(), 9)
"""


def test_what_a_killed_process_left_is_removed_by_the_next(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], timeout=60, check=False)
    (left,) = tmp_path.glob(f"{PREFIX}*")
    assert (left / "half").exists()
    write_whole(tmp_path / "a", b"whole")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_what_another_process_writes_and_what_is_not_ours_stays(tmp_path: Path) -> None:
    (tmp_path / f"{PREFIX}notes.txt").write_text("a person's")
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "kept").write_text("")
    (tmp_path / f"{PREFIX}link").symlink_to(outside)
    with work_folder(tmp_path) as first, work_folder(tmp_path) as second:
        assert first != second
        write_whole(tmp_path / "a", b"")
        assert first.is_dir()
        assert second.is_dir()
    assert {path.name for path in tmp_path.iterdir()} == {"a", "outside", f"{PREFIX}link", f"{PREFIX}notes.txt"}
    assert (outside / "kept").exists()


def test_a_folder_that_was_taken_for_a_leftover_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another process comes between the making of a folder and its lock: it holds the lock, or has removed it."""
    lock, taken = fcntl.flock, []

    def late(descriptor: int, how: int) -> None:
        if len(taken) == 0:
            taken.append("held")
            raise BlockingIOError(errno.EWOULDBLOCK, "held")
        if len(taken) == 1:
            taken.append("removed")
            os.rmdir(os.readlink(f"/proc/self/fd/{descriptor}"))
        lock(descriptor, how)

    monkeypatch.setattr("fcntl.flock", late)
    with work_folder(tmp_path) as work:
        (work / "a").write_text("")
    assert taken == ["held", "removed"]


def test_a_new_file_is_written_once_and_takes_nobody_s_place(tmp_path: Path) -> None:
    path = tmp_path / "new" / "a.png"
    write_new(path, b"a")
    inode = path.stat().st_ino
    write_new(path, b"a")
    assert path.stat().st_ino == inode
    with pytest.raises(FormatError, match=r"a\.png is there already and holds something else"):
        write_new(path, b"b")
    assert path.read_bytes() == b"a"
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    for other in (tmp_path / "new", tmp_path / "link"):
        with pytest.raises(FormatError, match="is there already"):
            write_new(other, b"a")

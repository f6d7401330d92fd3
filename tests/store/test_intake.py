"""Files that a user names: whatever a name leads to, the answer comes at once and in words."""

import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from lightstage.store.errors import RequestError
from lightstage.store.importer import import_capture
from lightstage.store.intake import FileError, read_regular
from lightstage.store.root import Store
from tests.scenes import one_camera_capture


def pipe(path: Path) -> None:
    os.mkfifo(path)


def listening(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(str(path))


def circle(path: Path) -> None:
    path.symlink_to(path.name)


def to(target: str) -> Callable[[Path], None]:
    return lambda path: path.symlink_to(target)


NO_FILES = {
    "pipe": (pipe, "is a pipe, and no file"),
    "socket": (listening, "is a socket, and no file"),
    "folder": (Path.mkdir, "is a folder, and no file"),
    "device": (to("/dev/zero"), "is a device, and no file"),
    "circle": (circle, "it is a link that leads to itself"),
    "nothing": (to("gone.png"), "is a link to gone.png, which is missing"),
    "missing": (lambda path: None, "is missing"),
}


@pytest.mark.parametrize("kind", NO_FILES)
def test_what_is_no_file_is_refused_and_not_waited_for(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    make, message = NO_FILES[kind]
    monkeypatch.chdir(tmp_path)  # the path of a socket is short
    make(Path("it"))
    with pytest.raises(FileError, match=message):
        read_regular(Path("it"), 1 << 20)


def test_a_name_that_no_file_can_have_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="is no name that a file can have"):
        read_regular(tmp_path / "a\0b", 1)
    with pytest.raises(FileError, match="cannot be read"):
        read_regular(tmp_path / ("a" * 5000), 1)


def test_a_file_is_read_up_to_the_limit_and_not_beyond(tmp_path: Path) -> None:
    (tmp_path / "it").write_bytes(b"1234")
    assert read_regular(tmp_path / "it", 4) == b"1234"
    with pytest.raises(FileError, match="has 4 bytes, more than the 3 that it may have"):
        read_regular(tmp_path / "it", 3)


def test_a_capture_of_what_is_no_picture_names_each(tmp_path: Path, store: Store) -> None:
    folder = one_camera_capture(tmp_path / "c", ["C", "X", "Y", "Z"])
    victims = [folder / f"{i:04d}_{name}_0nm_CAM1.png" for i, name in enumerate("CXYZ")]
    for victim, kind in zip(victims, ("pipe", "device", "circle", "folder"), strict=True):
        victim.unlink()
        NO_FILES[kind][0](victim)
    with pytest.raises(RequestError) as caught:
        import_capture(folder, store)
    lines = str(caught.value).splitlines()
    assert [str(victim) in line for victim, line in zip(victims, lines, strict=True)] == [True] * 4


def test_a_mask_that_is_a_pipe_is_refused(tmp_path: Path, store: Store) -> None:
    folder = one_camera_capture(tmp_path / "c", ["C"], mask="mask.png")
    os.mkfifo(folder / "mask.png")
    with pytest.raises(RequestError, match=r"is a pipe, and no file; capture\.yaml names it as the mask"):
        import_capture(folder, store)

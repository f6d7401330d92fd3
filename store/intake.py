"""Files that a user names, read whole: regular files of a sane size, and nothing that never ends.

A name may lead to a pipe that nobody writes to, to a device that gives bytes for ever, or round in a circle.
None of them is waited for: what a name leads to is looked at before it is opened, and what was opened is looked
at again.
"""

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


class FileError(ValueError):
    """The file is not there, or not what is expected; the message does not name it, the caller does."""


def read_regular(path: Path, limit: int) -> bytes:
    """The bytes of a regular file, which did not change while it was read.

    Args:
        path: of the file.
        limit: bytes that it may have.

    Raises:
        FileError: it is missing, no regular file, larger, unreadable, or was written to in the meantime.
    """
    with open_regular(path) as file, _as_sentence(path):
        before = os.fstat(file.fileno())
        if before.st_size > limit:
            raise FileError(f"has {before.st_size} bytes, more than the {limit} that it may have")
        data = file.read(before.st_size + 1)
        after = os.stat(path)
    stamps = [(status.st_size, status.st_mtime_ns, status.st_ino) for status in (before, after)]
    if stamps[0] != stamps[1] or len(data) != before.st_size:
        raise FileError("changed while it was read; wait until it is complete")
    return data


@contextmanager
def open_regular(path: Path) -> Iterator[BinaryIO]:
    """A regular file, open for reading.

    Raises:
        FileError: it is missing, no regular file, or may not be read.
    """
    with _as_sentence(path):
        _refuse_other(os.stat(path))  # some devices do something when they are opened
        file = open(path, "rb", opener=_without_waiting)  # noqa: SIM115  closed below
    with file:
        _refuse_other(os.fstat(file.fileno()))
        yield file


def _without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK | os.O_NOCTTY)


def _refuse_other(status: os.stat_result) -> None:
    for is_kind, kind in _KINDS:
        if is_kind(status.st_mode):
            raise FileError(f"is {kind}, and no file")


@contextmanager
def _as_sentence(path: Path) -> Iterator[None]:
    try:
        yield
    except FileError:
        raise
    except (FileNotFoundError, NotADirectoryError):
        link = os.path.islink(path)
        raise FileError(f"is a link to {os.readlink(path)}, which is missing" if link else "is missing") from None
    except ValueError:  # a NUL, or half a character
        raise FileError("is no name that a file can have") from None
    except OSError as error:
        why = "it is a link that leads to itself" if error.errno == errno.ELOOP else error.strerror
        raise FileError(f"cannot be read ({why})") from None

"""A file of the user's, whole or not at all.

What is delivered is written beside its place, in a folder of its own, and takes its place when it is whole. Where
that fails, what stood there stands, and nothing is left beside it. A process that is killed can leave its folder;
the next one that delivers there removes it, told by the lock that died with its owner.
"""

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from lightstage.formats.errors import FormatError

PREFIX = ".lightstage-"


@contextmanager
def work_folder(folder: Path) -> Iterator[Path]:
    """A folder inside `folder`, which is there, to write into; it is gone when the block ends, however it ends.

    Raises:
        OSError: it cannot be made.
    """
    _remove_leftovers(folder)
    work, lock = _own_folder(folder)
    try:
        yield work
    finally:
        shutil.rmtree(work, ignore_errors=True)
        os.close(lock)


def _own_folder(folder: Path) -> tuple[Path, int]:
    """A new folder, and its descriptor, which holds the lock where the file system knows locks."""
    while True:
        work = Path(tempfile.mkdtemp(prefix=PREFIX, dir=folder))
        with suppress(FileNotFoundError, BlockingIOError):  # taken for a leftover before it was locked
            lock = os.open(work, os.O_RDONLY)
            try:
                try:
                    _lock(lock)
                except BlockingIOError:
                    raise
                except OSError:
                    pass  # without locks nothing is ever taken for a leftover
                if os.path.samestat(os.fstat(lock), os.stat(work)):
                    return work, lock
            except BaseException:
                os.close(lock)
                raise
            os.close(lock)


def _lock(descriptor: int) -> None:
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _remove_leftovers(folder: Path) -> None:
    """What processes that are no more have left. What cannot be locked has an owner, and stays."""
    with suppress(OSError):
        for left in folder.glob(f"{PREFIX}*"):
            with suppress(OSError):
                lock = os.open(left, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
                try:
                    _lock(lock)
                    shutil.rmtree(left, ignore_errors=True)
                finally:
                    os.close(lock)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A file to write into, which becomes `path` when the block ends well.

    It has the name of `path`, because some writers choose their format by that. Its folder must be there.

    Raises:
        OSError: it cannot be written; the error names `path`.
    """
    beside = None
    try:
        with work_folder(path.parent) as work:
            beside = work / path.name
            yield beside
            os.replace(beside, path)
    except OSError as error:
        if beside is not None and error.filename not in (None, str(beside)):
            raise  # of another file
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


def write_new(path: Path, data: bytes) -> None:
    """Put `data` at `path`, where there is nothing yet, or the same. The file's folder is made too.

    Raises:
        FormatError: something else is there.
        OSError: it cannot be written.
    """
    if os.path.lexists(path):
        if path.is_file() and path.read_bytes() == data:
            return
        raise FormatError(f"{path} is there already and holds something else; remove it, or name another file")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, data)


def write_whole(path: Path, data: bytes) -> None:
    """Put `data` at `path`, in place of what stood there, in one step.

    Raises:
        OSError: it cannot be written; the error names `path`.
    """
    with whole_file(path) as beside:
        beside.write_bytes(data)

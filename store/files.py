"""Files that are there whole or not at all.

Everything is first written under the store's `tmp/` (one folder a process) and then renamed or linked into
place. After a kill, what is left lies in `tmp/` and is swept when the next process opens the store.
"""

import contextlib
import errno
import itertools
import os
import secrets
import shutil
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from store.errors import WorkError

_counter = itertools.count()
_NO_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EXDEV, errno.EMLINK)


class Scratch:
    """The store's `tmp/`: a folder of its own for this process, and a sweep of what dead ones left.

    The folder's name ends in a random word: after a kill it may hold a second link to a finished file, which a
    later process with the same number must not open for writing.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._mine: Path | None = None
        self._pid = 0
        self._making = threading.Lock()

    def path(self) -> Path:
        """A new path, unique over threads, processes and hosts."""
        with self._making:
            if self._mine is None or self._pid != os.getpid() or not self._mine.is_dir():
                self._pid = os.getpid()
                self._mine = self.folder / f"{socket.gethostname()}~{self._pid}~{secrets.token_hex(4)}"
                with full_disk_is_named(self._mine):
                    self._mine.mkdir(parents=True, exist_ok=True)
            return self._mine / str(next(_counter))

    def __getstate__(self) -> dict[str, object]:
        """A store travels to workers; the lock and the folder stay here."""
        return {"folder": self.folder}

    def __setstate__(self, state: dict[str, Path]) -> None:
        self.__init__(state["folder"])  # type: ignore[misc]

    def remove(self, path: Path) -> None:
        """Take a folder or a file away in one step, so that nobody meets it half removed."""
        doomed = self.path()
        with full_disk_is_named(path):
            try:
                os.rename(path, doomed)
            except FileNotFoundError:
                return
        if doomed.is_dir():
            shutil.rmtree(doomed, ignore_errors=True)
        else:
            doomed.unlink(missing_ok=True)

    def sweep(self) -> None:
        """Delete what processes of this host that no longer run have left behind."""
        host = socket.gethostname()
        try:
            names = os.listdir(self.folder)
        except FileNotFoundError:
            return
        for name in names:
            owner, _, rest = name.partition("~")
            pid = rest.partition("~")[0]
            if owner == host and pid.isdecimal() and int(pid) != os.getpid() and not _alive(int(pid)):
                shutil.rmtree(self.folder / name, ignore_errors=True)

    def leave(self) -> None:
        """Delete this process's own folder."""
        if self._mine is not None and self._pid == os.getpid():
            shutil.rmtree(self._mine, ignore_errors=True)
            self._mine = None


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


@contextlib.contextmanager
def full_disk_is_named(path: Path) -> Iterator[None]:
    """Turn "no space left" and "read-only" into a sentence that says which disk and what to do."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise WorkError(
                f"the disk that holds {path} is full: nothing was lost, but the work cannot go on; "
                "free some space (`lightstage gc --dry-run` shows what the store could give) and run again"
            ) from error
        if error.errno in (errno.EROFS, errno.EACCES, errno.EPERM):
            raise WorkError(f"{path} cannot be written ({error.strerror}); choose another --store") from error
        raise


def write_new(path: Path, data: bytes | memoryview, *, durable: bool) -> None:
    """Write a new file, and wait for the disk if it is to be durable. `path` should lie in scratch."""
    with full_disk_is_named(path), open(path, "xb", buffering=0) as file:
        left = memoryview(data)
        while left:
            left = left[file.write(left) :]
        if durable:
            os.fsync(file.fileno())


class Flusher:
    """Flushes written files to the disk beside the work; `wait` is the barrier before anything refers to them."""

    def __init__(self) -> None:
        self._pool: ThreadPoolExecutor | None = None
        self._pending: list[Future[None]] = []
        self._lock = threading.Lock()

    def add(self, path: Path) -> None:
        """Flush a file soon."""
        with self._lock:
            if self._pool is None:
                self._pool = ThreadPoolExecutor(4, thread_name_prefix="flush")
            self._pending = [f for f in self._pending if not f.done() or f.exception()]
            self._pending.append(self._pool.submit(_flush, path))

    def wait(self) -> None:
        """Return when all that was added is on the disk.

        Raises:
            WorkError: the disk is full.
        """
        with self._lock:
            pending, self._pending = self._pending, []
        for future in pending:
            future.result()


def _flush(path: Path) -> None:
    with full_disk_is_named(path), contextlib.suppress(FileNotFoundError), open(path, "rb") as file:
        os.fsync(file.fileno())


def replace(scratch: Scratch, path: Path, data: bytes) -> None:
    """Put `data` at `path`, in place of what stood there, in one step."""
    with full_disk_is_named(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = scratch.path()
        write_new(temporary, data, durable=True)
        os.replace(temporary, path)


def put_if_absent(scratch: Scratch, path: Path, data: bytes | memoryview, *, durable: bool = True) -> bool:
    """Put `data` at `path` unless something is there already; says whether it did."""
    with full_disk_is_named(path):
        temporary = scratch.path()
        write_new(temporary, data, durable=durable)
        try:
            _link_new(temporary, path)
        except FileExistsError:
            return False
        finally:
            temporary.unlink(missing_ok=True)
        return True


def _link_new(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except FileNotFoundError:
        target.parent.mkdir(parents=True, exist_ok=True)
        os.link(source, target)
    except OSError as error:
        if error.errno not in _NO_LINKS:
            raise
        # a file system without hard links: two writers may both believe that they were first, with equal content
        if target.exists():
            raise FileExistsError(target) from error
        target.parent.mkdir(parents=True, exist_ok=True)
        os.replace(source, target)


def link_or_copy(source: Path, target: Path) -> None:
    """A second name for a file, or a copy where the file system cannot link."""
    try:
        os.link(source, target)
    except FileNotFoundError:
        raise
    except FileExistsError:
        raise
    except OSError as error:
        if error.errno not in _NO_LINKS:
            raise
        with full_disk_is_named(target):
            shutil.copyfile(source, target)


def files_below(folder: Path) -> Iterator["os.DirEntry[str]"]:
    """Every file below a folder, by name."""
    if not folder.is_dir():
        return
    for entry in sorted(os.scandir(folder), key=lambda item: item.name):
        if entry.is_dir(follow_symlinks=False):
            yield from files_below(Path(entry.path))
        else:
            yield entry


def folder_size(folder: Path) -> int:
    """Bytes in all files below a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def human_size(count: float) -> str:
    """Bytes as a person reads them: 1.5 GB, in powers of 1000."""
    for unit in ("B", "kB", "MB", "GB"):
        if abs(count) < 1000:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000
    return f"{count:.1f} TB"

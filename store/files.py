"""Files that are there whole or not at all, on every file system that a store may lie on.

Everything is first written under the store's `tmp/` (one folder a process) and then linked, renamed or copied into
place. After a kill, what is left lies in `tmp/` and is swept by a later process.

File systems without hard links (exFAT, some network disks) get copies instead, and a file that may only be put
where none is yet is renamed with the kernel's RENAME_NOREPLACE or, where that is not known either, under a lock.
"""

import contextlib
import errno
import fcntl
import itertools
import os
import shutil
import stat
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

from lightstage.store.digest import digest_value
from lightstage.store.errors import WorkError
from lightstage.store.marker import NAME, Marker, gone

_counter = itertools.count()
NO_LINKS = (errno.EPERM, errno.EXDEV, errno.ENOSYS, errno.ENOTSUP, errno.EINVAL, errno.EMLINK)
_GONE = (errno.ESTALE, errno.ENOTCONN, errno.ENODEV, errno.ENXIO)
_ABANDONED_S = 7 * 86400
"""After so long without a change the leavings of another machine are swept."""


class Scratch:
    """The store's `tmp/`: a folder of its own for this process, and a sweep of what dead ones left.

    The folder is named <machine>~<process number>~<random word>. Its owner holds a lock on the file `lock` in it
    for as long as it lives. Host names and process numbers prove nothing (containers share them), so a folder is
    swept when its lock is free and its machine is this one: the same boot of the same kernel, and the same mounted
    file system, where a lock is seen by everybody. One of another machine, whose lock may not reach here, and one
    without a lock are swept when nothing in them has changed for a week.
    """

    def __init__(self, folder: Path, marker: Marker | None = None) -> None:
        """`marker` is what the store must still say of itself when something is to be written into it."""
        self.folder = folder
        self._marker = marker
        self.flusher = Flusher()
        self._mine: Path | None = None
        self._pid = 0
        self._unlock: Callable[[], object] = _nothing
        self._making = threading.Lock()

    @property
    def root(self) -> Path:
        """The store's folder."""
        return self.folder.parent

    def path(self) -> Path:
        """A new path, unique over threads, processes and hosts.

        Raises:
            WorkError: the store is gone, or cannot be written.
        """
        with self._making:
            if self._mine is None or self._pid != os.getpid() or not self._mine.is_dir():
                self._enter()
            assert self._mine is not None
            return self._mine / str(next(_counter))

    def flush(self) -> None:
        """Wait until everything that was put is on the disk: the barrier before anything refers to it.

        Raises:
            WorkError: the disk is full.
        """
        self.flusher.wait()

    def _enter(self) -> None:
        # in a forked child, closing the parent's lock here leaves it with the parent
        self._unlock()
        self._unlock, self._mine, self._pid = _nothing, None, os.getpid()
        with disk_faults_named(self.folder):
            if self._marker is not None:
                self._marker.check(self.root)
            while True:
                self.make_folder(self.folder)
                mine = self.folder / f"{_machine(self.folder)}~{self._pid}~{os.urandom(4).hex()}"
                with contextlib.suppress(FileNotFoundError):
                    mine.mkdir()
                    lock = _hold(mine / "lock")
                    if lock is not None:
                        self._unlock = weakref.finalize(self, os.close, lock)
                    if mine.is_dir():  # else a sweep came between, and found it without its lock
                        break
        self._mine = mine

    def __getstate__(self) -> dict[str, object]:
        """A store travels to workers; the lock, the folder, and what waits to be flushed stay here."""
        return {"folder": self.folder, "marker": self._marker}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__init__(state["folder"], state["marker"])  # type: ignore[misc]

    def make_folder(self, folder: Path) -> None:
        """A folder of the store, with those above it; the store's own is never made anew.

        Raises:
            WorkError: the store is gone.
        """
        if folder.parent == self.root and self._marker is not None and not (self.root / NAME).exists():
            raise gone(self.root)  # an empty mount point is still there
        try:
            folder.mkdir(exist_ok=True)
        except FileNotFoundError:
            if folder == self.root or self.root not in folder.parents or folder.parent == self.root:
                raise gone(self.root) from None
            self.make_folder(folder.parent)
            folder.mkdir(exist_ok=True)

    @contextlib.contextmanager
    def present(self) -> Iterator[None]:
        """Where a file is not found because the whole store is gone, that is what is said."""
        try:
            yield
        except FileNotFoundError as error:
            if self._marker is not None and not (self.root / NAME).exists():
                raise gone(self.root) from error
            raise

    def remove(self, path: Path) -> None:
        """Take a folder or a file away in one step, so that nobody meets it half removed."""
        doomed = self.path()
        with disk_faults_named(path), self.present():
            if not os.path.lexists(path):
                return
            os.rename(path, doomed)
        delete(doomed)

    def now_ns(self) -> int:
        """The time by the file system's clock, which on a shared one is not this host's."""
        path = self.path()
        write_new(path, b"", durable=False)
        now = path.stat().st_mtime_ns
        path.unlink()
        return now

    def next_ns(self, moment: int) -> None:
        """Wait until the file system's clock, which ticks every 4 ms to 2 s, has moved on from a moment."""
        for _ in range(1000):
            if self.now_ns() > moment:
                return
            time.sleep(0.004)

    def leavings(self) -> list[Path]:
        """What dead processes have left behind."""
        with contextlib.ExitStack() as locks:
            return [path for path in self._others() if locks.enter_context(_deserted(path, self.folder))]

    def sweep(self, freed: Callable[[os.stat_result], None] | None = None) -> None:
        """Delete what dead processes have left behind; `freed` is told of each file."""
        for path in self._others():
            with _deserted(path, self.folder) as deserted:
                if deserted:
                    for entry in [entry for entry in os.scandir(path) if entry.name != "lock"]:
                        delete(Path(entry.path), freed)
            if deserted:
                delete(path, freed)

    def others(self) -> list[str]:
        """Names of the processes that seem to be using the store, other than this one."""
        alive = []
        for path in self._others():
            owner, _, rest = path.name.partition("~")
            pid = rest.partition("~")[0]
            with _deserted(path, self.folder) as deserted:
                if deserted:
                    continue
            # before format 2 the owner was a host name, and there was no lock
            old_here = owner == os.uname().nodename and pid.isdecimal()
            if not old_here or _alive(int(pid)):
                alive.append(f"process {pid} ({path})")
        return alive

    def _others(self) -> list[Path]:
        try:
            names = sorted(os.listdir(self.folder))
        except (FileNotFoundError, NotADirectoryError, PermissionError):
            return []
        return [self.folder / name for name in names if self._mine is None or name != self._mine.name]

    def leave(self) -> None:
        """Delete this process's own folder."""
        if self._mine is not None and self._pid == os.getpid():
            self._unlock()  # first: some file systems keep a file that is open under another name
            delete(self._mine)
            self._mine, self._unlock = None, _nothing


def _nothing() -> None:
    """There is no lock to let go."""


def _machine(folder: Path) -> str:
    """The same for all processes that see each other's locks on this folder, and only for them."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii")
    except (FileNotFoundError, PermissionError, UnicodeDecodeError):
        boot = f"unknown {_unknown_boot}"
    return digest_value([boot.strip(), folder.stat().st_dev])[:12]


_unknown_boot = os.urandom(8).hex()


def _hold(path: Path) -> int | None:
    """An open file with a lock on it, until it is closed; None, and no file, where the file system has no locks."""
    file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    try:
        fcntl.flock(file, fcntl.LOCK_EX)
    except OSError:
        os.close(file)
        path.unlink(missing_ok=True)
        return None
    return file


@contextlib.contextmanager
def _deserted(path: Path, folder: Path) -> Iterator[bool]:
    """Whether the owner of a scratch folder is dead; while this is open nobody else can take it over."""
    try:
        file = os.open(path / "lock", os.O_RDWR | os.O_CLOEXEC)
    except OSError:
        yield _unchanged_s(path) > _ABANDONED_S
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        yield False
    else:
        yield path.name.startswith(f"{_machine(folder)}~") or _unchanged_s(path) > _ABANDONED_S
    finally:
        os.close(file)


def _unchanged_s(path: Path) -> float:
    try:
        newest = max([path.stat().st_mtime, *(entry.stat().st_mtime for entry in path.glob("*"))])
    except OSError:
        return 0.0
    return time.time() - newest


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def delete(path: Path, freed: Callable[[os.stat_result], None] | None = None) -> None:
    """Delete a file or a folder with all in it, as far as that is possible; `freed` is told of each file."""
    with contextlib.suppress(OSError):
        status = path.stat(follow_symlinks=False)
        if stat.S_ISDIR(status.st_mode):
            for entry in os.scandir(path):
                delete(Path(entry.path), freed)
            path.rmdir()
        else:
            path.unlink()
            if freed is not None:
                freed(status)


@contextlib.contextmanager
def disk_faults_named(path: Path) -> Iterator[None]:
    """Turn what a disk refuses into a sentence that says which, and what to do."""
    try:
        yield
    except OSError as error:
        sentence = disk_fault(error, path)
        if sentence is None:
            raise
        raise WorkError(sentence) from error


def disk_fault(error: OSError, path: Path | str) -> str | None:
    """What a disk's refusal means and what to do about it; None where it is no fault of the disk."""
    code, why = error.errno, error.strerror
    if code in (errno.ENOSPC, errno.EDQUOT):
        return (
            f"the disk that holds {path} is full: nothing was lost, but the work cannot go on; "
            "free some space (`lightstage gc --dry-run` shows what the store could give) and run again"
        )
    if code in (errno.EROFS, errno.EACCES, errno.EPERM):
        return f"{path} cannot be written ({why}); choose another --store, or have it made yours"
    if code in (errno.EMFILE, errno.ENFILE):
        return (
            f"too many files are open, so {path} cannot be: nothing was lost; raise the limit (`ulimit -n 4096`) "
            "and run again"
        )
    if code == errno.EFBIG:
        return (
            f"{path} would be larger than its file system or `ulimit -f` allows: nothing was lost; choose another "
            "--store, or raise the limit, and run again"
        )
    if code == errno.EIO:
        return (
            f"the disk that holds {path} fails ({why}): see to the disk, then `lightstage verify` says what is "
            "damaged"
        )
    if code == errno.ENAMETOOLONG:
        return f"{str(path)[:200]}... is too long a name for its file system; use shorter ones"
    if code == errno.ELOOP:
        return f"{path} links to itself; name the real folder"
    if code in _GONE:
        return f"the disk that holds {path} is gone ({why}): bring it back and run again"
    return None


def write_new(path: Path, data: bytes | memoryview, *, durable: bool) -> None:
    """Write a new file, and wait for the disk if it is to be durable. `path` should lie in scratch."""
    with disk_faults_named(path), open(path, "xb", buffering=0) as file:
        left = memoryview(data)
        while left:
            left = left[file.write(left) :]
        if durable:
            os.fsync(file.fileno())


class Flusher:
    """Flushes written files to the disk beside the work; `wait` is the barrier before anything refers to them.

    A disk's own cache is emptied once for all who ask at the same time, so several threads flush; they begin when
    there is something to do, a moment later so that it is worth it, and end when there is nothing left. An
    interpreter that exits waits for them.
    """

    def __init__(self) -> None:
        self._pending: deque[Path] = deque()
        self._threads = 0
        self._failure: OSError | WorkError | None = None
        self._done = threading.Condition()
        self._waited_for = threading.Event()

    def add(self, path: Path) -> None:
        """Flush a file soon."""
        with self._done:
            self._pending.append(path)
            if self._threads == _FLUSHING_THREADS or len(self._pending) <= self._threads * _FLUSHED_AT_ONCE:
                return
            self._threads += 1
        try:
            threading.Thread(target=self._work, name="flush").start()
        except RuntimeError:  # no more threads are allowed: `wait` does it
            with self._done:
                self._threads -= 1

    def wait(self) -> None:
        """Return when all that was added is on the disk; lends a hand.

        Raises:
            WorkError: the disk is full.
        """
        with self._done:
            self._threads += 1
        self._waited_for.set()
        self._work()
        with self._done:
            self._done.wait_for(lambda: not self._threads)
            self._waited_for.clear()
            failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def _work(self) -> None:
        while True:
            self._waited_for.wait(_GATHERED_S)
            with self._done:
                batch = [self._pending.popleft() for _ in range(min(_FLUSHED_AT_ONCE, len(self._pending)))]
                if not batch:
                    self._threads -= 1
                    self._done.notify_all()
                    return
            for path in batch:
                try:
                    _flush(path)
                except (OSError, WorkError) as failure:
                    self._failure = failure


_FLUSHING_THREADS, _FLUSHED_AT_ONCE = 4, 16
_GATHERED_S = 0.02
"""So long files come together before they are flushed, unless somebody waits."""


def _flush(path: Path) -> None:
    with disk_faults_named(path), contextlib.suppress(FileNotFoundError):
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            os.fsync(file)
        finally:
            os.close(file)


def replace(scratch: Scratch, path: Path, data: bytes, *, durable: bool = True) -> None:
    """Put `data` at `path`, in place of what stood there, in one step."""
    temporary = scratch.path()
    with disk_faults_named(path), scratch.present():
        write_new(temporary, data, durable=durable)
        _in_folder(scratch, path.parent, lambda: os.replace(temporary, path))


def put_if_absent(scratch: Scratch, path: Path, data: bytes | memoryview, *, durable: bool = True) -> bool:
    """Put `data` at `path` unless something is there already; says whether it did.

    Args:
        durable: wait for the disk; otherwise it is flushed beside the work, and `scratch.flush` waits for it.
    """
    temporary = scratch.path()
    with disk_faults_named(path), scratch.present():
        write_new(temporary, data, durable=durable)
        try:
            move_new(scratch, temporary, path)
        except FileExistsError:
            temporary.unlink(missing_ok=True)
            return False
        if not durable:
            scratch.flusher.add(path)
        return True


def move_new(scratch: Scratch, source: Path, target: Path) -> None:
    """Move a finished file from scratch to where nothing is yet, in one step.

    Raises:
        FileExistsError: something is there, and stays.
    """
    _in_folder(scratch, target.parent, lambda: _move_new(source, target))


def _in_folder(scratch: Scratch, folder: Path, act: Callable[[], None]) -> None:
    """Do what needs a folder, which most often is there."""
    try:
        act()
    except FileNotFoundError:
        scratch.make_folder(folder)
        act()


def _move_new(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError as error:
        if error.errno not in NO_LINKS:
            raise
        _rename_new(source, target)
    else:
        source.unlink()


def _rename_new(source: Path, target: Path) -> None:
    code = _rename_no_replace(source, target)
    if code == 0:
        return
    if code not in (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP):
        raise OSError(code, os.strerror(code), str(target))
    folder = os.open(target.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        # without locks either, two writers may each believe that they were first, with equal content
        with contextlib.suppress(OSError):
            fcntl.flock(folder, fcntl.LOCK_EX)
        if os.path.lexists(target):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target))
        os.rename(source, target)
    finally:
        os.close(folder)


_AT_FDCWD, _RENAME_NOREPLACE = -100, 1  # of <linux/fcntl.h> and <linux/fs.h>


def _rename_no_replace(source: Path, target: Path) -> int:
    """The kernel's renameat2 with RENAME_NOREPLACE, which Python does not have; returns the error, 0 for none."""
    import ctypes

    function = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if function is None:
        return errno.ENOSYS
    done = function(_AT_FDCWD, os.fsencode(source), _AT_FDCWD, os.fsencode(target), _RENAME_NOREPLACE)
    return 0 if done == 0 else ctypes.get_errno()


def put_back(scratch: Scratch, aside: Path, path: Path) -> None:
    """Undo the taking aside of a file or a folder, unless another stands there by now; that one stays."""
    try:
        if aside.is_dir():
            os.rename(aside, path)
        else:
            move_new(scratch, aside, path)
    except OSError as error:
        if error.errno not in (errno.EEXIST, errno.ENOTEMPTY):
            raise
        delete(aside)


def link_or_copy(source: Path, target: Path) -> None:
    """A second name for a file, or a copy where the file system cannot link; `target` lies in scratch.

    Either shows whoever takes the source away in the same moment (`gc`) that it is in use: by the number of its
    links, or by its time.

    Raises:
        FileNotFoundError: there is no such file, or no folder for the target.
    """
    with disk_faults_named(target):
        try:
            os.link(source, target)
        except OSError as error:
            if error.errno not in NO_LINKS:
                raise
            if not renewed(source):
                raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(source)) from None
            shutil.copyfile(source, target)
            with open(target, "rb") as file:
                os.fsync(file.fileno())


def renewed(path: Path) -> bool:
    """Say that a file is in use again, so that `gc` does not take it for old; returns whether it is still there."""
    try:
        os.utime(path)
    except FileNotFoundError:
        return False
    except OSError:
        pass  # another user's: its age must do
    return True


def files_below(folder: Path) -> Iterator["os.DirEntry[str]"]:
    """Every file below a folder, by name; a folder that is not there, or no more, has none."""
    try:
        entries = sorted(os.scandir(folder), key=lambda item: item.name)
    except (FileNotFoundError, NotADirectoryError):
        return
    for entry in entries:
        if entry.is_dir(follow_symlinks=False):
            yield from files_below(Path(entry.path))
        else:
            yield entry


def folder_size(folder: Path) -> int:
    """Bytes in all files below a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())

"""What happens to a command at one of its calls: counted, held, refused, or its store is taken away.

A command of a trial runs in a forked process, where Python's audit events tell of every file that is opened,
renamed, linked or removed, whoever does it. So a place to interfere is named by what happens on disk and not by
a function of ours that may be called otherwise tomorrow.
"""

import os
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

CHANGES = ("create", "os.rename", "os.link", "os.remove", "os.symlink", "os.mkdir", "os.rmdir", "os.utime")
EVENTS = ("open", *CHANGES, "os.listdir", "os.scandir")
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT


@dataclass(frozen=True)
class At:
    """A place in a command: the nth event below a folder, of some kinds, with a path that holds `part`.

    nth 0 is every one of them.
    """

    below: Path
    nth: int = 0
    events: tuple[str, ...] = EVENTS
    part: str = ""


class Interference:
    """Calls `act` in a forked process when a place is reached."""

    def __init__(self, at: At, act: Callable[[str, str], None]) -> None:
        self._at, self._act = at, act
        self._count = 0
        self._lock = threading.Lock()
        self._inside = threading.local()

    def install(self) -> None:
        """From here on, in this process."""
        sys.addaudithook(self._hear)

    def _hear(self, event: str, args: tuple[Any, ...]) -> None:
        if event not in EVENTS or not args or getattr(self._inside, "now", False):
            return
        if event == "open" and isinstance(args[2], int) and args[2] & _WRITES:
            event = "create"
        if event not in self._at.events:
            return
        # where a name goes to, for what makes one
        name = args[1] if event in ("os.rename", "os.link", "os.symlink") else args[0]
        if not isinstance(name, str | bytes | os.PathLike):
            return
        self._inside.now = True
        try:
            path = os.path.abspath(os.fsdecode(name))
            if not path.startswith(f"{self._at.below}/") or self._at.part not in path:
                return
            with self._lock:
                self._count += 1
                mine = self._at.nth in (0, self._count)
            if mine:
                self._act(event, path)
        finally:
            self._inside.now = False


class Held:
    """A gate between two processes: the command waits in it until it is let go."""

    def __init__(self) -> None:
        self._reached, self._told = os.pipe()
        self._waiting, self._go = os.pipe()

    def __call__(self, event: str, path: str) -> None:
        """In the command: say that it is here, and wait."""
        os.write(self._told, f"{event} {path}".encode())
        os.read(self._waiting, 1)

    def wait(self, ended: Callable[[], bool], timeout_s: float = 60) -> str | None:
        """In the trial: where the command stands, or None when it ended without coming here."""
        import select
        import time

        until = time.monotonic() + timeout_s
        while time.monotonic() < until:
            if select.select([self._reached], [], [], 0.02)[0]:
                return os.read(self._reached, 1000).decode()
            if ended():
                return None
        return None

    def let_go(self) -> None:
        """In the trial: let the command go on."""
        os.write(self._go, b"x")


class Refused:
    """The call fails with an errno."""

    def __init__(self, number: int) -> None:
        self._number = number

    def __call__(self, event: str, path: str) -> None:
        raise OSError(self._number, os.strerror(self._number), path)


class Vanished:
    """The store is moved away, as when a disk is pulled or a share goes down."""

    def __init__(self, store: Path, to: Path) -> None:
        self._store, self._to = store, to

    def __call__(self, event: str, path: str) -> None:
        if self._store.exists() and not self._to.exists():
            os.rename(self._store, self._to)


class Counted:
    """Writes down each event, a line each."""

    def __init__(self, file: Path) -> None:
        self._file = file

    def __call__(self, event: str, path: str) -> None:
        with open(self._file, "a", encoding="utf-8") as log:
            log.write(f"{event} {path}\n")

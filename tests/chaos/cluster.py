"""A Dask cluster of forked processes: a scheduler, and workers that see what a trial lets them see."""

import asyncio
import contextlib
import ctypes
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

from tests.chaos.bench import Trial
from tests.chaos.outcome import SkippedError
from tests.package import use_package

_NEW_MOUNTS = 0x00020000  # CLONE_NEWNS of unshare(2)


class Cluster:
    """A scheduler, and the workers that are added to it; all are killed at the end."""

    def __init__(self, made: Trial) -> None:
        self._room = made.room
        self._pids: list[int] = []
        self.address = ""

    def __enter__(self) -> Self:
        told = self._room / "scheduler"
        self.scheduler = self._fork(lambda: _schedule(told))
        until = time.monotonic() + 30
        while not told.exists() or not told.read_text():
            if time.monotonic() > until:
                raise SkippedError("no scheduler can be started")
            time.sleep(0.02)
        self.address = told.read_text()
        return self

    def __exit__(self, *_: object) -> None:
        for pid in self._pids:
            kill(pid)

    def worker(self, *, checkout: Path | None = None, copy_of: tuple[Path, Path] | None = None) -> int:
        """Add a worker; returns its process.

        Args:
            checkout: whose code it runs.
            copy_of: (folder, copy): it sees the copy where others see the folder.
        """

        def work() -> None:
            if copy_of is not None:
                _see_instead(*copy_of)
            if checkout is not None:
                use_package(checkout)
            _work(self.address, str(self._room))

        return self._fork(work)

    def _fork(self, be: Callable[[], None]) -> int:
        pid = os.fork()
        if pid:
            self._pids.append(pid)
            return pid
        try:
            os.setpgid(0, 0)
            log = os.open(self._room / "cluster.log", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
            os.dup2(log, 1)
            os.dup2(log, 2)
            be()
        finally:
            os._exit(0)


def kill(pid: int) -> None:
    """SIGKILL to a process and what it started."""
    with contextlib.suppress(ProcessLookupError, ChildProcessError):
        os.killpg(pid, signal.SIGKILL)
        os.waitpid(pid, 0)


def _see_instead(folder: Path, copy: Path) -> None:
    if ctypes.CDLL(None).unshare(_NEW_MOUNTS) != 0:
        os._exit(1)
    subprocess.run(["mount", "--make-rprivate", "/"], check=True)
    subprocess.run(["mount", "--bind", str(copy), str(folder)], check=True)


def can_see_instead() -> bool:
    """Whether a process can be given another view of the disk."""
    return subprocess.run(["unshare", "-m", "true"], capture_output=True, check=False).returncode == 0


def _schedule(told: Path) -> None:
    from distributed import Scheduler

    async def live() -> None:
        async with Scheduler(host="127.0.0.1", port=0, dashboard=False, dashboard_address=None) as scheduler:
            told.write_text(str(scheduler.address))
            await scheduler.finished()

    asyncio.run(live())


def _work(address: str, room: str) -> None:
    from distributed import Worker

    async def live() -> None:
        options: dict[str, Any] = {"nthreads": 1, "local_directory": room, "dashboard": False}
        async with Worker(address, **options) as worker:
            await worker.finished()

    asyncio.run(live())

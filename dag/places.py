"""Where the tasks of a run are computed: threads here, processes beside, or a Dask cluster that shares the store.

The only module that imports Dask. Whatever happens to those who compute, `compute` returns or raises: no wait is
without end while nobody is there to end it.
"""

import asyncio
import contextlib
import errno
import logging
import multiprocessing
import os
import pickle
import queue
import signal
import socket
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from typing import Any, NoReturn

from lightstage.store.errors import LightstageError, RequestError, WorkError
from lightstage.store.records import BlockRecord

OnDone = Callable[[Any, BlockRecord], None]

ANSWER_S = 10.0
"""A scheduler that is there says so within this."""
PATIENCE_S = 30.0
"""So long a cluster may be without workers, or its scheduler too busy to answer."""


class LostWorkersError(WorkError):
    """Those who computed are gone; the next attempt may have others."""


@dataclass(frozen=True)
class Where:
    """Where the tasks run: threads here, local processes, or a cluster."""

    threads: int = field(default_factory=lambda: len(os.sched_getaffinity(0)))
    workers: int | None = None
    scheduler: str | None = None

    @property
    def elsewhere(self) -> bool:
        """Whether in other processes than this one."""
        return bool(self.workers or self.scheduler)


def compute(graph: Mapping[Any, Any], where: Where, on_done: OnDone) -> None:
    """Compute a graph, and hand every record over as soon as it is there.

    Raises:
        LightstageError: what a task raised.
        LostWorkersError: the workers died.
        RequestError: no scheduler answers at the address.
        WorkError: the cluster or the limits of this process do not let it be computed.
    """
    try:
        if where.scheduler is not None:
            _on_cluster(graph, where.scheduler, on_done)
        elif where.workers:
            _on_processes(graph, where.workers, on_done)
        else:
            _on_threads(graph, where.threads, on_done)
    except MemoryError as error:
        raise WorkError("the memory that this process may use is not enough (`ulimit -v` shows a limit)") from error
    except OSError as error:
        if error.errno not in (errno.EMFILE, errno.ENFILE):
            raise
        raise WorkError(
            "this process may not open as many files as it needs (`ulimit -n` shows how many)"
        ) from error


def _on_threads(graph: Mapping[Any, Any], threads: int, on_done: OnDone) -> None:
    import dask.threaded

    with _telling(on_done):
        dask.threaded.get(dict(graph), list(graph), num_workers=threads)


def _telling(on_done: OnDone) -> Any:
    from dask.callbacks import Callback

    def after(key: Any, result: Any, graph: Any, state: Any, worker: Any) -> None:
        if isinstance(result, BlockRecord):
            on_done(key, result)

    return Callback(posttask=after)


def _on_processes(graph: Mapping[Any, Any], workers: int, on_done: OnDone) -> None:
    from dask.local import get_async

    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), initializer=_begin_worker)
    try:
        with _telling(on_done):
            get_async(
                pool.submit,
                workers,
                dict(graph),
                list(graph),
                dumps=pickle.dumps,
                loads=pickle.loads,
                pack_exception=_packed,
                raise_exception=_raise,
            )
    except BrokenProcessPool as error:
        raise LostWorkersError(
            "a process of --workers died; was it killed, or is there too little memory for so many?"
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)


def _begin_worker() -> None:
    # Ctrl-C reaches every process of the terminal; the command alone says so
    signal.signal(signal.SIGINT, _stop)
    threading.Thread(target=_end_with_command, daemon=True).start()


def _stop(*_: object) -> NoReturn:
    raise SystemExit


def _end_with_command() -> None:
    """Who waits for work from a command that was killed would wait for ever."""
    command = multiprocessing.parent_process()
    if command is not None:
        command.join()
        os._exit(1)


def _packed(error: Exception, dumps: Callable[[Any], bytes]) -> bytes:
    error.add_note(traceback.format_exc())  # for --debug: the traceback itself cannot travel
    try:
        return dumps((error, None))
    except (pickle.PicklingError, TypeError, AttributeError):
        return dumps((WorkError(f"a worker failed with {type(error).__name__}: {error}"), None))


def _raise(error: Exception, _: object = None) -> NoReturn:
    raise error


def _on_cluster(graph: Mapping[Any, Any], address: str, on_done: OnDone) -> None:
    finished: queue.SimpleQueue[tuple[Any, Any]] = queue.SimpleQueue()
    with _client(address) as client:
        cluster = _Cluster(client, address)
        cluster.wait_for_workers()
        futures = client.get(dict(graph), list(graph), sync=False)
        for key, future in zip(graph, futures, strict=True):
            future.add_done_callback(lambda done, key=key: finished.put((key, done)))
        left = len(futures)
        while left:
            try:
                key, future = finished.get(timeout=1)
            except queue.Empty:
                cluster.check()
                continue
            record = cluster.result(future)
            if record is None:
                finished.put((key, future))  # the worker that had it is gone, and another makes it again
            else:
                on_done(key, record)
                left -= 1


class _Cluster:
    """What a run must know of a cluster, so that it never waits for nobody."""

    def __init__(self, client: Any, address: str) -> None:
        self._client, self._address = client, address
        self._seen = time.monotonic()

    def _workers(self) -> int:
        if self._client.status != "running":
            self._gone()
        try:
            return len(self._client.sync(self._client.scheduler.ncores, workers=None, callback_timeout=PATIENCE_S))
        except (OSError, TimeoutError):
            self._gone()

    def _gone(self) -> NoReturn:
        raise WorkError(
            f"the scheduler {self._address} no longer answers; what was finished is kept, and the next run goes on "
            "from there"
        ) from None

    def wait_for_workers(self) -> None:
        """Return when there is a worker."""
        while not self._workers():
            self.check()
            time.sleep(0.2)

    def check(self) -> None:
        """Raise when the scheduler is gone, or there has been no worker for long."""
        if self._workers():
            self._seen = time.monotonic()
        elif time.monotonic() - self._seen > PATIENCE_S:
            raise WorkError(
                f"the scheduler {self._address} has had 0 workers connected for {PATIENCE_S:.0f} s; start some "
                "that see the store (`dask worker ADDRESS`), and run again"
            )

    def result(self, future: Any) -> Any:
        """What a task gave, or None when it has to be waited for again."""
        from distributed.scheduler import KilledWorker

        if future.status == "cancelled":
            self._gone()
        if future.status == "error":
            error = future.exception(timeout=ANSWER_S)
            if isinstance(error, KilledWorker):
                raise LostWorkersError(
                    f"workers of {self._address} died one after the other over one task"
                ) from error
            if isinstance(error, LightstageError):
                raise error
            raise WorkError(f"a worker of {self._address} failed with {type(error).__name__}: {error}") from error
        try:
            return future.result(timeout=ANSWER_S)
        except TimeoutError:
            self.check()
            return None


@contextlib.contextmanager
def _client(address: str) -> Iterator[Any]:
    with _silence():
        import distributed

        try:
            asyncio.run(asyncio.wait_for(_knock(address), ANSWER_S))
            client = distributed.Client(address, timeout=ANSWER_S, set_as_default=False)
        except _NO_SCHEDULER as error:
            reason = " ".join(str(error).split()) or f"not within {ANSWER_S:.0f} s"
            if isinstance(error, MemoryError):
                reason = "somebody else does, in another language"
            raise RequestError(f"--scheduler {address}: no Dask scheduler answers there ({reason})") from None
        try:
            yield client
        finally:
            client.close(timeout=ANSWER_S)


_NO_SCHEDULER = (OSError, TimeoutError, ValueError, TypeError, RuntimeError, MemoryError, EOFError)
"""What comes of an address without a scheduler; MemoryError when others' words are taken for a message's length."""


async def _knock(address: str) -> None:
    """Ask who is there, and raise when it is no scheduler: Dask's client would ask again and again, or for ever."""
    from distributed.comm import connect, get_address_host_port
    from distributed.security import Security

    host, port = get_address_host_port(address, strict=False)
    socket.create_connection((host, port), timeout=ANSWER_S).close()
    comm = await connect(address, timeout=ANSWER_S, **Security().get_connection_args("client"))
    try:
        await comm.write({"op": "identity", "reply": True})
        answer = await comm.read()
    finally:
        comm.abort()
    if not isinstance(answer, dict) or answer.get("type") != "Scheduler":
        raise ValueError("but another program of Dask does")


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """What distributed and asyncio log of a lost connection is told by our own sentence."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)

"""Whoever computes: no wait is without end, and what went wrong is one sentence."""

import contextlib
import operator
import os
import pickle
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from lightstage.dag import places
from lightstage.dag import run as dag_run
from lightstage.dag.places import LostWorkersError, Where, compute
from lightstage.store.errors import RequestError, WorkError
from lightstage.store.importer import import_capture
from lightstage.store.root import Store
from tests.conftest import Answer
from tests.package import copy_package
from tests.scenes import sphere_capture

Lightstage = Callable[..., Answer]

CLUSTER = """
import sys
from distributed import LocalCluster

with LocalCluster(n_workers=0, processes=False, protocol="tcp", dashboard_address=":0") as cluster:
    print(cluster.scheduler_address, flush=True)
    for line in sys.stdin:
        cluster.scale(int(line))
        cluster.wait_for_workers(int(line))
        print("there", flush=True)
"""


@contextlib.contextmanager
def running_cluster(folder: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A scheduler without workers, in a process of its own; it takes, a line each, how many there shall be."""
    process = subprocess.Popen(
        [sys.executable, "-c", CLUSTER],
        cwd=folder,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    try:
        yield process, process.stdout.readline().strip()
    finally:
        process.kill()
        process.communicate()


def scale(process: subprocess.Popen[str], workers: int) -> None:
    assert process.stdin is not None
    assert process.stdout is not None
    print(workers, file=process.stdin, flush=True)
    assert process.stdout.readline() == "there\n"


def no_one(key: Any, record: Any) -> None:
    pass


def one(function: Callable[..., Any], *arguments: Any) -> Mapping[Any, Any]:
    return {("task", 0): (function, *arguments)}


@pytest.mark.slow
def test_a_cluster_that_lacks_or_loses_what_it_needs_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(places, "PATIENCE_S", 1.0)
    with running_cluster(tmp_path) as (process, address):
        where = Where(scheduler=address)
        with pytest.raises(WorkError, match="has had 0 workers connected for 1 s; start some"):
            compute(one(abs, -3), where, no_one)
        monkeypatch.setattr(places, "PATIENCE_S", 60.0)
        scale(process, 1)
        told = []
        compute(one(abs, -3), where, lambda key, record: told.append((key, record)))
        assert told == [(("task", 0), 3)]
        with pytest.raises(WorkError, match=r"a worker of tcp://.* failed with TypeError: bad operand"):
            compute(one(operator.neg, "x"), where, no_one)
        with pytest.raises(RequestError, match=r"no Dask scheduler answers there.*TLS"):
            compute(one(abs, -3), Where(scheduler=address.replace("tcp", "tls")), no_one)
        threading.Timer(1, process.kill).start()
        with pytest.raises(WorkError, match="no longer answers; what was finished is kept"):
            compute(one(time.sleep, 100), where, no_one)


@pytest.mark.slow
def test_a_living_worker_whose_module_was_edited_refuses(tmp_path: Path) -> None:
    """The worker has computed `align` with a module that is edited then, and a new command would do it again."""
    code = tmp_path / "code"
    copy_package(code)
    pipeline = code / "pipeline.yaml"
    pipeline.write_text(
        "stages:\n  capture: {uses: capture}\n  register: {uses: register, from: capture}\n"
        "  split: {uses: split, from: register}\n  stack: {uses: stack, from: split}\n"
        "  align: {uses: align, from: stack}\n  normals: {uses: normals, from: align}\n"
    )
    import_capture(sphere_capture(tmp_path / "ball", size=16), Store(tmp_path / "store"))
    with running_cluster(code) as (process, address):
        scale(process, 1)

        def run(node: str) -> subprocess.CompletedProcess[str]:
            words = ["--store", str(tmp_path / "store"), "run", node, "--session", "ball", "--scheduler", address]
            command = [sys.executable, "-m", "lightstage.cli.main", *words]
            return subprocess.run(command, cwd=code, capture_output=True, text=True, timeout=200)

        first = run("align")
        assert first.returncode == 0, first.stderr
        shared = code / "lightstage" / "kernels" / "pictures" / "picture_sets.py"
        shared.write_text(shared.read_text() + "\n_EDITED = 1\n")
        second = run("normals")
    assert second.returncode == 1
    assert "has other code or libraries for the stage align than the command had; restart" in second.stderr
    assert len(second.stderr.splitlines()) == 1


@pytest.fixture
def strangers() -> Iterator[Callable[[bytes], str]]:
    """Addresses where somebody who is no scheduler listens, and says this and no more."""
    with contextlib.ExitStack() as sockets:

        def stranger(words: bytes) -> str:
            listening = sockets.enter_context(socket.create_server(("127.0.0.1", 0)))

            def listen() -> None:
                with contextlib.suppress(OSError):
                    while True:
                        caller = sockets.enter_context(listening.accept()[0])
                        caller.sendall(words)

            threading.Thread(target=listen, daemon=True).start()
            return f"tcp://127.0.0.1:{listening.getsockname()[1]}"

        yield stranger


def test_an_address_without_a_scheduler_is_a_wrong_request(
    strangers: Callable[[bytes], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(places, "ANSWER_S", 0.5)
    for address, words in (
        (strangers(b""), "not within"),
        (strangers(b"HTTP/1.0 400 Bad Request\r\n\r\n" * 9), "somebody else does, in another language"),
        ("tcp://127.0.0.1:1", "refused"),
        ("tls://127.0.0.1:1", "refused"),
        ("nonsense", "missing port"),
        ("foo://127.0.0.1:1", "unknown address scheme"),
    ):
        with pytest.raises(RequestError, match=f"no Dask scheduler answers there.*{words}"):
            compute(one(abs, -3), Where(scheduler=address), no_one)


def test_an_empty_address_is_a_wrong_request(lightstage: Lightstage, sphere: Path) -> None:
    lightstage("import", sphere)
    done = lightstage("run", "--session", "ball", "--scheduler", "")
    assert done.code == 2
    assert "--scheduler is empty" in done.err


@pytest.mark.slow
def test_processes_that_die_or_fail_are_told() -> None:
    with pytest.raises(LostWorkersError, match="a process of --workers died"):
        compute(one(os._exit, 3), Where(workers=1), no_one)
    with pytest.raises(TypeError, match="bad operand"):
        compute(one(operator.neg, "x"), Where(workers=1), no_one)


def test_what_cannot_travel_is_told_by_its_words() -> None:
    class LocalError(Exception):
        pass

    error, _ = pickle.loads(places._packed(LocalError("of here"), pickle.dumps))
    assert isinstance(error, WorkError)
    assert str(error) == "a worker failed with LocalError: of here"


@pytest.mark.parametrize(
    ("error", "words"),
    [(MemoryError(), "ulimit -v"), (OSError(24, "Too many open files"), "ulimit -n")],
)
def test_a_limit_of_the_process_is_told(error: Exception, words: str) -> None:
    def fail() -> None:
        raise error

    with pytest.raises(WorkError, match=words):
        compute(one(fail), Where(threads=1), no_one)


def test_a_run_goes_on_without_its_workers_while_that_gets_it_further(
    lightstage: Lightstage, sphere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lightstage("import", sphere)
    rounds = []

    def dying(graph: Mapping[Any, Any], where: Where, on_done: Callable[[Any, Any], None]) -> None:
        rounds.append(len(graph))
        if len(rounds) == 1:
            part = {key: task for key, task in graph.items() if key[0].startswith("register-")}
            compute(part, where, on_done)
        raise LostWorkersError("the workers died")

    monkeypatch.setattr(dag_run, "compute", dying)
    done = lightstage("run", "stack", "--session", "ball")
    assert done.code == 1
    assert rounds == [21, 14]
    assert done.err.splitlines() == [
        "note: the workers died; what was finished is kept, and the rest begins anew",
        "lightstage: the workers died",
    ]


def test_a_run_whose_chunks_never_come_stops(
    lightstage: Lightstage, sphere: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Somebody says that the blocks are there, and the chunks are not."""
    lightstage("import", sphere)
    rounds = []

    def elsewhere(graph: Mapping[Any, Any], where: Where, on_done: Callable[[Any, Any], None]) -> None:
        rounds.append(len(graph))
        assert len(rounds) < 9, "without end"
        compute(graph, where, on_done)
        shutil.rmtree(tmp_path / "store" / "cache" / "blobs")

    monkeypatch.setattr(dag_run, "compute", elsewhere)
    done = lightstage("run", "register", "--session", "ball")
    assert done.code == 1
    assert len(rounds) <= 2
    assert len(done.err.splitlines()[-1:]) == 1

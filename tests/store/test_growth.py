"""What the store does for a chunk and a record does not grow with what was put before; counted, not timed."""

import os
import sys
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

from lightstage.store import chunks as store_chunks
from lightstage.store import files
from lightstage.store.chunks import ChunkRef
from lightstage.store.errors import DamagedChunkError, WorkError
from lightstage.store.grid import ArrayTemplate
from lightstage.store.records import BlockRecord
from lightstage.store.results import ResultName, publish
from lightstage.store.root import Store

FEW, MANY = 40, 400
SLACK = 1.1
"""One of MANY may cost so much more than one of FEW: some folders are made once, and threads begin and end."""
SHAPE = (1, 4, 6)


def picture(i: int) -> np.ndarray:
    return np.full(SHAPE, i, np.uint16)


def put(store: Store, first: int, count: int) -> list[ChunkRef]:
    """Chunks and a record for each."""
    refs = []
    for i in range(first, first + count):
        refs.append(store.chunks.put(picture(i)))
        store.records.put_block(BlockRecord(f"{i:032x}", {"a": (refs[-1],)}))
    return refs


def publish_all(store: Store, refs: list[ChunkRef]) -> Path:
    template = ArrayTemplate(("frame", "y", "x"), (len(refs), *SHAPE[1:]), SHAPE, "uint16")
    return publish(
        ResultName("s", "n", "recipe", f"{len(refs)}"),
        store,
        arrays={"a": template},
        coordinates={},
        attrs={},
        chunks={"a": {(i, 0, 0): ref for i, ref in enumerate(refs)}},
        provenance={},
    )


def lines_executed(work: Callable[[], Any]) -> int:
    """Lines of the store's own modules, each turn of a loop and of a comprehension counted."""
    folder, count = str(Path(files.__file__).parent), 0

    def trace(frame: FrameType, event: str, _: Any) -> Any:
        nonlocal count
        if not frame.f_code.co_filename.startswith(folder):
            return None
        count += event == "line"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        work()
    finally:
        sys.settrace(before)
    return count


@pytest.mark.parametrize("bound", ["by number", "by bytes"])
def test_a_put_costs_the_same_after_many(store: Store, bound: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if bound == "by bytes":
        monkeypatch.setattr(store_chunks, "RECENT_BYTES", 30 * picture(0).nbytes)
    put(store, 10_000, 1)
    first = lines_executed(lambda: put(store, 0, FEW))
    put(store, FEW, MANY)
    later = lines_executed(lambda: put(store, FEW + MANY, FEW))
    assert later <= SLACK * first


def test_publishing_costs_the_same_for_each_of_many(store: Store) -> None:
    refs = put(store, 0, MANY)
    few = lines_executed(lambda: publish_all(store, refs[:FEW]))
    many = lines_executed(lambda: publish_all(store, refs))
    start = lines_executed(lambda: publish_all(store, refs[:1]))
    assert (many - start) / MANY <= SLACK * (few - start) / FEW


def test_what_a_process_remembers_is_bounded(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store_chunks, "RECENT_CHUNKS", 20)
    refs = [store.chunks.put(picture(i)) for i in range(50)]
    for i, ref in enumerate(refs):
        store.chunks.path(ref.blob).unlink()
        if i < 30:
            with pytest.raises(DamagedChunkError, match="cannot be read"):
                store.chunks.get(ref, dtype="uint16", shape=SHAPE)
        else:
            assert store.chunks.get(ref, dtype="uint16", shape=SHAPE).max() == i


def test_every_file_is_flushed_once_and_all_before_a_result_refers_to_them(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    flushed: Counter[int] = Counter()
    real, lock = os.fsync, threading.Lock()

    def fsync(file: int) -> None:
        real(file)
        with lock:
            flushed[os.fstat(file).st_ino] += 1

    monkeypatch.setattr(os, "fsync", fsync)
    refs = put(store, 0, MANY)
    store.scratch.flush()
    wanted = {store.chunks.path(ref.blob).stat().st_ino for ref in refs}
    wanted |= {path.stat().st_ino for path in store.records.files("blocks")}
    assert len(wanted) == 2 * MANY
    # other files may be those of another test's store
    assert {file: flushed[file] for file in wanted} == dict.fromkeys(wanted, 1)
    refs += put(store, MANY, 1)
    group = publish_all(store, refs)
    assert flushed[(group / f"a/c.{MANY}.0.0").stat().st_ino] == 1


def test_the_barrier_waits_for_all_threads(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two who wait at once: neither comes back while a file of its own is still in another's hands."""
    done: set[int] = set()
    slow, real = threading.Event(), os.fsync

    def fsync(file: int) -> None:
        slow.wait(0.002)
        real(file)
        done.add(os.fstat(file).st_ino)

    monkeypatch.setattr(os, "fsync", fsync)
    late: list[str] = []

    def work(part: int) -> None:
        for i in range(10):
            refs = [store.chunks.put(picture(1000 * part + 10 * i + k)) for k in range(5)]
            store.scratch.flush()
            late.extend(ref.blob for ref in refs if store.chunks.path(ref.blob).stat().st_ino not in done)

    threads = [threading.Thread(target=work, args=(part,)) for part in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not late


def test_a_file_that_cannot_be_flushed_is_said_once_and_the_others_are_flushed(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, refused = os.fsync, iter([True])

    def fsync(file: int) -> None:
        if next(refused, False):
            raise OSError(28, "No space left on device")
        real(file)

    monkeypatch.setattr(os, "fsync", fsync)
    put(store, 0, 3)
    with pytest.raises(WorkError, match="is full"):
        store.scratch.flush()
    store.scratch.flush()


def test_without_more_threads_the_barrier_flushes_by_itself(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    def start(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    count, real = [0], os.fsync

    def fsync(file: int) -> None:
        count[0] += 1
        real(file)

    monkeypatch.setattr(threading.Thread, "start", start)
    monkeypatch.setattr(os, "fsync", fsync)
    put(store, 0, FEW)
    store.scratch.flush()
    assert count[0] >= 2 * FEW


def test_a_performance_needs_few_inodes_a_picture(store: Store) -> None:
    """One array of a result: its chunk, the record of its block, and no folder of its own."""
    before = inodes(store.root)
    refs = put(store, 0, MANY)
    publish_all(store, refs)
    folders = 2 * 256 + 10  # that are made once
    assert inodes(store.root) - before <= 2 * MANY + folders


def inodes(folder: Path) -> int:
    return len({path.lstat().st_ino for path in folder.rglob("*")})

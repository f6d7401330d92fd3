"""Computes what is not known yet, on Dask. The only module that imports Dask.

A task gets the records of the blocks above it (digests, never arrays), makes its key, and only computes when
no record of that key exists. So a stage that ran again with equal output stops the cascade in the same run.
The same graph runs on threads, on local processes and on a `distributed` cluster that shares the store.
"""

import contextlib
import inspect
import logging
import os
import secrets
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dag.fingerprint import block_key, stage_parts
from dag.plan import NodePlan, Piece, Plan, State, look_up
from dag.publish import NodeResult, publish_results
from dag.stage import Stage, StageError
from hw.compiled import offer
from store.chunks import ChunkRef
from store.digest import digest_value
from store.errors import DamagedChunkError, RequestError, WorkError
from store.records import BlockRecord
from store.root import Store
from store.verify import verify


class Watcher(Protocol):
    """Is told how a run goes on."""

    def begin(self, totals: Mapping[str, int], frames: int) -> None:
        """Blocks to do, by node, and the session's frames that they stand for."""

    def done(self, node: str, computed: bool) -> None:
        """One block of a node is there."""

    def warn(self, text: str) -> None:
        """Something that the user should know."""


@dataclass(frozen=True)
class Where:
    """Where the tasks run: threads here, local processes, or a cluster."""

    threads: int = field(default_factory=lambda: len(os.sched_getaffinity(0)))
    workers: int | None = None
    scheduler: str | None = None


class BlockTask:
    """What a worker needs to make one block. A plain object, so that Dask looks for no graph inside."""

    __slots__ = (
        "arrays",
        "block",
        "context",
        "context_digest",
        "elsewhere",
        "node",
        "params",
        "place",
        "reads",
        "stage_key",
        "stage_module",
        "store_root",
    )

    def __init__(self, node: NodePlan, index: int, store_root: Path, place: Mapping[tuple[str, int], int]) -> None:
        block = node.blocks[index]
        self.node = node.node.name
        self.stage_module = node.node.module
        self.params = node.node.params
        self.stage_key = node.stage_key
        self.block = block.label
        self.context_digest = block.context
        self.context = node.contexts.get(block.context, {})
        self.arrays = {
            name: (
                template.dtype,
                template.chunk,
                tuple(
                    n for dim, n in zip(template.dims, template.shape, strict=True) if dim not in node.block_dims
                ),
            )
            for name, template in node.arrays.items()
        }
        self.reads = block.reads
        self.store_root = store_root
        self.elsewhere = False
        """Whether another process than the publishing one computes it."""
        self.place = place
        """(node above, its block) -> position among the records that the task is given."""


def execute(task: BlockTask, *above: BlockRecord) -> BlockRecord:
    """Make one block, or find that it is there."""
    store = _store(task.store_root)
    refs = {
        name: [[above[task.place[n, i]].outputs[array][k] for n, i, array, k in piece.chunks] for piece in pieces]
        for name, pieces in task.reads.items()
    }
    values = {
        name: [piece.key_of([ref.value for ref in of]) for piece, of in zip(task.reads[name], pieces, strict=True)]
        for name, pieces in refs.items()
    }
    key = block_key(task.stage_key, task.context_digest, values)
    known = store.records.block(key)
    if known is not None and all(store.chunks.has(ref) for ref in known.chunks()):
        return known
    began = time.perf_counter()
    offer(task.store_root)
    stage: Stage = import_module(task.stage_module).STAGE
    _check_code(task, stage)
    try:
        outputs = _call_kernel(task, stage, refs, store)
    except StageError as error:
        raise WorkError(f"{task.node}, {task.block}: {error}") from error
    written, stats, warnings = _write(task, outputs, store)
    record = BlockRecord(
        key=key,
        outputs=written,
        stats=stats,
        warnings=warnings,
        trace={"stage": task.stage_key, "context": task.context_digest, "reads": values},
        seconds=time.perf_counter() - began,
        reused=False,
    )
    if task.elsewhere:
        store.chunks.flush()  # the process that publishes cannot wait for this one's disk
    standing, same = store.records.put_block(record)
    if not same:
        if all(store.chunks.has(ref) for ref in standing.chunks()):
            note = {"not_deterministic": 1.0}
            return replace(standing, stats={**standing.stats, **note}, reused=False)
        store.records.renew_block(record)
    elif known is not None:
        store.records.renew_block(record)  # the same values, whose chunks had been lost
    return record


_checked: set[str] = set()


def _check_code(task: BlockTask, stage: Stage) -> None:
    """Refuse when this process would compute something else than the one that made the key."""
    if task.stage_key not in _checked:
        if digest_value(stage_parts(stage, task.stage_module, task.params)) != task.stage_key:
            raise WorkError(
                f"a worker has other code or libraries for the stage {stage.name} than this command; "
                "restart the cluster, and give it the same environment"
            )
        _checked.add(task.stage_key)


def _call_kernel(
    task: BlockTask, stage: Stage, refs: Mapping[str, list[list[ChunkRef]]], store: Store
) -> Mapping[str, Any]:
    assert stage.kernel is not None
    inputs: dict[str, Any] = {}
    for name, pieces in task.reads.items():
        loader = Pieces(pieces, refs[name], store)
        inputs[name] = loader[0] if stage.inputs[name].how == "each" else loader
    prepared = prepare(stage, task.stage_module, task.context, task.context_digest, task.params)
    accepted = inspect.signature(stage.kernel).parameters
    chosen = {name: value for name, value in task.params if name in accepted and name not in prepared}
    return stage.kernel(**inputs, **prepared, **chosen)


class Pieces(Sequence[NDArray[Any]]):
    """The arrays of a group, each read from the store when it is asked for."""

    def __init__(self, pieces: Sequence[Piece], refs: Sequence[Sequence[ChunkRef]], store: Store) -> None:
        self._pieces, self._refs, self._store = pieces, refs, store

    def __len__(self) -> int:
        return len(self._pieces)

    def __getitem__(self, index: Any) -> Any:
        piece, refs = self._pieces[index], self._refs[index]
        parts = [self._store.chunks.get(ref, dtype=piece.dtype, shape=piece.chunk_shape) for ref in refs]
        whole = parts[0].reshape(piece.shape) if len(parts) == 1 else np.stack(parts).reshape(piece.shape)
        if piece.scale is not None:
            known = whole != piece.fill
            whole = np.where(known, whole * np.float32(piece.scale), np.float32(np.nan))
        return whole


def _write(
    task: BlockTask, outputs: Mapping[str, Any], store: Store
) -> tuple[dict[str, tuple[ChunkRef, ...]], dict[str, float], tuple[str, ...]]:
    written: dict[str, tuple[ChunkRef, ...]] = {}
    for name, (dtype, chunk, shape) in task.arrays.items():
        array = np.asarray(outputs[name])
        if array.dtype != np.dtype(dtype) or array.shape != shape:
            raise WorkError(
                f"{task.node}, {task.block}: the kernel gave '{name}' as {array.dtype}{array.shape}; declared is "
                f"{dtype}{shape}"
            )
        written[name] = tuple(store.chunks.put(part) for part in array.reshape(-1, *chunk))
    stats = {name: float(value) for name, value in outputs.get("stats", {}).items()}
    return written, stats, tuple(outputs.get("warnings", ()))


_MOST_PREPARED = 8  # a camera pair's dark, gain and map are 32 MB at 1624 x 1236
_prepared: dict[tuple[str, str, str], Mapping[str, Any]] = {}
_preparing = threading.Lock()


def prepare(stage: Stage, module: str, context: Mapping[str, Any], digest: str, params: Any) -> Mapping[str, Any]:
    """The context as the kernel gets it; made once per process for each stage, context and parameters."""
    _single_threaded_libraries()
    if stage.prepare is None:
        return context
    key = (module, digest, digest_value(params.model_dump(mode="json")))
    with _preparing:
        if key not in _prepared:
            while len(_prepared) >= _MOST_PREPARED:
                _prepared.pop(next(iter(_prepared)))
            accepted = inspect.signature(stage.prepare).parameters
            chosen = {name: value for name, value in params if name in accepted and name not in context}
            _prepared[key] = stage.prepare(**{**context, **chosen})
        return _prepared[key]


_stores: dict[Path, Store] = {}


def _store(root: Path) -> Store:
    if root not in _stores:
        _stores[root] = Store(root)
    return _stores[root]


_limited: list[Any] = []


def _single_threaded_libraries() -> None:
    """Dask has the threads: those of OpenCV and BLAS would multiply with them, and decide results' last bits."""
    import cv2
    from threadpoolctl import threadpool_limits

    if cv2.getNumThreads() != 1:
        cv2.setNumThreads(1)
    if not _limited:
        # a sum over two threads ends in other bits than over one, and the environment may ask for two
        _limited.append(threadpool_limits(1))


def run(
    plan: Plan,
    store: Store,
    watcher: Watcher,
    *,
    frames: tuple[int, int] | None = None,
    where: Where,
    versions: Mapping[str, str],
) -> tuple[State, dict[str, NodeResult]]:
    """Compute every selected block of a plan that is not known, and publish the results.

    When a damaged chunk is met, the whole store is verified, what is damaged is quarantined, and the run goes on.

    Raises:
        WorkError: a kernel refused, the disk is full, a raw or a calibration picture is damaged.
    """
    _stores[store.root] = store
    computed: set[str] = set()
    while True:
        state = look_up(plan, store, frames=frames)
        try:
            _compute(state, store, watcher, where, computed)
            return state, publish_results(state, store, versions, computed)
        except DamagedChunkError as damage:
            found = verify(store).damaged
            for one in found:
                watcher.warn(f"{one.path} was damaged: {one.belongs_to}; {one.remedy}")
            lasting = [one for one in found if not one.recomputable]
            if lasting or not (found or not store.chunks.path(damage.blob).exists()):
                remedy = lasting[0].remedy if lasting else "check the disk"
                raise WorkError(f"{damage}; {remedy}") from None


def _compute(state: State, store: Store, watcher: Watcher, where: Where, computed: set[str]) -> None:
    missing = {name: node.missing() for name, node in state.nodes.items()}
    missing = {name: blocks for name, blocks in missing.items() if blocks}
    first, last = state.frames or (0, state.plan.session.sizes["frame"])
    totals = {name: sum(node.selected) for name, node in state.nodes.items() if not node.plan.is_source}
    watcher.begin(totals, last - first)
    for name, node in state.nodes.items():
        if not node.plan.is_source:
            for i, record in enumerate(node.records):
                if record is not None and node.selected[i]:
                    watcher.done(name, computed=False)
    if not missing:
        return
    _check_contexts(state, missing)
    # two commands on one cluster must not take each other's tasks for their own
    token = secrets.token_hex(8)
    graph: dict[Any, Any] = {}
    for name, blocks in missing.items():
        for i in blocks:
            graph[f"{name}-{token}", i] = _as_task(state, name, i, store, token)
    on_done = _Collector(state, watcher, token, computed)
    if where.scheduler or where.workers:
        for made in graph.values():
            made[1].elsewhere = True
        _run_distributed(graph, where, on_done)
    else:
        _run_threads(graph, where.threads, on_done)


def _as_task(state: State, name: str, index: int, store: Store, token: str) -> tuple[Any, ...]:
    node = state.nodes[name].plan
    above: dict[tuple[str, int], int] = {}
    for pieces in node.blocks[index].reads.values():
        for piece in pieces:
            for upper, i, _, _ in piece.chunks:
                above.setdefault((upper, i), len(above))
    arguments = []
    for upper, i in above:
        record = state.nodes[upper].records[i]
        arguments.append((f"{upper}-{token}", i) if record is None else _Known(record))
    return (_execute_known, BlockTask(node, index, store.root, above), *arguments)


class _Known:
    """A record in an argument; wrapped, so that Dask looks for no graph inside."""

    __slots__ = ("record",)

    def __init__(self, record: BlockRecord) -> None:
        self.record = replace(record, trace={})


def _execute_known(task: BlockTask, *above: "BlockRecord | _Known") -> BlockRecord:
    return execute(task, *(item.record if isinstance(item, _Known) else item for item in above))


def _check_contexts(state: State, missing: Mapping[str, Sequence[int]]) -> None:
    """Prepare every context that is needed before anything is written, so that bad calibration is refused first."""
    problems = []
    for name, blocks in missing.items():
        node = state.nodes[name].plan
        stage = node.node.stage
        for digest in dict.fromkeys(node.blocks[i].context for i in blocks):
            if stage.context is None:
                continue
            try:
                prepare(stage, node.node.module, node.contexts[digest], digest, node.node.params)
            except StageError as error:
                problems.append(f"session '{state.plan.session.name}', {name}: {error}")
    if problems:
        raise RequestError("\n".join(dict.fromkeys(problems)))


class _Collector:
    """Takes in finished blocks."""

    def __init__(self, state: State, watcher: Watcher, token: str, computed: set[str]) -> None:
        self._state, self._watcher, self._suffix, self._computed = state, watcher, f"-{token}", computed

    def __call__(self, key: tuple[str, int], record: BlockRecord) -> None:
        name, index = key[0].removesuffix(self._suffix), key[1]
        record = replace(record, trace={})
        if not record.reused:
            self._computed.add(record.key)
        if "not_deterministic" in record.stats:
            node = self._state.nodes[name].plan
            self._watcher.warn(
                f"{name}, {node.blocks[index].label}: computed again, it came out different; the first result "
                "stays. The kernel is not deterministic, or this machine computes otherwise than the one before"
            )
            record = replace(record, stats={k: v for k, v in record.stats.items() if k != "not_deterministic"})
        self._state.nodes[name].records[index] = record
        self._watcher.done(name, computed=not record.reused)


def _run_threads(graph: Mapping[Any, Any], threads: int, on_done: Callable[[Any, BlockRecord], None]) -> None:
    import dask.threaded
    from dask.callbacks import Callback

    def after(key: Any, result: Any, graph: Any, state: Any, worker: Any) -> None:
        if isinstance(result, BlockRecord):
            on_done(key, result)

    with Callback(posttask=after):
        dask.threaded.get(dict(graph), list(graph), num_workers=threads)


def _run_distributed(graph: Mapping[Any, Any], where: Where, on_done: Callable[[Any, BlockRecord], None]) -> None:
    from distributed import as_completed

    with _client(where) as client:
        futures = client.get(dict(graph), list(graph), sync=False)
        waiting = {future.key: key for key, future in zip(graph, futures, strict=True)}
        for future, record in as_completed(futures, with_results=True):
            on_done(waiting[future.key], record)


@contextlib.contextmanager
def _client(where: Where) -> Iterator[Any]:
    import dask
    from distributed import Client, LocalCluster

    if where.scheduler:
        try:
            client = Client(where.scheduler, timeout="10s")
        except (OSError, TimeoutError, ValueError) as error:
            raise RequestError(
                f"--scheduler {where.scheduler}: no Dask scheduler answers there ({error})"
            ) from None
        with client:
            yield client
        return
    quiet = {"distributed.worker.memory.target": False, "distributed.worker.memory.spill": False}
    with (
        dask.config.set(quiet),
        LocalCluster(
            n_workers=where.workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client

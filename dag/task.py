"""One block, wherever it is computed: its inputs, the kernel, its record.

A task gets the records of the blocks above it (digests, never arrays), makes its key, and only computes when
no record of that key exists. So a stage that ran again with equal output stops the cascade in the same run.

The process that computes may be another than the one that planned, on another host, started long before. It
refuses when it has other code, when numba's compiler is turned off, or when what it sees in the store's place is
another store or none.
"""

import inspect
import platform
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.compiled import offer
from lightstage.dag.fingerprint import block_key, stage_key
from lightstage.dag.plan import NodePlan, Piece
from lightstage.dag.sources import engine, generation
from lightstage.dag.stage import Name, Stage, function, refusal
from lightstage.store.chunks import ChunkRef
from lightstage.store.digest import digest_value
from lightstage.store.errors import WorkError
from lightstage.store.records import BlockRecord
from lightstage.store.root import Store


class BlockTask:
    """What a worker needs to make one block. A plain object, so that Dask looks for no graph inside."""

    __slots__ = (
        "arrays",
        "block",
        "context",
        "context_digest",
        "elsewhere",
        "engine",
        "node",
        "params",
        "place",
        "proof",
        "reads",
        "stage_key",
        "stage_module",
        "store_root",
    )

    def __init__(
        self,
        node: NodePlan,
        index: int,
        store: Store,
        proof: Path,
        place: Mapping[tuple[str, int], int],
        *,
        elsewhere: bool,
    ) -> None:
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
                "scale_factor" in template.attrs,
            )
            for name, template in node.arrays.items()
        }
        self.reads = block.reads
        self.store_root = store.root
        self.proof = proof
        """A file that this run has laid into the store."""
        self.engine = engine()
        self.elsewhere = elsewhere
        """Whether another process than the publishing one computes it."""
        self.place = place
        """(node above, its block) -> position among the records that the task is given."""


def execute(task: BlockTask, *above: BlockRecord) -> BlockRecord:
    """Make one block, or find that it is there.

    Raises:
        WorkError: the kernel refuses, or this process is not fit to compute for the one that planned.
    """
    offer(task.store_root)
    stage = _fit_for(task)
    store = _store(task)
    refs = {
        name: [[above[task.place[n, i]].outputs[array][k] for n, i, array, k in piece.chunks] for piece in pieces]
        for name, pieces in task.reads.items()
    }
    values = {
        name: [
            piece.key_of([ref.value for ref in chunks])
            for piece, chunks in zip(task.reads[name], pieces, strict=True)
        ]
        for name, pieces in refs.items()
    }
    key = block_key(task.stage_key, task.context_digest, values)
    known = store.records.block(key)
    if known is not None and all(store.chunks.has(ref) for ref in known.chunks()):
        return known
    began = time.perf_counter()
    try:
        outputs = _call_kernel(task, stage, refs, store)
    except Exception as error:
        sentence = refusal(error)
        if sentence is None:
            raise
        raise WorkError(f"{task.node}, {task.block}: {sentence}") from error
    _fit_for(task)  # a kernel may import more of our code as it goes
    _store(task)
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
        store.scratch.flush()  # the process that publishes cannot wait for this one's disk
    standing, same = store.records.put_block(record)
    if not same:
        if all(store.chunks.has(ref) for ref in standing.chunks()):
            rounded = _differ_by_rounding(task, standing, record, store)
            return replace(standing, contradicted=not rounded, reused=False)
        store.records.renew_block(record)
    elif known is not None:
        store.records.renew_block(record)  # the same values, whose chunks had been lost
    return record


_fit: set[tuple[str, str, int]] = set()


def _fit_for(task: BlockTask) -> Stage:
    """The task's stage, as this process has it.

    Raises:
        WorkError: it would compute something else than the process that made the key.
    """
    stage: Stage = import_module(task.stage_module).STAGE
    identity = (task.stage_key, task.engine, generation())
    if identity not in _fit:
        process = _process_name(task)
        remedy = "restart the cluster, and give it the same environment" if task.elsewhere else "run again"
        if engine() != task.engine:
            raise WorkError(f"{process} has another engine (dag/ or store/) than the command had; {remedy}")
        if stage_key(stage, task.stage_module, task.params) != task.stage_key:
            raise WorkError(
                f"{process} has other code or libraries for the stage {stage.name} than the command had; {remedy}"
            )
        _fit.add(identity)
    if "numba" in sys.modules:
        import numba  # which waits, should another thread be about to load it

        if not numba.config.DISABLE_JIT:
            return stage
        raise WorkError(
            f"{_process_name(task)} has numba's compiler turned off (NUMBA_DISABLE_JIT, or .numba_config.yaml), "
            "which gives other numbers under the same keys; turn it on"
        )
    return stage


def _process_name(task: BlockTask) -> str:
    return f"a worker on {platform.node()}" if task.elsewhere else "this process"


def _call_kernel(
    task: BlockTask, stage: Stage, refs: Mapping[str, list[list[ChunkRef]]], store: Store
) -> Mapping[str, Any]:
    assert stage.kernel is not None
    inputs: dict[str, Any] = {}
    for name, pieces in task.reads.items():
        each = stage.inputs[name].how == "each"
        inputs[name] = read_piece(pieces[0], refs[name][0], store) if each else Pieces(pieces, refs[name], store)
    prepared = prepare(stage, task.stage_module, task.context, task.context_digest, task.params)
    kernel = _loaded(stage.kernel)
    accepted = inspect.signature(kernel).parameters
    chosen = {name: value for name, value in task.params if name in accepted and name not in prepared}
    outputs: Mapping[str, Any] = kernel(**inputs, **prepared, **chosen)
    return outputs


_loading = threading.Lock()


def _loaded(name: str) -> Callable[..., Any]:
    """A named function. One thread at a time: two that import the same library from two ends see it half made."""
    with _loading:
        return function(name)


class Pieces(Mapping[Name, NDArray[Any]]):
    """The arrays of a group by name, each read from the store when it is asked for."""

    def __init__(self, pieces: Sequence[Piece], refs: Sequence[Sequence[ChunkRef]], store: Store) -> None:
        self._pieces = {piece.name: (piece, chunks) for piece, chunks in zip(pieces, refs, strict=True)}
        self._store = store

    def __len__(self) -> int:
        return len(self._pieces)

    def __iter__(self) -> Iterator[Name]:
        return iter(self._pieces)

    def __getitem__(self, name: Name) -> NDArray[Any]:
        return read_piece(*self._pieces[name], self._store)


def read_piece(piece: Piece, refs: Sequence[ChunkRef], store: Store) -> NDArray[Any]:
    """The array that a kernel gets."""
    parts = [store.chunks.get(ref, dtype=piece.dtype, shape=piece.chunk_shape) for ref in refs]
    whole = parts[0].reshape(piece.shape) if len(parts) == 1 else np.stack(parts).reshape(piece.shape)
    if piece.scale is not None:
        known = whole != piece.fill
        whole = np.where(known, whole * np.float32(piece.scale), np.float32(np.nan))
    return whole


def _write(
    task: BlockTask, outputs: Mapping[str, Any], store: Store
) -> tuple[dict[str, tuple[ChunkRef, ...]], dict[str, float], tuple[str, ...]]:
    written: dict[str, tuple[ChunkRef, ...]] = {}
    for name, (dtype, chunk, shape, _) in task.arrays.items():
        array = np.asarray(outputs[name])
        if array.dtype != np.dtype(dtype) or array.shape != shape:
            raise WorkError(
                f"{task.node}, {task.block}: the kernel gave '{name}' as {array.dtype}{array.shape}; declared is "
                f"{dtype}{shape}"
            )
        written[name] = tuple(store.chunks.put(part) for part in array.reshape(-1, *chunk))
    # a figure that a block does not tell is NaN to the kernel, and not said of the result
    figures = outputs.get("stats", {}).items()
    stats = {name: float(value) for name, value in figures if np.isfinite(value)}
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
            preparation = _loaded(stage.prepare)
            accepted = inspect.signature(preparation).parameters
            chosen = {name: value for name, value in params if name in accepted and name not in context}
            _prepared[key] = preparation(**{**context, **chosen})
        return _prepared[key]


_stores: dict[Path, Store] = {}


def _store(task: BlockTask) -> Store:
    check_store(task.store_root, task.proof, worker=_process_name(task) if task.elsewhere else None)
    if task.store_root not in _stores:
        _stores[task.store_root] = Store(task.store_root, create=False)
    return _stores[task.store_root]


def check_store(root: Path, proof: Path, *, worker: str | None = None) -> None:
    """Raise WorkError unless a folder is the store that the run means: a copy in its place lacks the run's file."""
    if (root / proof).is_file():
        return
    occupant = "another store, a copy perhaps," if (root / "store.json").is_file() else "no store"
    if worker is not None:
        raise WorkError(f"{worker} sees {occupant} at {root}; let it see there what this command sees")
    raise WorkError(f"there is {occupant} at {root} now: it was moved, or its disk is gone; nothing was lost")


def lend(store: Store) -> None:
    """Let tasks of this process use a store that is open already, and what it remembers of its chunks."""
    _stores[store.root] = store


_limited: list[Any] = []


def _single_threaded_libraries() -> None:
    """Dask has the threads: those of OpenCV and BLAS would multiply with them, and decide results' last bits."""
    with _loading:
        import cv2
        from threadpoolctl import threadpool_limits

    if cv2.getNumThreads() != 1:
        cv2.setNumThreads(1)
    if not _limited:
        # a sum over two threads ends in other bits than over one, and the environment may ask for two
        _limited.append(threadpool_limits(1))


ONE_STEP_IN = 1000
"""Of so many quantised values fewer than one, or a single one in all, may be a step off and count as rounded."""
ROUNDING = 1e-5
"""Floats may differ by so much of their array's largest value."""


def _differ_by_rounding(task: BlockTask, first: BlockRecord, second: BlockRecord, store: Store) -> bool:
    """Whether two results under one key are what two processors make of it."""
    for name, (dtype, chunk, _, quantised) in task.arrays.items():
        pairs = list(zip(first.outputs.get(name, ()), second.outputs[name], strict=False))
        if [a.value for a, _ in pairs] == [b.value for b in second.outputs[name]]:
            continue
        if len(pairs) != len(second.outputs[name]):
            return False
        a, b = (
            np.stack([store.chunks.get(pair[side], dtype=dtype, shape=chunk) for pair in pairs]) for side in (0, 1)
        )
        if not equal_to_rounding(a, b, quantised=quantised):
            return False
    return True


def equal_to_rounding(first: NDArray[Any], second: NDArray[Any], *, quantised: bool) -> bool:
    """Whether two arrays differ by no more than the last bits of what they were computed from.

    Args:
        quantised: whether integers stand for numbers, in steps; otherwise they must be equal.
    """
    if first.dtype.kind == "f":
        finite = np.isfinite(first)
        if not np.array_equal(np.where(finite, 0, first), np.where(np.isfinite(second), 0, second), equal_nan=True):
            return False
        a, b = first[finite].astype(np.float64), second[finite].astype(np.float64)
        return bool(a.size == 0 or np.abs(a - b).max() <= ROUNDING * np.abs(a).max())
    if first.dtype.kind in "iu" and quantised:
        steps = np.abs(first.astype(np.int64) - second.astype(np.int64))
        return bool(steps.max() <= 1 and np.count_nonzero(steps) <= max(1, (first.size - 1) // ONE_STEP_IN))
    return bool(np.array_equal(first, second))

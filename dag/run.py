"""Computes what is not known yet, and publishes it.

The graph of tasks is the same on threads, on local processes and on a cluster that shares the store; `places` has
these.
"""

import contextlib
import secrets
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from lightstage.dag.places import LostWorkersError, Where, compute
from lightstage.dag.plan import Plan, State, look_up
from lightstage.dag.publish import NodeResult, publish_results
from lightstage.dag.stage import refusal
from lightstage.dag.task import BlockTask, check_store, execute, lend, prepare
from lightstage.dag.watcher import Watcher
from lightstage.store.errors import DamagedChunkError, RequestError, WorkError
from lightstage.store.records import BlockRecord
from lightstage.store.root import Store
from lightstage.store.verify import verify


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

    When a damaged chunk is met, the whole store is verified, what is damaged is quarantined, and the run goes on;
    when workers are lost, it goes on with others. It goes on only while that gets it further.

    Raises:
        WorkError: a kernel refused, the disk is full, a raw or a calibration picture is damaged, the store or the
            workers are gone.
    """
    lend(store)
    computed: set[str] = set()
    met: set[str] = set()
    with _proof(store) as proof:
        while True:
            before = len(computed)
            state = look_up(plan, store, frames=frames)
            try:
                _compute(state, store, proof, watcher, where, computed)
                return state, publish_results(state, store, versions, computed)
            except LostWorkersError as loss:
                if len(computed) == before:
                    raise
                watcher.warn(f"{loss}; what was finished is kept, and the rest begins anew")
            except DamagedChunkError as damage:
                check_store(store.root, proof)
                if damage.blob in met or (met and len(computed) == before):
                    raise WorkError(f"{damage}, and making it anew does not help; check the disk") from None
                met.add(damage.blob)
                _heal(damage, store, watcher)
            finally:
                if where.workers:
                    store.scratch.sweep()  # the processes have ended, their folders are left


def _heal(error: DamagedChunkError, store: Store, watcher: Watcher) -> None:
    damaged = verify(store).damaged
    for damage in damaged:
        watcher.warn(f"{damage.path} was damaged: {damage.belongs_to}; {damage.remedy}")
    # damage to another session is told, and does not stop this one
    path = store.chunks.path(error.blob)
    lasting = [damage for damage in damaged if not damage.recomputable and damage.path == path]
    if lasting or (path.exists() and not damaged):
        remedy = lasting[0].remedy if lasting else "check the disk"
        raise WorkError(f"{error}; {remedy}") from None


@contextlib.contextmanager
def _proof(store: Store) -> Iterator[Path]:
    """A file in the store, by its path below the root: who sees it sees this store, and not one like it."""
    path = store.scratch.path()
    path.touch()
    try:
        yield path.relative_to(store.root)
    finally:
        with contextlib.suppress(OSError):
            path.unlink()


def _compute(state: State, store: Store, proof: Path, watcher: Watcher, where: Where, computed: set[str]) -> None:
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
    names = {name: f"{name}-{token}" for name in state.nodes}
    graph: dict[Any, Any] = {}
    for name, blocks in missing.items():
        for i in blocks:
            above, known = _above(state, name, i, names)
            task = BlockTask(state.nodes[name].plan, i, store, proof, above, elsewhere=where.elsewhere)
            graph[names[name], i] = (_execute_known, task, *known)
    compute(graph, where, _Collector(state, watcher, token, computed))


def _above(
    state: State, name: str, index: int, names: Mapping[str, str]
) -> tuple[dict[tuple[str, int], int], list[Any]]:
    """Where each block above stands among a task's arguments, and these: records, or the tasks that make them."""
    places: dict[tuple[str, int], int] = {}
    for pieces in state.nodes[name].plan.blocks[index].reads.values():
        for piece in pieces:
            for upper, i, _, _ in piece.chunks:
                places.setdefault((upper, i), len(places))
    arguments: list[Any] = []
    for upper, i in places:
        record = state.nodes[upper].records[i]
        arguments.append((names[upper], i) if record is None else _Known(record))
    return places, arguments


class _Known:
    """A record in an argument; wrapped, so that Dask looks for no graph inside."""

    __slots__ = ("record",)

    def __init__(self, record: BlockRecord) -> None:
        self.record = record


def _execute_known(task: BlockTask, *above: "BlockRecord | _Known") -> BlockRecord:
    record = execute(task, *(item.record if isinstance(item, _Known) else item for item in above))
    return replace(record, trace={})  # it lies in the store, and nobody here reads it


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
            except ValueError as error:
                sentence = refusal(error)
                if sentence is None:
                    raise
                problems.append(f"session '{state.plan.session.name}', {name}: {sentence}")
    if problems:
        raise RequestError("\n".join(dict.fromkeys(problems)))


class _Collector:
    """Takes in finished blocks."""

    def __init__(self, state: State, watcher: Watcher, token: str, computed: set[str]) -> None:
        self._state, self._watcher, self._suffix, self._computed = state, watcher, f"-{token}", computed

    def __call__(self, key: tuple[str, int], record: BlockRecord) -> None:
        name, index = key[0].removesuffix(self._suffix), key[1]
        if not record.reused:
            self._computed.add(record.key)
        if record.contradicted:
            node = self._state.nodes[name].plan
            self._watcher.warn(
                f"{name}, {node.blocks[index].label}: computed again, it came out different; the first result "
                "stays. The kernel is not deterministic, or this machine computes otherwise than the one before"
            )
        self._state.nodes[name].records[index] = record
        self._watcher.done(name, computed=not record.reused)

"""The one way of asking the engine: a request is answered from memory of an earlier answer, or by computing.

A request that was answered before, and whose results are all there, costs one record (`recall`): nothing that plans
or computes is imported for it.
"""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.dag.recall import lasting, recall, snapshot
from lightstage.dag.request import Request
from lightstage.dag.watcher import Notes, Watcher
from lightstage.sizes import human_size
from lightstage.store.errors import RequestError, WorkError
from lightstage.store.root import Store

if TYPE_CHECKING:
    from lightstage.dag.plan import Plan, State
    from lightstage.dag.publish import NodeResult
    from lightstage.store.items import Item

Stages = Callable[[], Mapping[str, str]]
"""Gives the table of stages, name to module; called only where a plan is made."""


@dataclass(frozen=True)
class NodeAnswer:
    """What was done for one node."""

    path: Path | None
    """The result, a zarr group; None where the request leaves the node nothing."""
    computed: int
    reused: int
    """Blocks."""
    seconds: float
    """Time in kernels and writing, summed over threads."""
    bytes: int
    remarks: Mapping[str, Any]
    """The attributes that its stage wants shown."""
    warnings: tuple[str, ...]


@dataclass(frozen=True, repr=False)
class Answer:
    """What a request came to."""

    session: str
    nodes: Mapping[str, NodeAnswer]
    """In the order of the pipeline."""
    seconds: float
    """From the plan to the end; 0 where the answer was remembered."""
    notes: tuple[str, ...] = ()
    """What whoever asked should know, beside the warnings of the nodes."""

    def __repr__(self) -> str:
        rows = [
            f"  {name:<14}{node.computed:>6} computed{node.reused:>6} reused{human_size(node.bytes):>10}"
            for name, node in self.nodes.items()
        ]
        return "\n".join([f"<Answer for session '{self.session}', {self.seconds:.2f} s>", *rows])


def answer(
    request: Request,
    store: Store,
    stages: Stages,
    *,
    watcher: Watcher | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
) -> Answer:
    """The answer to a request.

    Args:
        watcher: is told how it goes on; None: what it would be told to warn of is in the answer's notes.
        workers: compute on so many local processes instead of threads.
        scheduler: compute on the Dask cluster at this address, which shares the store.

    Raises:
        RequestError: the request does not fit the session, the pipeline, or the items.
        WorkError: a kernel refuses, the disk is full, something stored is damaged, the workers are gone.
    """
    _check_where(workers, scheduler)
    taken = snapshot(request, store)
    record = None if taken is None else recall(store, taken)
    if record is not None:
        return _answer(record, store, {}, 0.0, ())

    import time

    from lightstage.dag.places import Where
    from lightstage.dag.run import run
    from lightstage.store.sessions import show_raw

    store.scratch.sweep()
    plan = lay_out(request, store, stages)
    began = time.perf_counter()
    where = Where(workers=workers, scheduler=scheduler)
    quiet = Notes()
    state, results = run(plan, store, watcher or quiet, frames=request.frames, where=where, versions=_versions())
    elapsed = time.perf_counter() - began
    notes = quiet.texts
    # read anew: the session may have been imported again in the meantime
    try:
        show_raw(request.session, store)
    except WorkError as error:
        notes.append(str(error))
    notes += _skipped(state)
    record = _record(plan, results)
    if lasting(taken):
        store.records.put_run(plan.as_read(taken).key, record)
    store.scratch.leave()
    return _answer(record, store, results, elapsed, tuple(notes))


def lay_out(request: Request, store: Store, stages: Stages, *, with_results: bool = False) -> "Plan":
    """The pipeline of a request laid over its session.

    Args:
        with_results: where no nodes are named, also those that were asked for once and have a result.
    """
    from lightstage.dag.graph import load_graph
    from lightstage.dag.plan import bound_items, check_frames, make_plan
    from lightstage.store.results import current
    from lightstage.store.sessions import read_session

    graph = load_graph(request.pipeline, stages(), overrides=request.overrides)
    session = read_session(request.session, store)
    check_frames(request.frames, session)
    items = bound_items(session, store, given_items(request, store))
    nodes = list(request.nodes)
    if with_results and not nodes:
        nodes = [
            name
            for name, node in graph.nodes.items()
            if not node.asked or current(session.name, name, store) is not None
        ]
    return make_plan(graph, session, store, items, nodes)


def given_items(request: Request, store: Store) -> "dict[str, Item]":
    """The items that are given for a request alone, by kind; the store keeps them."""
    if not request.items:
        return {}
    from lightstage.store import document
    from lightstage.store.calibration import KINDS, read_item
    from lightstage.store.items import put_item

    items = {}
    for kind, path in request.items:
        if kind not in KINDS:
            raise RequestError(
                f"--calibration {kind}={path}: '{kind}' is no kind of item{document.nearest(kind, KINDS)}"
            )
        item, original = read_item(path, store.chunks, kind=kind)
        put_item(item, original, store)
        items[kind] = item
    return items


def _check_where(workers: int | None, scheduler: str | None) -> None:
    if workers is not None and workers < 1:
        raise RequestError(f"--workers {workers}: at least one process is needed")
    if scheduler is not None and not scheduler.strip():
        raise RequestError("--scheduler is empty; name an address, such as tcp://host:8786, or leave it out")
    if workers and scheduler:
        raise RequestError("--workers and --scheduler: choose one")


def _versions() -> dict[str, str]:
    """What the provenance names."""
    import platform
    from importlib.metadata import version

    names = ("numpy", "numba", "opencv-contrib-python-headless", "dask", "zarr", "numcodecs")
    return {"python": platform.python_version(), **{name: version(name) for name in names}}


def _skipped(state: "State") -> list[str]:
    if state.frames is None:
        return []
    first, last = state.frames
    return [
        f"{name} was not computed: each of its blocks needs frames outside {first}:{last}"
        for name, node in state.nodes.items()
        if node.plan.blocks and not any(node.selected)
    ]


def _record(plan: "Plan", results: "Mapping[str, NodeResult]") -> dict[str, Any]:
    """An answer as it is remembered: plain, and the same however much of it had to be computed."""
    nodes = {}
    for name, result in results.items():
        stage = plan.nodes[name].node.stage
        nodes[name] = {
            "name": name,
            "folder": None if result.path is None else result.path.name,
            "blocks": result.computed + result.reused,
            "bytes": result.size,
            "remarks": {key: result.attrs[key] for key in stage.remarks if key in result.attrs},
            "warnings": list(result.attrs.get("warnings", ())),
            "files": [[file, ref.blob, ref.size] for file, ref in result.files.items()],
        }
    return {"session": plan.session.name, "nodes": nodes}


def _answer(
    record: Mapping[str, Any],
    store: Store,
    results: "Mapping[str, NodeResult]",
    elapsed: float,
    notes: tuple[str, ...],
) -> Answer:
    nodes = {}
    for name, node in record["nodes"].items():
        computed, seconds = (results[name].computed, results[name].seconds) if name in results else (0, 0.0)
        folder = node["folder"]
        nodes[name] = NodeAnswer(
            path=None if folder is None else Path(os.path.join(store.results, record["session"], name, folder)),
            computed=computed,
            reused=node["blocks"] - computed,
            seconds=seconds,
            bytes=node["bytes"],
            remarks=node["remarks"],
            warnings=tuple(node["warnings"]),
        )
    return Answer(record["session"], nodes, elapsed, notes)

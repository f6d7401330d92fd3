"""Requests answered: computed or remembered, foretold, held against the store, explained."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from lightstage.dag.answer import Answer as Answer
from lightstage.dag.answer import answer as engine_answer
from lightstage.dag.answer import lay_out
from lightstage.dag.request import Request
from lightstage.dag.watcher import Watcher
from lightstage.store.root import Store

if TYPE_CHECKING:
    from lightstage.dag.explain import NodeStatus, Reason
    from lightstage.dag.plan import State


@dataclass(frozen=True)
class Outlook:
    """What a run would do for one node."""

    compute: int
    check: int
    """Blocks that are computed only if what is above comes out different."""
    reuse: int


@dataclass(frozen=True)
class Why:
    """Why a node would be computed again, or why it last was."""

    summary: str
    reasons: "tuple[Reason, ...]"
    """What changed in the keys of the node and of those above it."""

    def __str__(self) -> str:
        return "\n".join([self.summary, *(f"  {r.node}, {r.what}: {r.old} -> {r.new}" for r in self.reasons)])


def answer(
    request: Request,
    store: Store,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Watcher | None = None,
) -> Answer:
    """Compute what a request asks for, or remember it.

    Raises:
        RequestError: the request does not fit the session, the pipeline, or the items.
        WorkError: the request is right, and the work failed.
    """
    return engine_answer(request, store, _stages, watcher=progress, workers=workers, scheduler=scheduler)


def outlook(request: Request, store: Store) -> dict[str, Outlook]:
    """What a run would do, node by node; nothing is computed."""
    outlooks = {}
    for name, node in _state(request, store).nodes.items():
        if not node.plan.is_source:
            missing = node.missing()
            sure = sum(node.keys[i] is not None for i in missing)
            outlooks[name] = Outlook(sure, len(missing) - sure, sum(node.selected) - len(missing))
    return outlooks


def status(request: Request, store: Store) -> "dict[str, NodeStatus]":
    """How the nodes of a request stand; where it names none, also those that were asked for once."""
    from lightstage.dag.explain import status

    return {node.name: node for node in status(_state(request, store, with_results=True), store)}


def why(request: Request, store: Store) -> Why:
    """Why the node that a request names would be computed again, or why it last was.

    Raises:
        RequestError: it is no node that has results.
    """
    from lightstage.dag.explain import why
    from lightstage.store.document import nearest
    from lightstage.store.errors import RequestError

    (name,) = request.nodes
    state = _state(request, store)
    known = [other for other, node in state.nodes.items() if not node.plan.is_source]
    if name not in known:
        raise RequestError(f"there is no result of a node '{name}'{nearest(name, known)}")
    summary, reasons = why(state, name, store)
    return Why(summary, tuple(reasons))


def _state(request: Request, store: Store, *, with_results: bool = False) -> "State":
    from lightstage.dag.plan import look_up

    plan = lay_out(request, store, _stages, with_results=with_results)
    return look_up(plan, store, frames=request.frames)


def _stages() -> Mapping[str, str]:
    from lightstage.stages import TABLE

    return TABLE

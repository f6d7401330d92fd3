"""A plan held against what is in the store: the state of every node, and why it is what it is."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from lightstage.dag.plan import NodeState, State
from lightstage.dag.publish import plain_parts, result_attrs
from lightstage.store.results import current, lacks, provenance
from lightstage.store.root import Store

Condition = Literal["fresh", "stale", "partial", "missing"]


@dataclass(frozen=True)
class NodeStatus:
    """How a node stands.

    fresh: the result in use is what a run would give. stale: there is one, and a run would give another.
    partial: some blocks are there. missing: nothing is.
    """

    name: str
    condition: Condition
    known: int
    blocks: int
    size: int
    folder: str | None


def status(state: State, store: Store) -> list[NodeStatus]:
    """The state of every node of a plan that was looked up."""
    return [
        _node_status(state, name, node, store)
        for name, node in state.nodes.items()
        if not node.plan.node.stage.is_source
    ]


def _node_status(state: State, name: str, node: NodeState, store: Store) -> NodeStatus:
    session = state.plan.session.name
    known = [record for record in node.records if record is not None]
    folder = current(session, name, store)
    condition: Condition
    if len(known) == len(node.records):
        wanted = f"{node.plan.recipe}-{node.manifest(result_attrs(state, node))}"
        # computed blocks without their result folder: a run that was stopped before it published
        condition = "fresh" if folder == wanted else "stale" if folder else "partial"
        if condition == "fresh":
            record = provenance(session, name, wanted, store)
            if record is None or lacks(store.results / session / name / wanted, record):
                condition = "partial"  # somebody has deleted files of the group; a run links them again
    elif folder is not None:
        record = provenance(session, name, folder, store) or {}
        whole = len(record.get("inputs", {})) == len(node.records)
        condition = "stale" if whole or not folder.startswith(node.plan.recipe) else "partial"
    else:
        condition = "partial" if known else "missing"
    return NodeStatus(name, condition, len(known), len(node.records), sum(r.size for r in known), folder)


@dataclass(frozen=True)
class Reason:
    """One input of a key that changed."""

    node: str
    what: str
    old: str
    new: str


def why(state: State, name: str, store: Store) -> tuple[str, list[Reason]]:
    """Why a node would be computed again, or, when it is fresh, why it last was.

    Returns:
        a sentence, and what changed in the keys of the node and of those above it, old and new value.
    """
    session = state.plan.session.name
    node = state.nodes[name]
    how = _node_status(state, name, node, store)
    reasons: list[Reason] = []
    if how.folder is None:
        return (
            f"{name} has no result yet: {len(node.missing())} of {how.blocks} blocks have to be computed",
            [],
        )
    record = provenance(session, name, how.folder, store) or {}
    if how.condition != "fresh":
        for upper in _with_above(state, name):
            reasons += _against_now(state, upper, store)
        todo = len(node.missing())
        return (
            f"{name} is {how.condition}: {todo} of {how.blocks} blocks have to be computed or checked",
            reasons,
        )
    before = record.get("before")
    older = provenance(session, name, before, store) if before and before != how.folder else None
    if older is None:
        return (
            f"{name} is fresh: its {how.blocks} blocks were computed on {record.get('finished')}; "
            "no result stood before it",
            [],
        )
    present, former = _lineage(state, name, how.folder, store), _lineage(state, name, str(before), store)
    for upper in _with_above(state, name):
        reasons += _between(upper, former.get(upper, {}), present.get(upper, {}))
    return f"{name} is fresh; against the result before it ({before}) these inputs changed", reasons


def _lineage(state: State, name: str, folder: str, store: Store) -> dict[str, Mapping[str, Any]]:
    """How a result was made, and those that it was made from, by node."""
    session = state.plan.session.name
    folders = {name: folder}
    records: dict[str, Mapping[str, Any]] = {}
    for node in reversed(_with_above(state, name)):
        if node in folders:
            records[node] = provenance(session, node, folders[node], store) or {}
            folders |= {upper: f for upper, f in records[node].get("above", {}).items() if f is not None}
    return records


def _with_above(state: State, name: str) -> list[str]:
    wanted = {name}
    for other in reversed(state.nodes):
        if other in wanted:
            wanted |= set(state.nodes[other].plan.node.above)
    return [n for n in state.nodes if n in wanted and not state.nodes[n].plan.node.stage.is_source]


def _read(session: str, name: str, folder: str | None, store: Store) -> Mapping[str, Any]:
    return (provenance(session, name, folder, store) or {}) if folder else {}


def _against_now(state: State, name: str, store: Store) -> list[Reason]:
    node = state.nodes[name]
    session = state.plan.session.name
    record = _read(session, name, current(session, name, store), store)
    if not record:
        return [Reason(name, "result", "none", "to be computed")]
    now = {"parts": plain_parts(node.plan), "inputs": _inputs_now(state, node)}
    return _between(name, record, now)


def _inputs_now(state: State, node: NodeState) -> dict[str, list[str]]:
    values: dict[str, list[str]] = {}
    for block in node.plan.blocks:
        read = []
        for pieces in block.reads.values():
            for piece in pieces:
                for upper, i, array, offset in piece.chunks:
                    record = state.nodes[upper].records[i]
                    read.append("not known yet" if record is None else record.outputs[array][offset].value)
        values[block.label] = read
    return values


def _between(name: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> list[Reason]:
    before, after = _flat(old.get("parts", {})), _flat(new.get("parts", {}))
    reasons = []
    grouped: dict[tuple[str, str, str], list[str]] = {}
    for key in sorted(set(before) | set(after)):
        pair = (before.get(key, "absent"), after.get(key, "absent"))
        if pair[0] == pair[1]:
            continue
        if key[0] == "context":
            grouped.setdefault((".".join(key[2:]), *pair), []).append(key[1])
        else:
            reasons.append(Reason(name, ".".join(key), *pair))
    for (what, was, is_now), blocks in grouped.items():
        where = blocks[0] if len(blocks) == 1 else f"{len(blocks)} blocks"
        reasons.append(Reason(name, f"{what} ({where})", was, is_now))
    old_inputs, new_inputs = old.get("inputs", {}), new.get("inputs", {})
    for label in new_inputs:
        pairs = list(zip(old_inputs.get(label, []), new_inputs[label], strict=False))
        changed = [(a, b) for a, b in pairs if a != b and b != "not known yet"]
        if label not in old_inputs:
            reasons.append(Reason(name, f"block {label}", "absent", "new"))
        elif changed:
            reasons.append(Reason(name, f"input of {label}", changed[0][0][:12], changed[0][1][:12]))
    return reasons


def _flat(value: Any, path: tuple[str, ...] = ()) -> dict[tuple[str, ...], str]:
    if isinstance(value, Mapping):
        if set(value) == {"picture"}:
            return {path: f"picture {str(value['picture'])[:12]}"}
        flat: dict[tuple[str, ...], str] = {}
        for key, item in value.items():
            flat |= _flat(item, (*path, str(key)))
        return flat
    if isinstance(value, Sequence) and not isinstance(value, str):
        return {path: ", ".join(str(item) for item in value)[:160]}
    return {path: str(value)[:160]}

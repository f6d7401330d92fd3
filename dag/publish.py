"""From known blocks to result groups: what a group is called, what it says of itself, and how it was made."""

import math
import os
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from lightstage.dag.fingerprint import plain_context
from lightstage.dag.plan import NodePlan, NodeState, State
from lightstage.store.chunks import ChunkRef
from lightstage.store.errors import WorkError
from lightstage.store.notes import chunk_file
from lightstage.store.results import ResultName, current, publish, set_current
from lightstage.store.root import Store


@dataclass(frozen=True)
class NodeResult:
    """What a run did for one node."""

    computed: int
    reused: int
    seconds: float
    """Time in kernels and writing, summed over threads."""
    size: int
    path: Path | None
    files: Mapping[str, ChunkRef]
    """The group's chunks, by their files."""
    attrs: Mapping[str, Any]


def publish_results(
    state: State, store: Store, versions: Mapping[str, str], computed: Set[str]
) -> dict[str, NodeResult]:
    """Make the result folder of every node that has blocks, and let `current` name it."""
    results = {}
    for name, node in state.nodes.items():
        if not node.plan.is_source:
            results[name] = _publish(state, name, node, store, versions, computed)
    return results


def _publish(
    state: State, name: str, node: NodeState, store: Store, versions: Mapping[str, str], new_keys: Set[str]
) -> NodeResult:
    chosen = [r for r, selected in zip(node.records, node.selected, strict=True) if r is not None and selected]
    # counted over all rounds of a run: what was computed before a damaged chunk was met was computed, too
    computed = [record for record in chosen if record.key in new_keys]
    chunks = node.chunks()
    files = {chunk_file(array, index): ref for array, placed in chunks.items() for index, ref in placed.items()}
    plan = node.plan
    attrs = result_attrs(state, node)
    path = None
    if chosen:
        session = state.plan.session
        result = ResultName(session.name, name, plan.recipe, node.manifest(attrs))
        provenance = {
            "parts": plain_parts(plan),
            "inputs": _input_values(state, node),
            "above": {u: current(session.name, u, store) for u in plan.node.above},
            "before": current(session.name, name, store),
            "items": attrs["calibration_items"],
            "versions": dict(versions),
            "computed": len(computed),
            "seconds": sum(record.seconds for record in chosen),
            "bytes": sum(ref.size for ref in files.values()),
            "host": os.uname().nodename,
            "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        }
        for _ in range(3):  # `gc` may take it away before `current` names it
            path = publish(
                result,
                store,
                arrays=plan.arrays,
                coordinates=plan.coordinates(),
                attrs=attrs,
                chunks=chunks,
                provenance=provenance,
            )
            if set_current(result, store):
                break
        else:
            raise WorkError(f"{path} was removed while it was published (gc with too short a grace?); run again")
        if len(chosen) == len(plan.blocks) and not node.remembered:
            node.keys = [record.key for record in chosen]
            store.records.put_node(str(node.node_key), chosen)
    return NodeResult(
        computed=len(computed),
        reused=len(chosen) - len(computed),
        seconds=sum(record.seconds for record in computed),
        size=sum(record.size for record in chosen),
        path=path,
        files=files,
        attrs=attrs,
    )


def result_attrs(state: State, node: NodeState) -> dict[str, Any]:
    """What a result's group says of itself; nothing that differs from one run to the next."""
    plan = node.plan
    chosen = [r for r, selected in zip(node.records, node.selected, strict=True) if r is not None and selected]
    names = sorted({name for record in chosen for name in record.stats})
    # a block whose pictures do not tell a figure has none
    stats = {name: _mean([r.stats[name] for r in chosen if name in r.stats]) for name in names}
    attrs = {**{k: v for k, v in plan.grid.attrs.items() if v != ""}, **stats}
    warnings = [sentence for record in chosen for sentence in record.warnings]
    if warnings:
        attrs["warnings"] = list(dict.fromkeys(warnings))
    if plan.absent:
        needs = plan.node.stage.calibration
        attrs["calibration_absent"] = "; ".join(f"{kind}: {needs[kind].why}" for kind in plan.absent)
    if len(chosen) < len(plan.blocks):
        attrs["partial"] = f"{len(chosen)} of {len(plan.blocks)} blocks"
    items = state.plan.items
    return attrs | {
        "session": state.plan.session.name,
        "node": plan.node.name,
        "stage": plan.node.stage.name,
        "recipe": plan.recipe,
        "parameters": plan.node.params.model_dump(mode="json"),
        "calibration_items": {k: items[k].name for k in plan.node.stage.calibration if k in items},
    }


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)


def plain_parts(plan: NodePlan) -> dict[str, Any]:
    """What decides a node's result beside the pictures, by name, for people and for `why`."""
    contexts = {digest: plain_context(context) for digest, context in sorted(plan.contexts.items())}
    return {**plan.parts, "context": {block.label: contexts.get(block.context, {}) for block in plan.blocks}}


def _input_values(state: State, node: NodeState) -> dict[str, list[str]]:
    values: dict[str, list[str]] = {}
    for block, record in zip(node.plan.blocks, node.records, strict=True):
        if record is None:
            continue
        read = []
        for pieces in block.reads.values():
            for piece in pieces:
                for upper, i, array, offset in piece.chunks:
                    above = state.nodes[upper].records[i]
                    if above is not None:
                        read.append(above.outputs[array][offset].value)
        values[block.label] = read
    return values

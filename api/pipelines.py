"""A pipeline file as it is read and checked: its nodes, their stages and parameters."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightstage.api.requests import pipeline_path
from lightstage.dag.graph import load_graph
from lightstage.stages import TABLE
from lightstage.stages.calibration import MEASURED as MEASURED


@dataclass(frozen=True)
class PipelineNode:
    """One node."""

    stage: str
    summary: str
    above: tuple[str, ...]
    """The nodes that it reads."""
    asked: bool
    """Whether it is computed only when it is asked for."""
    parameters: Mapping[str, Any]
    changed: Mapping[str, Any]
    """The parameters that are not the stage's defaults."""
    outputs: Mapping[str, tuple[str, ...]]
    """Array to dimensions."""


@dataclass(frozen=True)
class Pipeline:
    """A checked pipeline; each node comes after those that it reads."""

    source: str
    nodes: Mapping[str, PipelineNode]


def read_pipeline(file: str | Path | None = None, *, changes: Sequence[str] = ()) -> Pipeline:
    """Read a pipeline file: the one named, the current folder's, or the packaged one.

    Args:
        changes: parameters that differ from it, `node.param=value`.

    Raises:
        RequestError: all that is wrong with it, a line each.
    """
    graph = load_graph(pipeline_path(file), TABLE, overrides=changes)
    nodes = {}
    for name, node in graph.nodes.items():
        defaults = type(node.params).model_fields
        nodes[name] = PipelineNode(
            stage=node.stage.name,
            summary=node.stage.summary,
            above=node.above,
            asked=node.asked,
            parameters=node.params.model_dump(mode="json"),
            changed={key: value for key, value in node.params if value != defaults[key].default},
            outputs={array: output.dims for array, output in node.stage.outputs.items()},
        )
    return Pipeline(graph.source, nodes)


def drawing(pipeline: Pipeline) -> Iterator[str]:
    """The pipeline as a tree, a line a node, each below the first that it reads."""
    below: dict[str, list[str]] = {name: [] for name in pipeline.nodes}
    for name, node in pipeline.nodes.items():
        if node.above:
            below[node.above[0]].append(name)
    # a stack, not a recursion: a chain may be of any length
    waiting = [(name, "", True, True) for name, node in reversed(list(pipeline.nodes.items())) if not node.above]
    while waiting:
        name, prefix, last, root = waiting.pop()
        node = pipeline.nodes[name]
        branch = "" if root else ("└─ " if last else "├─ ")
        changed = "".join(f", {key}: {value}" for key, value in node.changed.items())
        also = f" (and from {', '.join(node.above[1:])})" if node.above[1:] else ""
        when = " (when asked)" if node.asked else ""
        yield f"{prefix}{branch}{name}: {node.summary}{changed}{also}{when}"
        deeper = prefix + ("" if root else "   " if last else "│  ")
        waiting += reversed([(child, deeper, child == below[name][-1], False) for child in below[name]])

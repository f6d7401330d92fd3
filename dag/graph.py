"""`pipeline.yaml` -> a checked graph.

Everything that can be known from the file alone is checked here, all errors at once, each with file, line,
column, the offending text and the nearest valid name.
"""

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from lightstage.dag.stage import Params, Stage
from lightstage.store import document
from lightstage.store.document import Document, nearest
from lightstage.store.errors import MOST_PROBLEMS, RequestError, raise_all
from lightstage.store.intake import FileError, read_regular
from lightstage.store.names import NAME_RULE
from lightstage.store.names import SESSION_NAME as NAME


class _NodeEntry(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    uses: str = Field(description="the stage")
    sources: str | tuple[str, ...] = Field((), alias="from", description="the node or nodes that it reads")
    params: dict[str, Any] | None = Field(None, description="parameters that differ from the stage's defaults")
    when: Literal["always", "asked"] = Field("always", description="asked: only when a run names it, or needs it")

    @property
    def above(self) -> tuple[str, ...]:
        """The nodes that it reads."""
        return (self.sources,) if isinstance(self.sources, str) else self.sources


class _PipelineFile(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    stages: dict[str, Any] = Field(min_length=1, description="the nodes by name")


@dataclass(frozen=True)
class Node:
    """One node of the graph."""

    name: str
    stage: Stage
    module: str
    params: Params
    above: tuple[str, ...]
    asked: bool = False
    """Whether a run that names no nodes leaves it out."""


@dataclass(frozen=True)
class Graph:
    """A checked pipeline; `nodes` is in an order in which each comes after those that it reads."""

    nodes: Mapping[str, Node]
    source: str
    digest: str
    """Of the file's text."""

    @property
    def usual(self) -> list[str]:
        """The nodes that a run without names computes."""
        return [name for name, node in self.nodes.items() if not node.asked]

    def with_all_above(self, names: Sequence[str]) -> list[str]:
        """These nodes and all that they need, in order; `usual` when none is named.

        Raises:
            RequestError: a name is not in the pipeline.
        """
        unknown = [name for name in names if name not in self.nodes]
        if unknown:
            raise RequestError(f"{self.source} has no node '{unknown[0]}'{nearest(unknown[0], self.nodes)}")
        wanted = set(names or self.usual)
        for name in reversed(list(self.nodes)):
            if name in wanted:
                wanted |= set(self.nodes[name].above)
        return [name for name in self.nodes if name in wanted]


def load_graph(path: Path, table: Mapping[str, str], *, overrides: Sequence[str] = ()) -> Graph:
    """Read a pipeline file and check it against the stages.

    Args:
        path: the YAML file.
        table: stage name -> module that holds its `STAGE`.
        overrides: `node.param=value`, as given with --set.

    Raises:
        RequestError: everything that is wrong, a line each.
    """
    text = _text(path)
    asked = (str(path), text, tuple(table.items()), tuple(overrides))
    if text is None or asked not in _checked:
        _checked.clear()  # one is asked for again and again: for every session of a store
        _checked[asked] = _check(document.load(path, what="a pipeline"), table, overrides)
    return _checked[asked]


_checked: dict[tuple[object, ...], Graph] = {}


def _text(path: Path) -> bytes | None:
    try:
        return read_regular(path, document.MOST_BYTES)
    except FileError:
        return None  # `document` says why


def _check(source: Document, table: Mapping[str, str], overrides: Sequence[str]) -> Graph:
    problems: list[str] = []
    entries: dict[str, _NodeEntry] = {}
    names = document.check(source, _PipelineFile).stages
    for name in names:
        # each by itself, so that a slip in one does not hide those in the others
        try:
            entries[name] = document.check(source, _NodeEntry, where=("stages", name))
        except RequestError as error:
            problems += str(error).splitlines()
    changes = _parse_overrides(overrides, names, problems)
    nodes: dict[str, Node] = {}
    for name, entry in entries.items():
        if len(problems) > MOST_PROBLEMS:
            raise_all(problems)  # to look for more would take long in a long file
        node = _node(source, name, entry, names, table, changes.get(name, {}), problems)
        if node is not None:
            nodes[name] = node
    order = _order(source, {name: entry.above for name, entry in entries.items()}, problems)
    for name in order:
        if name in nodes:
            problems += _misfits(source, nodes[name], nodes)
    raise_all(problems)
    return Graph({name: nodes[name] for name in order}, source.name, source.digest)


def _node(
    source: Document,
    name: str,
    entry: _NodeEntry,
    names: Mapping[str, Any],
    table: Mapping[str, str],
    changes: Mapping[str, Any],
    problems: list[str],
) -> Node | None:
    """The node of an entry; None, and what is wrong among the problems, where it cannot be one."""
    at = ("stages", name)
    if not NAME.fullmatch(name) or name == "current":
        problems.append(
            f"{source.at(at)}: '{document.short(name)}' cannot name a node, because it names a folder: {NAME_RULE}"
        )
    if entry.uses not in table:
        spot = source.at((*at, "uses"))
        problems.append(f"{spot}: there is no stage '{document.short(entry.uses)}'{nearest(entry.uses, table)}")
        return None
    module = table[entry.uses]
    stage: Stage = importlib.import_module(module).STAGE
    params = _parameters(source, name, stage, entry, changes, problems)
    spot = source.at((*at, "from"))
    problems += [
        f"{spot}: '{name}' reads '{document.short(upper)}', which is no node here{nearest(upper, names)}"
        for upper in entry.above
        if upper not in names
    ]
    if len(entry.above) != stage.sources:
        wants = f"{stage.sources} node(s)" if stage.sources else "none: it brings in the session"
        problems.append(
            f"{spot}: '{name}' names {len(entry.above)} node(s) in 'from'; the stage {stage.name} reads {wants}"
        )
    return None if params is None else Node(name, stage, module, params, entry.above, entry.when == "asked")


def _parse_overrides(
    overrides: Sequence[str], entries: Mapping[str, Any], problems: list[str]
) -> dict[str, dict[str, Any]]:
    changes: dict[str, dict[str, Any]] = {}
    for text in overrides:
        target, equals, value = text.partition("=")
        name, dot, parameter = target.partition(".")
        if not (equals and dot and name and parameter):
            problems.append(f"--set {document.short(text)}: expected node.parameter=value")
        elif name not in entries:
            problems.append(f"--set {document.short(text)}: there is no node '{name}'{nearest(name, entries)}")
        else:
            try:
                changes.setdefault(name, {})[parameter] = document.scalar(value)
            except RequestError as error:
                problems.append(f"--set {document.short(text)}: {error}")
    return changes


def _parameters(
    source: Document,
    name: str,
    stage: Stage,
    entry: _NodeEntry,
    changes: Mapping[str, Any],
    problems: list[str],
) -> Params | None:
    where = ("stages", name, "params")
    given = dict(entry.params or {}) | dict(changes)
    try:
        return stage.params.model_validate(given)
    except ValidationError as error:
        for at, text in document.problems(error, stage.params, given):
            key = str(at[0]) if at else ""
            if key in changes:
                problems.append(f"--set {name}.{key}={document.short(changes[key])}: {text}")
            else:
                owner = f" (parameters of {stage.name})" if text.startswith("unknown key") else ""
                problems.append(f"{source.at((*where, *at))}: {text}{owner}")
        return None


def _order(source: Document, above: Mapping[str, Sequence[str]], problems: list[str]) -> list[str]:
    """Topological; none where nodes read each other in a circle, which is a problem."""
    try:
        return [name for name in TopologicalSorter(above).static_order() if name in above]
    except CycleError as error:
        circle: list[str] = error.args[1][::-1]
    shown = circle if len(circle) <= 12 else [*circle[:6], f"... ({len(circle) - 12} more)", *circle[-6:]]
    spot = source.at(("stages", circle[-2], "from"))
    problems.append(f"{spot}: the nodes read each other in a circle: {' -> '.join(shown)}")
    return []


def _misfits(source: Document, node: Node, nodes: Mapping[str, Node]) -> list[str]:
    """Inputs whose array or dimensions are not what the node above puts out."""
    misfits = []
    spot = source.at(("stages", node.name, "from"))
    for spec in node.stage.inputs.values():
        if spec.source >= len(node.above) or node.above[spec.source] not in nodes:
            continue
        upper = nodes[node.above[spec.source]]
        output = upper.stage.outputs.get(spec.array)
        if output is None and spec.optional:
            continue
        if output is None:
            have = ", ".join(upper.stage.outputs)
            misfits.append(
                f"{spot}: '{node.name}' reads the array '{spec.array}', and '{upper.name}' "
                f"(stage {upper.stage.name}) puts out {have}"
            )
        elif output.dims != spec.dims:
            misfits.append(
                f"{spot}: '{node.name}' reads {spec.array}({', '.join(spec.dims)}), and '{upper.name}' "
                f"(stage {upper.stage.name}) puts out {spec.array}({', '.join(output.dims)})"
            )
    return list(dict.fromkeys(misfits))

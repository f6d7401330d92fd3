"""Which blocks there are, what each reads, and which of them are known already.

`make_plan` lays a graph over a session: grids and blocks, from labels alone. `look_up` walks it in order and
finds the record of every block whose inputs are known; what is left is what has to be computed.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from lightstage.dag.code import keep_memory
from lightstage.dag.fingerprint import block_key, plain_context, recipe, stage_key, stage_parts
from lightstage.dag.graph import Graph, Node
from lightstage.dag.recall import Snapshot, item_digest
from lightstage.dag.stage import Arrangement, CalibrationPicture, Grid, Group, Name, StageError, refusal
from lightstage.store.chunks import ChunkIndex, ChunkRef
from lightstage.store.digest import SHORT, digest_value
from lightstage.store.errors import RequestError, raise_all
from lightstage.store.grid import ArrayTemplate, Coordinate
from lightstage.store.items import Item, StoredPicture, get_item, not_valid_for
from lightstage.store.records import BlockRecord
from lightstage.store.root import Store
from lightstage.store.sessions import Session


@dataclass(frozen=True)
class Piece:
    """One array handed to a kernel: what it is called there, chunks of blocks above in C order, and their shape."""

    name: Name

    chunks: tuple[tuple[str, int, str, int], ...]
    """(node above, its block, array, place in the block's chunks)."""
    dtype: str
    chunk_shape: tuple[int, ...]
    shape: tuple[int, ...]
    scale: float | None = None
    fill: int | None = None

    def key_of(self, values: Sequence[str]) -> list[Any]:
        """What of a piece enters a block's key: its values, and how the kernel gets them."""
        return [self.name, list(values), self.dtype, list(self.shape), self.scale, self.fill]


@dataclass(frozen=True)
class Block:
    """One task: its index along the node's block dimensions, and what it reads."""

    index: tuple[int, ...]
    label: str
    """For people: 'frame 3 (X), band 576'."""
    reads: Mapping[str, tuple[Piece, ...]]
    context: str
    """Digest of its context."""
    frames: frozenset[int]
    """The session's frames that it depends on."""


@dataclass(frozen=True)
class NodePlan:
    """A node laid over a session."""

    node: Node
    grid: Grid
    arrays: Mapping[str, ArrayTemplate]
    block_dims: tuple[str, ...]
    blocks: tuple[Block, ...]
    contexts: Mapping[str, Mapping[str, Any]]
    parts: Mapping[str, Any]
    stage_key: str
    recipe: str
    absent: tuple[str, ...]
    """Optional calibration kinds that are not bound."""
    units: Mapping[str, str]
    """Of coordinates."""
    places: Mapping[str, Callable[[int, Mapping[str, Any]], str]]
    """How an index along a dimension is called."""

    @property
    def is_source(self) -> bool:
        """Whether the node brings in the session."""
        return self.node.stage.is_source

    def chunk_indices(self, block: Block, array: str) -> list[ChunkIndex]:
        """Places in the array's chunk grid of a block's chunks, in the order of its record."""
        template = self.arrays[array]
        fixed = dict(zip(self.block_dims, block.index, strict=True))
        grid = template.grid()
        ranges = [
            [fixed[dim]] if dim in fixed else range(count) for dim, count in zip(template.dims, grid, strict=True)
        ]
        return list(itertools.product(*ranges))

    def coordinates(self) -> dict[str, Coordinate]:
        """The labels of the result."""
        return {
            name: Coordinate(dims, values, {"units": self.units[name]} if name in self.units else {})
            for name, (dims, values) in self.grid.labels.items()
        }


@dataclass(frozen=True)
class Plan:
    """A graph laid over a session; `nodes` in order."""

    graph: Graph
    session: Session
    nodes: Mapping[str, NodePlan]
    items: Mapping[str, Item]
    targets: tuple[str, ...]

    def as_read(self, taken: Snapshot) -> Snapshot:
        """A snapshot as this plan has read it: its files may have been others when it was taken."""
        return replace(
            taken,
            session=self.session.digest,
            pipeline=self.graph.digest,
            items={kind: _content_digest(item) for kind, item in self.items.items()},
        )


@dataclass
class NodeState:
    """What is known of a node's blocks."""

    plan: NodePlan
    records: list[BlockRecord | None]
    keys: list[str | None]
    selected: list[bool]
    remembered: bool = False
    """Whether the node's record names these very blocks."""

    @property
    def node_key(self) -> str | None:
        """Key over all blocks, when all their inputs are known."""
        if any(key is None for key in self.keys):
            return None
        return digest_value({"blocks": self.keys})

    def missing(self) -> list[int]:
        """The selected blocks that have to be computed (or whose inputs have)."""
        return [i for i, record in enumerate(self.records) if self.selected[i] and record is None]

    @property
    def complete(self) -> bool:
        """Whether every selected block is known, and there is one."""
        return any(self.selected) and not self.missing()

    def manifest(self, attrs: Mapping[str, Any]) -> str:
        """Digest of the values of all selected blocks, and of what the group says beside them: names the content.

        Args:
            attrs: the group's attributes; labels are added.
        """
        content = {
            ",".join(map(str, block.index)): {
                name: [r.value for r in refs] for name, refs in record.outputs.items()
            }
            for block, record, selected in zip(self.plan.blocks, self.records, self.selected, strict=True)
            if record is not None and selected
        }
        labels = {
            name: [list(dims), [None if v != v else v for v in values]]
            for name, (dims, values) in self.plan.grid.labels.items()
        }
        return digest_value({"blocks": content, "labels": labels, "said": dict(attrs)})[:SHORT]

    def chunks(self) -> dict[str, dict[ChunkIndex, ChunkRef]]:
        """Per array, the selected chunks by their place."""
        placed: dict[str, dict[ChunkIndex, ChunkRef]] = {name: {} for name in self.plan.arrays}
        for block, record, selected in zip(self.plan.blocks, self.records, self.selected, strict=True):
            if record is None or not selected:
                continue
            for name in placed:
                indices = self.plan.chunk_indices(block, name)
                placed[name].update(zip(indices, record.outputs[name], strict=True))
        return placed


@dataclass
class State:
    """What is known of a plan's blocks."""

    plan: Plan
    nodes: dict[str, NodeState] = field(default_factory=dict)
    frames: tuple[int, int] | None = None


def _content_digest(item: Item) -> str:
    pictures = {name: picture.as_plain() for name, picture in item.pictures.items()}
    return item_digest(item.kind, item.digest, item.values, item.notes, pictures)


def bound_items(session: Session, store: Store, overrides: Mapping[str, Item]) -> dict[str, Item]:
    """The items of a session, with those given for this run in their place."""
    items = {kind: get_item(kind, digest, store) for kind, digest in session.items.items() if kind not in overrides}
    return items | dict(overrides)


def make_plan(
    graph: Graph, session: Session, store: Store, items: Mapping[str, Item], targets: Sequence[str]
) -> Plan:
    """Lay the nodes that `targets` need over a session.

    Raises:
        RequestError: a stage refuses the session, or an item does not hold for it; all such, a line each.
    """
    plain = _plain_items(items, store)
    facts = {**session.facts, "shape": list(session.shape), "mask": _mask(session, store), "items": plain}
    nodes: dict[str, NodePlan] = {}
    problems: list[str] = []
    for name in graph.with_all_above(targets):
        node = graph.nodes[name]
        if any(upper not in nodes for upper in node.above):
            continue  # what is above was refused already
        problems += _item_problems(node, items, facts)
        if problems:
            continue
        try:
            nodes[name] = _plan_node(node, [nodes[upper] for upper in node.above], facts, plain)
        except ValueError as error:
            sentence = refusal(error)
            if sentence is None:
                raise
            problems.append(f"session '{session.name}', {name}: {sentence}")
    raise_all(problems)
    keep_memory()
    return Plan(graph, session, nodes, items, tuple(targets))


def _mask(session: Session, store: Store) -> CalibrationPicture | None:
    if session.mask is None:
        return None
    return CalibrationPicture(session.mask.chunk.value, partial(StoredPicture.load, session.mask, store))


def _item_problems(node: Node, items: Mapping[str, Item], facts: Mapping[str, Any]) -> list[str]:
    problems = []
    for kind, needs in node.stage.calibration.items():
        item = items.get(kind)
        if item is None and needs.required:
            problems.append(
                f"{node.name} needs the {kind} item ({needs.why}); bound are {', '.join(items) or 'none'}"
            )
        if item is not None:
            reason = not_valid_for(item, rig=facts["rig"], captured=facts["captured"])
            if reason:
                problems.append(f"{node.name}: {item.name} cannot be used: {reason}")
    return problems


def _plain_items(items: Mapping[str, Item], store: Store) -> dict[str, dict[str, Any]]:
    plain: dict[str, dict[str, Any]] = {}
    for kind, item in items.items():
        plain[kind] = dict(item.values)
        if item.pictures:
            plain[kind]["pictures"] = {
                name: CalibrationPicture(picture.chunk.value, partial(StoredPicture.load, picture, store))
                for name, picture in item.pictures.items()
            }
    return plain


def _plan_node(
    node: Node, above: Sequence[NodePlan], facts: Mapping[str, Any], items: Mapping[str, Mapping[str, Any]]
) -> NodePlan:
    stage = node.stage
    grids = [replace(upper.grid, arrays=frozenset(upper.arrays)) for upper in above]
    arrangement = stage.arrange(grids, facts, node.params)
    names = arrangement.dims
    grid = arrangement.grid
    arrays = {}
    for name, output in stage.outputs.items():
        if arrangement.outputs is not None and name not in arrangement.outputs:
            continue
        dims = tuple(names.get(dim, dim) for dim in output.dims)
        shape = tuple(grid.sizes[dim] for dim in dims)
        chunk = tuple(size if dim in output.whole else 1 for dim, size in zip(dims, shape, strict=True))
        arrays[name] = ArrayTemplate(dims, shape, chunk, output.dtype, output.attrs)
    block_dims = tuple(names.get(dim, dim) for dim in arrangement.blocks or stage.blocks)
    units = _inherited(stage.units, [upper.units for upper in above])
    places = _inherited(stage.places, [upper.places for upper in above])
    contexts: dict[str, Mapping[str, Any]] = {}
    digests: dict[str, str] = {}
    blocks = []
    upper_named = {upper.node.name: upper for upper in above}
    ranges = [range(grid.sizes[dim]) for dim in block_dims]
    for i, index in enumerate(itertools.product(*ranges)):
        labels = _labels(grid, block_dims, index)
        group = arrangement.groups[i] if arrangement.groups else None
        block_labels = {**labels, **(group.labels if group else {})}
        digest = ""
        if stage.context is not None:
            context = stage.context(block_labels, facts, items, node.params)
            text = repr(context)  # of most blocks the same, and quicker than a digest of it
            if text not in digests:
                digests[text] = digest_value(plain_context(context))
                contexts.setdefault(digests[text], context)
            digest = digests[text]
        reads = _reads(node, above, grid, block_dims, index, group, arrangement)
        frames = frozenset(
            itertools.chain.from_iterable(
                upper_named[name].blocks[i].frames
                for name, i in {
                    chunk[:2] for pieces in reads.values() for piece in pieces for chunk in piece.chunks
                }
            )
        )
        if stage.is_source:
            frames = frozenset({index[block_dims.index("frame")]})
        blocks.append(Block(index, _describe(labels, block_dims, index, places), reads, digest, frames))
    key = stage_key(stage, node.module, node.params)
    absent = tuple(kind for kind in stage.calibration if kind not in items)
    return NodePlan(
        node,
        grid,
        arrays,
        block_dims,
        tuple(blocks),
        contexts,
        stage_parts(stage, node.module, node.params),
        key,
        recipe(key, contexts, [upper.recipe for upper in above])[:SHORT],
        absent,
        units,
        places,
    )


def _inherited(own: Mapping[str, Any], above: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    """What a stage says of its dimensions and coordinates, and those above it."""
    return {**{name: value for upper in above for name, value in upper.items()}, **own}


def _labels(grid: Grid, dims: Sequence[str], index: Sequence[int]) -> dict[str, Any]:
    place = dict(zip(dims, index, strict=True))
    return {name: values[place[d[0]]] for name, (d, values) in grid.labels.items() if len(d) == 1 and d[0] in place}


def _describe(
    labels: Mapping[str, Any],
    dims: Sequence[str],
    index: Sequence[int],
    places: Mapping[str, Callable[[int, Mapping[str, Any]], str]],
) -> str:
    words = [
        places[dim](i, labels) if dim in places else f"{dim} {labels.get(dim, i)}"
        for dim, i in zip(dims, index, strict=True)
    ]
    return ", ".join(word for word in words if word)


def _reads(
    node: Node,
    above: Sequence[NodePlan],
    grid: Grid,
    dims: Sequence[str],
    index: Sequence[int],
    group: Group | None,
    arrangement: Arrangement,
) -> dict[str, tuple[Piece, ...]]:
    reads: dict[str, tuple[Piece, ...]] = {}
    for name, spec in node.stage.inputs.items():
        upper = above[spec.source]
        if spec.array not in upper.arrays:
            if spec.optional:
                reads[name] = ()
                continue
            raise StageError(f"{upper.node.name} makes no '{spec.array}' with its parameters; it is needed here")
        array = upper.arrays[spec.array]
        if spec.how == "each":
            place = dict(zip(dims, index, strict=True))
            chosen: Mapping[Name, Mapping[str, int]] = {"": {dim: place[dim] for dim in array.dims if dim in place}}
        else:
            assert group is not None, f"the stage {node.stage.name} groups, but its arrangement has no groups"
            chosen = group.reads[name]
        reads[name] = tuple(
            _piece(piece, upper, spec.array, array, selection) for piece, selection in chosen.items()
        )
    return reads


def _piece(called: Name, upper: NodePlan, name: str, array: ArrayTemplate, selection: Mapping[str, int]) -> Piece:
    counts = dict(zip(array.dims, array.grid(), strict=True))
    ranges = [[selection[dim]] if dim in selection else range(count) for dim, count in counts.items()]
    if any(array.chunk[array.dims.index(dim)] != 1 for dim in selection):
        raise StageError(
            f"{upper.node.name}.{name} cannot be read at one index of {', '.join(selection)}: not chunked so"
        )
    within = [dim for dim in array.dims if dim not in upper.block_dims]
    chunks = []
    for place in itertools.product(*ranges):
        at = dict(zip(array.dims, place, strict=True))
        block = 0
        for dim in upper.block_dims:
            block = block * upper.grid.sizes[dim] + at[dim]
        offset = 0
        for dim in within:
            offset = offset * counts[dim] + at[dim]
        chunks.append((upper.node.name, block, name, offset))
    shape = tuple(size for dim, size in zip(array.dims, array.shape, strict=True) if dim not in selection)
    scale = array.attrs.get("scale_factor")
    return Piece(called, tuple(chunks), array.dtype, array.chunk, shape, scale, array.attrs.get("_FillValue"))


def look_up(plan: Plan, store: Store, *, frames: tuple[int, int] | None = None) -> State:
    """Find what is known already.

    Args:
        frames: half-open range of the session's frames; blocks that depend on others are not selected.
    """
    state = State(plan, {}, frames)
    for name, node in plan.nodes.items():
        wanted = [
            frames is None or all(frames[0] <= frame < frames[1] for frame in block.frames) for block in node.blocks
        ]
        if node.node.stage.is_source:
            records: list[BlockRecord | None] = list(_source_records(plan.session, node))
            keys: list[str | None] = [record.key for record in records if record is not None]
        else:
            keys = [known_key(node, block, state.nodes) for block in node.blocks]
            records = [None] * len(keys)
        state.nodes[name] = NodeState(node, records, keys, wanted)
        if not node.node.stage.is_source:
            _find_records(state.nodes[name], store)
    return state


def _find_records(state: NodeState, store: Store) -> None:
    node_key = state.node_key
    known = store.records.node(node_key) if node_key is not None else None
    if known is not None and [record.key for record in known] != state.keys:
        known = None  # not what the key promises: trust the blocks
    state.remembered = known is not None
    for i, key in enumerate(state.keys):
        if key is None:
            continue
        record = known[i] if known is not None else store.records.block(key)
        if record is not None and record.key == key and all(store.chunks.has(ref) for ref in record.chunks()):
            state.records[i] = replace(record, trace={})
        else:
            state.remembered = False


def known_key(node: NodePlan, block: Block, states: Mapping[str, NodeState]) -> str | None:
    """The block's key, when the records of all that it reads are known."""
    reads: dict[str, list[Any]] = {}
    for name, pieces in block.reads.items():
        reads[name] = []
        for piece in pieces:
            values = []
            for upper, i, array, offset in piece.chunks:
                record = states[upper].records[i]
                if record is None:
                    return None
                values.append(record.outputs[array][offset].value)
            reads[name].append(piece.key_of(values))
    return block_key(node.stage_key, block.context, reads)


def _source_records(session: Session, node: NodePlan) -> list[BlockRecord]:
    records = []
    for frame in session.images:
        for refs in frame:
            key = digest_value([ref.value for ref in refs])
            records.append(BlockRecord(key, {"raw": tuple(refs)}))
    return records


def check_frames(frames: tuple[int, int] | None, session: Session) -> None:
    """Raise RequestError unless the range lies in the session."""
    count = session.sizes["frame"]
    if frames is not None and not 0 <= frames[0] < frames[1] <= count:
        raise RequestError(f"--frames {frames[0]}:{frames[1]}: session '{session.name}' has frames 0:{count}")

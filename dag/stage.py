"""What a stage says of itself: the contract that each file in `stages/` fills in.

A stage is a pure kernel plus a declaration. Only four kinds of thing reach a kernel: its inputs, the facts
of the session that it asks for, calibration items, and its parameters; all four are in the block's key.

Arrays travel in *blocks*. `blocks` names the dimensions of the output along which one task computes one
index; every other dimension is whole within a task. How a block maps to its inputs:

    each    the block of the same index (dimensions that the two share)
    group   a set of input blocks chosen from the labels alone: the illuminations of one capture, the
            sub-sequence of one tracking frame (`Stage.groups` chooses)
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict

from lightstage.kernels.errors import KernelError


class StageError(KernelError):
    """A kernel or declaration refuses: one sentence that says what was wrong and what would be right."""


class Params(BaseModel):
    """Parameters of a stage: frozen, typed, every field with a default, a unit in its name and a description."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


@dataclass(frozen=True)
class Grid:
    """The shape and labels of what a node puts out, known before anything is computed."""

    sizes: Mapping[str, int]
    """Length of every dimension, in order."""
    labels: Mapping[str, tuple[tuple[str, ...], Sequence[Any]]]
    """Coordinates: name to (dimensions, values)."""
    attrs: Mapping[str, Any] = field(default_factory=dict)
    arrays: frozenset[str] = frozenset()
    """The arrays that the node makes with its parameters; the engine fills this in for the nodes below."""

    def along(self, name: str) -> Sequence[Any]:
        """The values of a coordinate."""
        return self.labels[name][1]


@dataclass(frozen=True)
class Input:
    """One array that a kernel reads."""

    array: str
    """Name of the array in the node above."""
    dims: tuple[str, ...]
    """Its dimensions. `a|b` means that either may stand there."""
    how: Literal["each", "group"] = "each"
    source: int = 0
    """Which of the nodes in `from`."""
    instead: "Input | None" = None
    """What is read where the node above puts out no such array."""
    optional: bool = False
    """Whether the node above may make no such array; the kernel then gets an empty sequence. For `group`."""

    def of(self, arrays: Collection[str]) -> "Input":
        """This input, or the one instead, whichever the arrays of the node above hold."""
        return self.instead if self.instead is not None and self.array not in arrays else self


@dataclass(frozen=True)
class Output:
    """One array that a kernel writes; `whole` are the dimensions that lie within one chunk."""

    dims: tuple[str, ...]
    dtype: str
    whole: tuple[str, ...] = ("y", "x")
    attrs: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Needs:
    """A kind of calibration item that a stage reads."""

    required: bool = False
    why: str = ""
    """What cannot be done without it."""


@dataclass(frozen=True)
class Group:
    """One output block of a stage that groups: which input indices it reads, and what they are called."""

    reads: Mapping[str, Sequence[Mapping[str, int]]]
    """Per input: the pieces that the kernel gets, in order; a piece is the array at these indices (dimension ->
    index), whole along the others. The kernel gets a sequence that reads a piece when it is asked for it."""
    labels: Mapping[str, Any] = field(default_factory=dict)
    """What the kernel is told of this block (goes into `context`)."""


@dataclass(frozen=True)
class Arrangement:
    """The output of a stage for one session: its grid, and its blocks in C order."""

    grid: Grid
    groups: tuple[Group, ...] = ()
    """One per block, for stages that group; empty for `each`."""
    dims: Mapping[str, str] = field(default_factory=dict)
    """Declared dimension -> the one that this session has, where a declaration leaves it open (`a|b`)."""
    blocks: tuple[str, ...] | None = None
    """The block dimensions, where parameters make them others than the stage's."""
    outputs: frozenset[str] | None = None
    """The declared outputs that these parameters make; None: all."""


@dataclass(frozen=True)
class CalibrationPicture:
    """A picture of a calibration item, or the session's mask, by its content; `prepare` loads the pixels."""

    digest: str
    load: Callable[[], Any] = field(compare=False, repr=False)


Items = Mapping[str, Mapping[str, Any]]
"""Calibration items by kind: their values, and `pictures` by camera where the kind has them."""


@dataclass(frozen=True)
class Result:
    """A result as `item` and `verdict` read it: one block's arrays."""

    arrays: Mapping[str, Any]
    labels: Mapping[str, Sequence[Any]]
    attrs: Mapping[str, Any]
    facts: Mapping[str, Any]
    """The session's."""
    items: Mapping[str, Mapping[str, Any]]
    """Values of the items that are bound."""


class Finding(NamedTuple):
    """What somebody who acts on a result should know."""

    severity: Literal["good", "doubtful", "bad"]
    """good: as it should be, or a plain number; doubtful: usable, look at it; bad: do not use it as it is."""
    sentence: str


@dataclass(frozen=True)
class Stage:
    """A node type.

    arrange(grids, facts, params) gives the output's grid from the inputs' grids. It sees labels, never pixels.

    context(labels, facts, items, params) gives the part of facts and calibration that one block reads: plain
    data and CalibrationPicture. It enters the block's key and nothing else of them does, so it must be as
    small as it can be.

    prepare(**context) turns a context into keyword arguments of the kernel. It is called once per distinct
    context and process, so what is costly and the same for all frames belongs there. Without it the context
    is passed as it is.

    kernel(**inputs, **prepared, **parameters) returns a mapping of output arrays, and may add `stats`, a
    mapping of numbers that are averaged into the result's attributes, and `warnings`, sentences that whoever runs
    it should read.
    """

    name: str
    version: int
    summary: str
    params: type[Params]
    outputs: Mapping[str, Output]
    blocks: tuple[str, ...]
    arrange: Callable[[Sequence[Grid], Mapping[str, Any], Any], Arrangement]
    kernel: Callable[..., Mapping[str, Any]] | None = None
    inputs: Mapping[str, Input] = field(default_factory=dict)
    calibration: Mapping[str, Needs] = field(default_factory=dict)
    context: Callable[[Mapping[str, Any], Mapping[str, Any], Items, Any], Mapping[str, Any]] | None = None
    prepare: Callable[..., Mapping[str, Any]] | None = None
    prepared: tuple[str, ...] = ()
    """The names that `context` (or `prepare`, when there is one) gives to the kernel."""
    item: Callable[[Result], Mapping[str, Any]] | None = None
    """The calibration item that a result is; an entry that is an array (y, x) is one of its pictures."""
    verdict: Callable[[Result], list[Finding]] | None = None
    """What somebody who acts on the result should know."""

    remarks: tuple[str, ...] = ()
    """The attributes of its result that a run shows, in this order."""
    doubts: Mapping[str, str] = field(default_factory=dict)
    """What a run warns of where an attribute that is true or not for each block (1 or 0) is not 1 for all."""

    @property
    def is_source(self) -> bool:
        """Whether the stage brings in a session instead of computing."""
        return self.kernel is None

    @property
    def sources(self) -> int:
        """How many nodes `from` must name."""
        return 1 + max((spec.source for spec in self.inputs.values()), default=-1)

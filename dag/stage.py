"""What a stage says of itself: the contract that each file in `stages/` fills in.

A stage is a declaration: what it reads, its parameters, how its blocks map, and the *names* of the functions that
compute (`package.module:function`). So a plan, `status` and `why` load no numerics; the process that computes does.
Only four kinds of thing reach a kernel: its inputs, the facts of the session that it asks for, calibration items,
and its parameters; all four are in the block's key.

Arrays travel in *blocks*. `blocks` names the dimensions of the output along which one task computes one
index; every other dimension is whole within a task. How a block maps to its inputs:

    each    the block of the same index (dimensions that the two share)
    group   a set of input blocks chosen from the labels alone: the illuminations of one capture, the
            sub-sequence of one tracking frame (`Stage.arrange` chooses, and names each piece)
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from inspect import signature
from typing import Any, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict


class StageError(ValueError):
    """A declaration refuses: one sentence that says what was wrong and what would be right.

    Kernels have an error of their own; what has a `sentence` is reported as the stage's refusal.
    """

    @property
    def sentence(self) -> str:
        """What is told to people."""
        return str(self)


def refusal(error: Exception) -> str | None:
    """The sentence by which a declaration or a kernel refuses; None of an error that is nobody's intention."""
    sentence = getattr(error, "sentence", None)
    return sentence if isinstance(sentence, str) else None


class Params(BaseModel):
    """Parameters of a stage: frozen, typed, every field with a default, a unit in its name and a description."""

    # what is built is built when something is read: a plan needs the parameters of few stages
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)


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
    optional: bool = False
    """Whether the node above may make no such array; the kernel then gets no pieces. For `group`."""


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


Name = str | int | float | tuple[str | int | float, ...]
"""What a piece is called: an illumination, a band and an illumination, ..."""


@dataclass(frozen=True)
class Group:
    """One output block of a stage that groups: which input indices it reads, and what they are called."""

    reads: Mapping[str, Mapping[Name, Mapping[str, int]]]
    """Per input: the pieces that the kernel gets, by name; a piece is the array at these indices (dimension ->
    index), whole along the others. The kernel gets a mapping that reads a piece when it is asked for it."""
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
    """A result as `item` and `verdict` read it: one block's arrays. They get those of its fields that they name."""

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

    arrange(grids, facts, params) gives the output's grid from the inputs' grids. It sees labels, never pixels;
    `facts` are the session's, with its `shape`, its `mask`, and `items`, the values of those that are bound.

    context(labels, facts, items, params) gives the part of facts and calibration that one block reads: plain
    data and CalibrationPicture. It enters the block's key and nothing else of them does, so it must be as
    small as it can be.

    The others are named, `package.module:function`, and loaded where something is computed:

    prepare(**context) turns a context into keyword arguments of the kernel. It is called once per distinct
    context and process, so what is costly and the same for all frames belongs there. Without it the context
    is passed as it is.

    kernel(**inputs, **prepared, **parameters) returns a mapping of output arrays, and may add `stats`, a
    mapping of numbers that are averaged into the result's attributes, and `warnings`, sentences that whoever runs
    it should read.

    item(**result) gives the calibration item that a result is; an entry that is an array (y, x) is one of its
    pictures. verdict(**result) gives what somebody who acts on the result should know: pairs of a severity and a
    sentence. Both get the fields of `Result` that they name.
    """

    name: str
    version: int
    summary: str
    params: type[Params]
    outputs: Mapping[str, Output]
    blocks: tuple[str, ...]
    arrange: Callable[[Sequence[Grid], Mapping[str, Any], Any], Arrangement]
    kernel: str | None = None
    inputs: Mapping[str, Input] = field(default_factory=dict)
    calibration: Mapping[str, Needs] = field(default_factory=dict)
    context: Callable[[Mapping[str, Any], Mapping[str, Any], Items, Any], Mapping[str, Any]] | None = None
    prepare: str | None = None
    prepared: tuple[str, ...] = ()
    """The names that `context` (or `prepare`, when there is one) gives to the kernel."""
    item: str | None = None
    verdict: str | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    """Of coordinates that the stage brings in."""
    places: Mapping[str, Callable[[int, Mapping[str, Any]], str]] = field(default_factory=dict)
    """How an index along a dimension that the stage brings in is called, from it and the labels there."""
    remarks: tuple[str, ...] = ()
    """The attributes of its result that a run shows, in this order."""

    @property
    def is_source(self) -> bool:
        """Whether the stage brings in a session instead of computing."""
        return self.kernel is None

    @property
    def sources(self) -> int:
        """How many nodes `from` must name."""
        return 1 + max((spec.source for spec in self.inputs.values()), default=-1)

    @property
    def modules(self) -> list[str]:
        """The modules of the functions that it names."""
        named = (self.kernel, self.prepare, self.item, self.verdict)
        return list(dict.fromkeys(name.partition(":")[0] for name in named if name is not None))


def function(name: str) -> Callable[..., Any]:
    """The function of a name `package.module:function`."""
    module, _, attribute = name.partition(":")
    callee: Callable[..., Any] = getattr(import_module(module), attribute)
    return callee


def evaluate(name: str, result: Result) -> Any:
    """What a named function says of a result: it gets those fields of the result that it names."""
    judge = function(name)
    return judge(**{field: getattr(result, field) for field in signature(judge).parameters})

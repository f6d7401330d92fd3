"""YAML with positions: every value knows its line and column, and a model says what is wrong with it.

Reads the core schema of YAML 1.2 (so `1e-3` is a number and `no` is text), refuses duplicate keys, tags, anchors
and aliases, and turns a sequence into a tuple. `check` validates against a pydantic model and reports everything
that is wrong at once, one line each: `file:line:column: what was found, and what would be right`.

Whoever wrote the file, it costs little: the parser's events are taken one by one and nothing is composed, so that
size, depth and number of values are limited as they are met. Numbers are finite and no larger than LARGEST, so that
nobody further on has to think of an overflow.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import yaml

from lightstage.store.digest import digest_bytes
from lightstage.store.errors import MOST_PROBLEMS, RequestError, raise_all
from lightstage.store.intake import FileError, read_regular

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

Where = tuple[str | int, ...]
Model = TypeVar("Model", bound="BaseModel")

MOST_BYTES = 10_000_000
"""A capture of 10,000 frames needs 1 MB, an item of 20,000 lights 4 MB."""
MOST_DEPTH = 64
"""Ours are 6 deep."""
MOST_VALUES = 500_000
"""20,000 lights with all that a light can say are 260,000."""
LARGEST = 1e15
"""In size, of a number: far beyond every millimetre and count, and its cube is still finite."""
_SHOWN = 60
"""Characters of a text that a message repeats."""
_LISTED = 40
"""Names that a message lists."""
_COMPARED = 1000
"""Names that a misspelt one is held against."""

_NULL = re.compile(r"~|null|Null|NULL|")
_BOOL = re.compile(r"true|True|TRUE|false|False|FALSE")
_INT = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")


@dataclass(frozen=True)
class Document:
    """What a YAML file holds, and where each part of it stands."""

    name: str
    value: Any
    marks: Mapping[Where, tuple[int, int]] = field(repr=False)
    text: str = field(default="", repr=False)
    """The file, as it was read."""

    @property
    def digest(self) -> str:
        """Of the text."""
        return digest_bytes(self.text.encode())

    def at(self, where: Where) -> str:
        """`file:line:column` of a value, or of the nearest thing around it that has a place."""
        while where not in self.marks and where:
            where = where[:-1]
        line, column = self.marks.get(where, (1, 1))
        return f"{self.name}:{line}:{column}"


def load(path: Path, *, what: str) -> Document:
    """Read a YAML file.

    Raises:
        RequestError: the file is missing, cannot be read, is larger than MOST_BYTES, is not UTF-8, or is not YAML.
    """
    try:
        data = read_regular(path, MOST_BYTES)
    except FileError as error:
        raise RequestError(f"{short(path)} {error}: expected {what}") from None
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise RequestError(f"{path} cannot be read as text: expected {what} ({error})") from None
    return parse(text, name=str(path))


def parse(text: str, *, name: str) -> Document:
    """The same from text; `name` stands in messages.

    Raises:
        RequestError: it is not YAML, or holds what is refused here.
    """
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        builder = _Builder(name)
        for event in yaml.parse(text, Loader=loader):
            builder.take(event)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{name}:{mark.line + 1}:{mark.column + 1}" if mark else name
        raise RequestError(f"{place}: not valid YAML: {error.problem}") from None
    except (yaml.YAMLError, UnicodeError) as error:
        raise RequestError(f"{name}: not valid YAML: {' '.join(str(error).split())}") from None
    raise_all(builder.problems)
    return Document(name, builder.value, builder.marks, text)


def scalar(text: str) -> Any:
    """The value of one plain scalar, as in `--set node.param=value`; a flow sequence or mapping works too."""
    return parse(text, name="value").value


def text_of(value: Any) -> str:
    """A value as YAML that `parse` reads: written out, also where the same object stands in it twice."""
    text: str = yaml.dump(value, Dumper=_Plain, sort_keys=False, default_flow_style=None, width=110)
    return text


class _Plain(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True


def short(value: object) -> str:
    """As a message shows it: the beginning of what is long."""
    text = str(value)
    return text if len(text) <= 4 * _SHOWN else f"{text[:_SHOWN]}... ({len(text)} characters)"


@dataclass
class _Open:
    """A sequence or mapping whose end has not come yet."""

    where: Where
    value: Any
    """A list or a dict; None for what stands as a key, where nothing may be open."""
    key: str | None = None
    """Of a mapping, the key whose value comes next."""


class _Builder:
    """Makes the value from the parser's events, and keeps where everything stood."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.value: Any = None
        self.marks: dict[Where, tuple[int, int]] = {}
        self.problems: list[str] = []
        self._open: list[_Open] = []
        self._count = 0
        self._documents = 0

    def take(self, event: Any) -> None:
        """The next event.

        Raises:
            RequestError: it is one too many, or one level too deep; what follows is not worth reading.
        """
        if isinstance(event, yaml.ScalarEvent):
            self._refuse_names(event)
            self._scalar(event)
        elif isinstance(event, yaml.CollectionStartEvent):
            self._refuse_names(event)
            self._start(event)
        elif isinstance(event, yaml.CollectionEndEvent):
            self._end()
        elif isinstance(event, yaml.AliasEvent):
            raise RequestError(
                f"{self._place(event)}: the alias *{short(event.anchor)} is not read here; {_WRITE_OUT}"
            )
        elif isinstance(event, yaml.DocumentStartEvent):
            self._documents += 1
            if self._documents > 1:
                raise RequestError(f"{self._place(event)}: a second document begins; one is expected")

    def _place(self, event: Any) -> str:
        return f"{self.name}:{event.start_mark.line + 1}:{event.start_mark.column + 1}"

    def _problem(self, event: Any, text: str) -> None:
        self.problems.append(f"{self._place(event)}: {text}")
        if len(self.problems) == MOST_PROBLEMS:
            raise RequestError("\n".join([*self.problems, "... and perhaps more"]))

    def _refuse_names(self, event: Any) -> None:
        if event.anchor is not None:
            raise RequestError(
                f"{self._place(event)}: the anchor &{short(event.anchor)} is not read here; {_WRITE_OUT}"
            )
        if event.tag is not None:
            self._problem(event, f"the tag {short(event.tag)} is not known; plain YAML is expected")

    def _scalar(self, event: Any) -> None:
        around = self._open[-1] if self._open else None
        text = str(event.value)
        if "\0" in text:
            self._problem(event, "text with a NUL character, which nothing here can have")
        if around is not None and isinstance(around.value, dict) and around.key is None:
            if text in around.value:
                self._problem(event, f"'{short(text)}' stands twice here; keep one")
            around.key = text
            self._mark((*around.where, text), event)
            return
        value: Any = text
        if event.style in (None, ""):
            try:
                value = _plain(text)
            except ValueError as error:
                self._problem(event, str(error))
        self._put(value, event)

    def _start(self, event: Any) -> None:
        if len(self._open) == MOST_DEPTH:
            raise RequestError(
                f"{self._place(event)}: lists and keys lie more than {MOST_DEPTH} deep in each other"
            )
        around = self._open[-1] if self._open else None
        if around is not None and isinstance(around.value, dict) and around.key is None:
            raise RequestError(f"{self._place(event)}: a key must be plain text")
        value: Any = [] if isinstance(event, yaml.SequenceStartEvent) else {}
        self._open.append(_Open(self._put(value, event), value))

    def _end(self) -> None:
        done = self._open.pop()
        if isinstance(done.value, list):
            value = tuple(done.value)
            if self._open:
                self._open[-1].value[done.where[-1]] = value
            else:
                self.value = value

    def _put(self, value: Any, event: Any) -> Where:
        """A value into what is open; returns where it is."""
        self._count += 1
        if self._count > MOST_VALUES:
            raise RequestError(f"{self._place(event)}: more than {MOST_VALUES:,} values in one file")
        where: Where = ()
        if not self._open:
            self.value = value
        elif isinstance((around := self._open[-1]).value, list):
            where = (*around.where, len(around.value))
            around.value.append(value)
        else:
            assert around.key is not None
            where = (*around.where, around.key)
            around.value[around.key] = value
            around.key = None
        self._mark(where, event)
        return where

    def _mark(self, where: Where, event: Any) -> None:
        # a key is marked before its value, and is what a person looks for
        self.marks.setdefault(where, (event.start_mark.line + 1, event.start_mark.column + 1))


_WRITE_OUT = "write out what it stands for"


def _plain(text: str) -> Any:
    """What an unquoted scalar means.

    Raises:
        ValueError: a number that is too large.
    """
    if _NULL.fullmatch(text):
        return None
    if _BOOL.fullmatch(text):
        return text.lower() == "true"
    number: int | float
    if _INT.fullmatch(text):
        # the digits are counted first, because int() refuses thousands of them
        digits = text.lstrip("+-0") or "0"
        number = int(digits) if len(digits) <= 16 else LARGEST * 10
        number = -number if text.startswith("-") else number
    elif _FLOAT.fullmatch(text):
        number = float(text)
    else:
        return text
    if abs(number) > LARGEST:
        raise ValueError(f"the number {short(text)} is larger than {LARGEST:g}, which is the most")
    return number


def check(document: Document, model: type[Model], *, where: Where = ()) -> Model:
    """Validate a document, or the part of it at `where`, against a model.

    Raises:
        RequestError: one line for everything that is wrong.
    """
    from pydantic import ValidationError

    value = document.value
    for step in where:
        value = value[step]
    if not isinstance(value, dict):
        content = "nothing" if value is None else short(repr(value))
        raise RequestError(f"{document.at(where)}: expected keys with values, found {content}")
    try:
        return model.model_validate(value)
    except ValidationError as error:
        lines = [f"{document.at((*where, *at))}: {text}" for at, text in problems(error, model, value)]
    raise RequestError("\n".join(dict.fromkeys(lines)))


def problems(error: "ValidationError", model: "type[BaseModel]", value: Any) -> list[tuple[Where, str]]:
    """What pydantic found wrong with a value, and where in it; no more than a person would read."""
    # the errors of a union come in a location of branches that nobody has written
    listed: list[dict[str, Any]] = [dict(problem) for problem in error.errors(include_url=False)]
    placed = [(_written(problem, value), problem) for problem in listed]
    deeper = {problem["loc"][: i + 1] for _, problem in placed for i in range(len(problem["loc"]) - 1)}
    # a list whose element is wrong is also "too short", which nobody needs to hear
    placed = [(at, p) for at, p in placed if not (p["type"] == "too_short" and p["loc"] in deeper)]
    sentences = [
        sentence for at, problem in placed[:MOST_PROBLEMS] for sentence in _sentences(model, value, at, problem)
    ]
    if len(placed) > MOST_PROBLEMS:
        sentences.append(((), f"... and {len(placed) - MOST_PROBLEMS} more problems"))
    return sentences


def _written(problem: Mapping[str, Any], value: Any) -> Where:
    """Of a problem's location the keys and indices that stand in the value, which lead to what is wrong there.

    A location also names the branches of unions (`str`, `tuple[str, ...]`, a target's kind), and a key may have the
    name of one: of the ways to read it, the one that leads to the object that pydantic complains of is right.
    """
    steps: Where = tuple(problem["loc"])
    last: Where = ()
    if problem["type"] == "missing":
        steps, last = steps[:-1], steps[-1:]
    ways = list(_ways(steps, value))
    right = [way for way, end in ways if end is problem.get("input")] or [way for way, _ in ways]
    return (*max(right, key=len), *last)


def _ways(steps: Where, value: Any) -> Iterator[tuple[Where, Any]]:
    """Every reading of a location, and what it leads to."""
    if not steps:
        yield (), value
        return
    step, rest = steps[0], steps[1:]
    if _holds(value, step):
        for way, end in _ways(rest, value[step]):
            yield (step, *way), end
    if isinstance(step, str):
        yield from _ways(rest, value)


def _holds(value: Any, step: str | int) -> bool:
    if isinstance(value, tuple):
        return isinstance(step, int) and step < len(value)
    return isinstance(value, dict) and step in value


_PLAIN_WORDS = {
    "tuple_type": "a list is expected",
    "list_type": "a list is expected",
    "dict_type": "keys with values are expected",
    "model_type": "keys with values are expected",
    "model_attributes_type": "keys with values are expected",
    "string_type": "text is expected",
    "int_type": "a whole number is expected",
    "float_type": "a number is expected",
    "bool_type": "true or false is expected",
    "union_tag_not_found": "keys with values are expected, among them 'kind'",
    "too_short": "too few entries",
    "too_long": "too many entries",
}


def _sentences(
    model: "type[BaseModel]", value: Any, location: Where, problem: Mapping[str, Any]
) -> Iterator[tuple[Where, str]]:
    """One of pydantic's errors as a sentence; a model's own check may say several."""
    name = ".".join(short(step) for step in location)
    kind, content = problem["type"], problem.get("input")
    if kind == "extra_forbidden":
        last = str(location[-1])
        known = _fields(model, value, location[:-1])
        yield location, f"unknown key '{short(last)}'{nearest(last, known)}"
        return
    if kind == "missing":
        description = _fields(model, value, location[:-1]).get(str(location[-1]))
        yield location, f"'{name}' is missing" + (f": {description}" if description else "")
        return
    if kind == "value_error":
        lines = str(problem["msg"]).removeprefix("Value error, ").splitlines()
        if location and location[-1] in _fields(model, value, location[:-1]):
            yield from ((location, f"{name}: {line}") for line in lines)
        else:
            # a check over several keys says itself which one is wrong
            yield from (((*location, line.split(":")[0]), line) for line in lines)
        return
    message = _PLAIN_WORDS.get(kind, str(problem["msg"][0]).lower() + str(problem["msg"])[1:])
    message = message.removeprefix("input ")
    hint = ""
    if kind == "literal_error" and isinstance(content, str):
        options = re.findall(r"'([^']*)'", message)
        hint = nearest(content, options) if len(options) > 1 else ""
        hint = hint if hint.startswith("; did") else ""
    shown = f", found {short(repr(content))}" if not isinstance(content, dict | tuple) else ""
    yield location, f"{name + ': ' if name else ''}{message}{shown}{hint}"


def nearest(word: str, known: Iterable[str]) -> str:
    """`; did you mean 'x'?`, or the list of what is known."""
    import difflib

    options = sorted(set(known))
    close = difflib.get_close_matches(word[:_SHOWN], options[:_COMPARED], n=1, cutoff=0.5)
    if close:
        return f"; did you mean '{close[0]}'?"
    more = f" and {len(options) - _LISTED} more" if len(options) > _LISTED else ""
    return f"; known are {', '.join(options[:_LISTED])}{more}" if options else ""


def _fields(model: Any, value: Any, location: Where) -> Mapping[str, str]:
    """The keys that may stand at a place, each with its description; none where the place is no model's."""
    kinds = [model]
    for step in location:
        kinds = [
            inner for kind in _fitting(kinds, value) for deeper in _within(kind, step) for inner in _members(deeper)
        ]
        value = value[step] if _holds(value, step) else None
    return {
        info.alias or name: info.description or ""
        for kind in _fitting(kinds, value)
        if _is_model(kind)
        for name, info in kind.model_fields.items()
    }


def _members(annotation: Any) -> Sequence[Any]:
    """The members of a union; what is no union is its own."""
    if get_origin(annotation) is Annotated:
        return _members(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return [inner for member in get_args(annotation) for inner in _members(member)]
    return [annotation]


def _within(kind: Any, step: str | int) -> Iterator[Any]:
    """What a type says of the value at a key or an index of it."""
    if _is_model(kind):
        yield from (info.annotation for name, info in kind.model_fields.items() if step in (name, info.alias))
    elif get_origin(kind) is dict:
        yield get_args(kind)[1]
    elif get_origin(kind) in (tuple, list):
        yield get_args(kind)[0]


def _fitting(kinds: Sequence[Any], value: Any) -> Sequence[Any]:
    """Of several models those whose telling words (`kind: dark`) are the value's, or all where none is."""

    def fits(kind: Any) -> bool:
        fields = kind.model_fields.items() if _is_model(kind) and isinstance(value, dict) else ()
        words = {name: get_args(info.annotation) for name, info in fields if get_origin(info.annotation) is Literal}
        return all(value[name] in known for name, known in words.items() if name in value)

    return [kind for kind in kinds if fits(kind)] or kinds


def _is_model(kind: Any) -> bool:
    from pydantic import BaseModel

    return isinstance(kind, type) and issubclass(kind, BaseModel)

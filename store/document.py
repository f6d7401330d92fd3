"""YAML with positions: every value knows its line and column, and a model says what is wrong with it.

Reads the core schema of YAML 1.2 (so `1e-3` is a number and `no` is text), refuses duplicate keys and
tags, and turns a sequence into a tuple. `check` validates against a pydantic model and reports everything
that is wrong at once, one line each: `file:line:column: what was found, and what would be right`.
"""

import difflib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import yaml

from store.digest import digest_bytes
from store.errors import RequestError

if TYPE_CHECKING:
    from pydantic import BaseModel

Where = tuple[str | int, ...]
Model = TypeVar("Model", bound="BaseModel")

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
    digest: str = ""
    """Of the text."""

    def at(self, where: Where) -> str:
        """`file:line:column` of a value, or of the nearest thing around it that has a place."""
        while where not in self.marks and where:
            where = where[:-1]
        line, column = self.marks.get(where, (1, 1))
        return f"{self.name}:{line}:{column}"


def load(path: Path, *, what: str) -> Document:
    """Read a YAML file.

    Raises:
        RequestError: the file is missing, is not UTF-8, or is not YAML.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise RequestError(f"{path} is missing: expected {what}") from None
    except (UnicodeDecodeError, IsADirectoryError) as error:
        raise RequestError(f"{path} cannot be read as text: expected {what} ({error})") from None
    return parse(text, name=str(path))


def parse(text: str, *, name: str) -> Document:
    """The same from text; `name` stands in messages."""
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        root = yaml.compose(text, Loader=loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{name}:{mark.line + 1}:{mark.column + 1}" if mark else name
        raise RequestError(f"{place}: not valid YAML: {error.problem}") from None
    except yaml.YAMLError as error:
        raise RequestError(f"{name}: not valid YAML: {error}") from None
    marks: dict[Where, tuple[int, int]] = {}
    problems: list[str] = []
    value = None if root is None else _construct(root, (), marks, problems, name)
    if problems:
        raise RequestError("\n".join(problems))
    return Document(name, value, marks, digest_bytes(text.encode()))


def scalar(text: str) -> Any:
    """The value of one plain scalar, as in `--set node.param=value`; a flow sequence or mapping works too."""
    return parse(text, name="value").value


def _construct(node: Any, where: Where, marks: dict[Where, tuple[int, int]], problems: list[str], name: str) -> Any:
    marks.setdefault(where, (node.start_mark.line + 1, node.start_mark.column + 1))
    place = f"{name}:{node.start_mark.line + 1}:{node.start_mark.column + 1}"
    if isinstance(node, yaml.SequenceNode):
        return tuple(_construct(item, (*where, i), marks, problems, name) for i, item in enumerate(node.value))
    if isinstance(node, yaml.MappingNode):
        result: dict[Any, Any] = {}
        for key_node, value_node in node.value:
            key = _scalar(key_node) if isinstance(key_node, yaml.ScalarNode) else None
            spot = f"{name}:{key_node.start_mark.line + 1}:{key_node.start_mark.column + 1}"
            if not isinstance(key_node, yaml.ScalarNode):
                problems.append(f"{spot}: a key must be plain text")
                continue
            key = key if isinstance(key, str) else str(key_node.value)
            if key in result:
                problems.append(f"{spot}: '{key}' stands twice here; keep one")
            marks[(*where, key)] = (key_node.start_mark.line + 1, key_node.start_mark.column + 1)
            result[key] = _construct(value_node, (*where, key), marks, problems, name)
        return result
    if node.tag.startswith("!"):
        problems.append(f"{place}: the tag {node.tag} is not known; plain YAML is expected")
    return _scalar(node)


def _scalar(node: yaml.ScalarNode) -> Any:
    text = str(node.value)
    if node.style in ("'", '"', "|", ">"):
        return text
    if _NULL.fullmatch(text):
        return None
    if _BOOL.fullmatch(text):
        return text.lower() == "true"
    if _INT.fullmatch(text):
        return int(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    return text


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
        found = "nothing" if value is None else repr(value)
        raise RequestError(f"{document.at(where)}: expected keys with values, found {found}")
    try:
        return model.model_validate(value)
    except ValidationError as error:
        problems: list[dict[str, Any]] = [dict(problem) for problem in error.errors()]
        deeper = {problem["loc"][: i + 1] for problem in problems for i in range(len(problem["loc"]) - 1)}
        # a list whose element is wrong is also "too short", which nobody needs to hear
        problems = [p for p in problems if not (p["type"] == "too_short" and p["loc"] in deeper)]
        lines = [line for problem in problems for line in sentence(document, model, where, problem).splitlines()]
        raise RequestError("\n".join(dict.fromkeys(lines))) from None


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
    "too_short": "too few entries",
    "too_long": "too many entries",
}


def sentence(document: Document, model: "type[BaseModel]", where: Where, problem: Mapping[str, Any]) -> str:
    """One of pydantic's errors as `file:line:column: ...`; a model's own check may say several, a line each."""
    # pydantic names the branch of a union in the location; a person has not written it
    location = tuple(s for s in problem["loc"] if not (isinstance(s, str) and (s in _BRANCHES or "[" in s)))
    place = document.at((*where, *location))
    name = ".".join(str(step) for step in location)
    kind, found = problem["type"], problem.get("input")
    if kind == "extra_forbidden":
        known = _fields(model, location[:-1])
        return f"{place}: unknown key '{location[-1]}'{nearest(str(location[-1]), known)}"
    if kind == "missing":
        description = _description(model, location)
        return f"{place}: '{name}' is missing" + (f": {description}" if description else "")
    if kind == "value_error":
        lines = str(problem["msg"]).removeprefix("Value error, ").splitlines()
        if location and location[-1] in _fields(model, location[:-1]):
            return "\n".join(f"{place}: {name}: {line}" for line in lines)
        # a check over several keys says itself which one is wrong
        return "\n".join(f"{document.at((*where, *location, line.split(':')[0]))}: {line}" for line in lines)
    message = _PLAIN_WORDS.get(kind, str(problem["msg"][0]).lower() + str(problem["msg"])[1:])
    message = message.removeprefix("input ")
    hint = ""
    if kind == "literal_error" and isinstance(found, str):
        options = re.findall(r"'([^']*)'", message)
        hint = nearest(found, options) if len(options) > 1 else ""
        hint = hint if hint.startswith("; did") else ""
    shown = f", found {found!r}" if not isinstance(found, dict | tuple) else ""
    return f"{place}: {name + ': ' if name else ''}{message}{shown}{hint}"


_BRANCHES = ("str", "int", "float", "bool", "mirror_ball", "checkerboard", "dark", "flat", "white")


def nearest(word: str, known: Iterable[str]) -> str:
    """`; did you mean 'x'?`, or the list of what is known."""
    options = sorted(set(known))
    close = difflib.get_close_matches(word, options, n=1, cutoff=0.5)
    if close:
        return f"; did you mean '{close[0]}'?"
    return f"; known are {', '.join(options)}" if options else ""


def _submodel(model: Any, location: Where) -> Any:
    from typing import get_args

    from pydantic import BaseModel

    for step in location:
        if not (isinstance(model, type) and issubclass(model, BaseModel)):
            return None
        if not isinstance(step, str) or step not in model.model_fields:
            continue
        pending = [model.model_fields[step].annotation]
        found: Any = None
        while pending and found is None:
            current = pending.pop(0)
            if isinstance(current, type) and issubclass(current, BaseModel):
                found = current
            else:
                pending.extend(get_args(current))
        model = found
    return model


def _fields(model: Any, location: Where) -> list[str]:
    inner = _submodel(model, location)
    if inner is None:
        return []
    return [info.alias or name for name, info in inner.model_fields.items()]


def _description(model: Any, location: Where) -> str:
    inner = _submodel(model, location[:-1])
    if inner is None or location[-1] not in inner.model_fields:
        return ""
    return inner.model_fields[location[-1]].description or ""

"""YAML with positions."""

from pathlib import Path

import pytest
from pydantic import BaseModel, ConfigDict

from lightstage.store.document import check, load, nearest, parse, scalar
from lightstage.store.errors import RequestError


class Inner(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    width_px: int


class Outer(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    name: str
    scale: float = 1.0
    parts: dict[str, Inner] = {}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001),  # PyYAML's own resolver reads this as text
        ("no", "no"),
        ("12:30", "12:30"),
        ("010", 10),
        ("~", None),
        ("true", True),
        ("'1'", "1"),
        ("2010-03-12T14:05:00", "2010-03-12T14:05:00"),
        ("[1, 2.5, Y]", (1, 2.5, "Y")),
    ],
)
def test_scalars_follow_the_core_schema(text: str, value: object) -> None:
    assert scalar(text) == value


def test_all_problems_come_at_once_with_line_and_column() -> None:
    source = parse("nmae: a\nscale: wide\nparts:\n  one: {width_px: 1.5}\n", name="f.yaml")
    with pytest.raises(RequestError) as caught:
        check(source, Outer)
    lines = str(caught.value).splitlines()
    assert any(line.startswith("f.yaml:1:1: unknown key 'nmae'; did you mean 'name'?") for line in lines)
    assert any(line.startswith("f.yaml:2:1: scale:") and "'wide'" in line for line in lines)
    assert any(line.startswith("f.yaml:4:9: parts.one.width_px:") for line in lines)
    assert any("'name' is missing" in line for line in lines)
    assert len(lines) == 4


def test_a_key_that_stands_twice_is_refused_where_it_stands() -> None:
    with pytest.raises(RequestError, match=r"f.yaml:3:1: 'name' stands twice"):
        parse("name: a\nscale: 1\nname: b\n", name="f.yaml")


def test_broken_yaml_names_the_place() -> None:
    with pytest.raises(RequestError, match=r"^f.yaml:2:\d+: not valid YAML"):
        parse("a: [1, 2\nb: 3: 4\n", name="f.yaml")


def test_a_tag_is_refused() -> None:
    with pytest.raises(RequestError, match="the tag !python/object is not known"):
        parse("a: !python/object 1\n", name="f.yaml")


def test_a_missing_file_says_what_was_expected(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match=r"nothing.yaml is missing: expected a pipeline"):
        load(tmp_path / "nothing.yaml", what="a pipeline")


def test_nearest_falls_back_to_the_list() -> None:
    assert nearest("qqq", ["a", "b"]) == "; known are a, b"
    assert nearest("metod", ["method", "base"]) == "; did you mean 'method'?"

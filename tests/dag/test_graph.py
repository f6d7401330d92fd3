"""pipeline.yaml: every mistake in one sentence with file, line, column, and the nearest name; all at once."""

from pathlib import Path

import pytest

from lightstage.dag.graph import load_graph
from lightstage.stages import TABLE
from lightstage.store.errors import RequestError

GOOD = """\
stages:
  capture:  {uses: capture}
  register: {uses: register, from: capture}
  split:    {uses: split, from: register}
  stack:    {uses: stack, from: split}
  align:    {uses: align, from: stack}
  normals:  {uses: normals, from: align, params: {method: ratio}}
"""


def refused(tmp_path: Path, text: str, *overrides: str) -> list[str]:
    path = tmp_path / "pipeline.yaml"
    path.write_text(text)
    with pytest.raises(RequestError) as caught:
        load_graph(path, TABLE, overrides=overrides)
    return [line.replace(str(path), "p") for line in str(caught.value).splitlines()]


def test_a_good_one_is_ordered_whatever_the_order_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    lines = GOOD.splitlines()
    path.write_text("\n".join([lines[0], *reversed(lines[1:])]))
    graph = load_graph(path, TABLE)
    assert list(graph.nodes) == ["capture", "register", "split", "stack", "align", "normals"]
    assert graph.nodes["normals"].params.model_dump()["method"] == "ratio"
    assert graph.with_all_above(["split"]) == ["capture", "register", "split"]


@pytest.mark.parametrize(
    ("old", "new", "start", "parts"),
    [
        ("uses: split", "uses: spilt", "p:4:14:", ["no stage 'spilt'", "did you mean 'split'"]),
        (
            "{method: ratio}",
            "{metod: ratio}",
            "p:7:51:",
            ["unknown key 'metod'", "did you mean 'method'", "normals"],
        ),
        ("ratio}", "ration}", "p:7:51:", ["method", "'ratio'", "'ration'"]),
        ("method: ratio", "fuse: 3", "p:7:51:", ["fuse", "found 3"]),
        ("from: split", "from: splot", "p:5:27:", ["reads 'splot'", "did you mean 'split'"]),
        ("from: split", "from: register", "p:5:27:", ["component", "polarisation"]),
        ("{uses: split, from: register}", "{uses: split}", "p:4:3:", ["names 0 node(s)", "reads 1 node(s)"]),
        ("from: align", "from: register", "p:7:29:", ["array 'aligned'", "signal, valid"]),
        ("from: align,", "form: align,", "p:7:29:", ["unknown key 'form'", "did you mean 'from'"]),
    ],
)
def test_mistakes(tmp_path: Path, old: str, new: str, start: str, parts: list[str]) -> None:
    lines = refused(tmp_path, GOOD.replace(old, new))
    assert any(line.startswith(start) and all(part in line for part in parts) for line in lines), lines


def test_out_of_bounds(tmp_path: Path) -> None:
    text = GOOD.replace(
        "register, from: capture}", "register, from: capture, params: {flat_smoothing_percent: -2}}"
    )
    (line,) = refused(tmp_path, text)
    assert line.startswith("p:3:54: flat_smoothing_percent:")
    assert "greater than 0" in line
    assert "-2" in line


def test_a_circle_is_drawn(tmp_path: Path) -> None:
    lines = refused(tmp_path, GOOD.replace("from: capture", "from: split"))
    assert any("in a circle: register -> split -> register" in line for line in lines)


def test_everything_at_once(tmp_path: Path) -> None:
    text = GOOD.replace("uses: split", "uses: spilt").replace("method: ratio", "metod: 1, base: Q")
    assert len(refused(tmp_path, text)) == 3
    lines = refused(tmp_path, text.replace("stack, from: split", "stack, form: split"))
    assert len(lines) == 4
    assert any("unknown key 'form'" in line for line in lines)


def test_overrides_are_checked_alike(tmp_path: Path) -> None:
    lines = refused(tmp_path, GOOD, "normals.methd=ratio", "nromals.method=ratio", "normals.base=Q", "nonsense")
    assert len(lines) == 4
    assert any("did you mean 'method'" in line for line in lines)
    assert any("no node 'nromals'; did you mean 'normals'" in line for line in lines)
    assert any(line.startswith("--set normals.base=Q:") for line in lines)
    assert any("expected node.parameter=value" in line for line in lines)


def test_the_same_stage_may_stand_twice(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(GOOD + "  normals-wilson: {uses: normals, from: align, params: {method: difference}}\n")
    assert "normals-wilson" in load_graph(path, TABLE).nodes


def test_an_unknown_target_is_named(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(GOOD)
    with pytest.raises(RequestError, match="no node 'normal'; did you mean 'normals'"):
        load_graph(path, TABLE).with_all_above(["normal"])


def test_what_is_computed_when_asked_is_not_computed_unasked(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(
        GOOD + "  relief: {uses: normals, from: align, when: asked}\n  more: {uses: normals, from: align}\n"
    )
    graph = load_graph(path, TABLE)
    assert graph.with_all_above([]) == ["capture", "register", "split", "stack", "align", "normals", "more"]
    assert graph.with_all_above(["relief"]) == ["capture", "register", "split", "stack", "align", "relief"]


def test_when_has_two_words(tmp_path: Path) -> None:
    (line,) = refused(tmp_path, GOOD + "  relief: {uses: normals, from: align, when: ask}\n")
    assert line.startswith("p:8:")
    assert "'always' or 'asked'" in line

"""A request is remembered under what decided its answer, and looked for by all that could."""

import dataclasses
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from lightstage.dag import answer as dag_answer
from lightstage.dag import recall
from lightstage.dag.recall import libraries, snapshot
from lightstage.dag.request import Request
from lightstage.store.root import Store
from tests.conftest import REPOSITORY, Answer
from tests.dag.test_request import OTHER

Lightstage = Callable[..., Answer]


def homography(path: Path, shift: float, note: str = "") -> Path:
    path.write_text(
        f"item: homography\nfrom: CAM0\nto: CAM1\nmatrix: [[1, 0, {shift}], [0, 1, 0], [0, 0, 1]]\n{note}"
    )
    return path


def run(lightstage: Lightstage, *words: str) -> dict[str, Any]:
    done = lightstage("run", "register", "--session", "ball", "--json", *words)
    assert done.code == 0, done.err
    return done.json["nodes"]["register"]


def while_it_begins(
    monkeypatch: pytest.MonkeyPatch, before: Callable[[], Any], after: Callable[[], Any]
) -> Callable[[], None]:
    """Let something happen right before a run reads its files, and be undone right after; returns the end of it."""
    real = dag_answer.lay_out

    def lay_out(*arguments: Any, **more: Any) -> Any:
        before()
        plan = real(*arguments, **more)
        after()
        return plan

    monkeypatch.setattr(dag_answer, "lay_out", lay_out)
    return lambda: monkeypatch.setattr(dag_answer, "lay_out", real)


def test_a_binding_that_was_another_while_a_run_began_lends_nothing(
    lightstage: Lightstage, sphere: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    a, b = homography(tmp_path / "a.yaml", -1.25), homography(tmp_path / "b.yaml", -1.5)
    lightstage("import", sphere)

    def use(item: Path) -> None:
        assert lightstage("calibration", "use", item, "--session", "ball").code == 0

    use(a)
    end = while_it_begins(monkeypatch, lambda: use(b), lambda: use(a))
    of_b = run(lightstage)["path"]
    end()
    assert run(lightstage)["path"] != of_b
    use(b)
    again = run(lightstage)
    assert (again["path"], again["computed"]) == (of_b, 0)


def test_a_pipeline_that_was_another_while_a_run_began_lends_nothing(
    lightstage: Lightstage, sphere: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lightstage("import", sphere)
    text = (REPOSITORY / "pipeline.yaml").read_text()
    other = text.replace("uses: register,", "uses: register, params: {flat_smoothing_percent: 3},")
    assert other != text
    file = tmp_path / "p.yaml"
    file.write_text(text)
    end = while_it_begins(monkeypatch, lambda: file.write_text(other), lambda: file.write_text(text))
    of_other = run(lightstage, "--pipeline", str(file))["path"]
    end()
    assert run(lightstage, "--pipeline", str(file))["path"] != of_other


def test_a_source_that_was_touched_in_between_is_not_remembered(
    lightstage: Lightstage, sphere: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:

    lightstage("import", sphere)
    with monkeypatch.context() as patch:
        patch.setattr(recall, "outdated", lambda _: ["lightstage.stages.register"])
        run(lightstage)
        assert not list((tmp_path / "store" / "cache" / "runs").rglob("*.json"))
    run(lightstage)
    assert len(list((tmp_path / "store" / "cache" / "runs").rglob("*.json"))) == 1


def test_what_was_remembered_is_found_and_notes_of_items_count(
    lightstage: Lightstage, sphere: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lightstage("import", sphere)
    run(lightstage)
    with monkeypatch.context() as patch:
        patch.setattr(dag_answer, "lay_out", None)
        run(lightstage)  # from the record alone

    def key() -> str:
        found = snapshot(Request("ball", REPOSITORY / "pipeline.yaml"), Store(tmp_path / "store"))
        assert found is not None
        return found.key

    before = key()
    (item,) = (tmp_path / "store" / "calibration").glob("homography-*/item.json")
    said = json.loads(item.read_text())
    item.write_text(json.dumps({**said, "notes": {"rig": "leeds"}}))
    assert key() != before


def test_every_field_of_a_request_is_in_its_key(
    lightstage: Lightstage, sphere: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lightstage("import", sphere)
    taken = snapshot(Request("ball", REPOSITORY / "pipeline.yaml"), Store(tmp_path / "store"))
    assert taken is not None

    def key(**changes: Any) -> str:
        return dataclasses.replace(taken, request=dataclasses.replace(taken.request, **changes)).key

    other = {
        "session": "face",
        "nodes": ("normals",),
        **{field: value for field, (_, value) in OTHER.items() if field not in ("pipeline", "items")},
    }
    assert len({taken.key, *(key(**{field: value}) for field, value in other.items())}) == 1 + len(other)
    assert key(pipeline=Path("elsewhere.yaml")) == taken.key  # its text counts
    assert dataclasses.replace(taken, pipeline="another text").key != taken.key
    # items that are given for one request alone are never looked for
    assert snapshot(dataclasses.replace(taken.request, items=OTHER["items"][1]), Store(tmp_path / "store")) is None
    # what is added to a request is in the key without anybody's doing
    grown = dataclasses.make_dataclass("Grown", [("flavour", str)], bases=(Request,), frozen=True, kw_only=True)
    fields = {field.name: getattr(taken.request, field.name) for field in dataclasses.fields(taken.request)}
    keys = {
        dataclasses.replace(taken, request=grown(**fields, flavour=flavour)).key for flavour in ("plain", "fine")
    }
    assert len(keys) == 2
    assert taken.key not in keys


def test_whatever_is_installed_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = libraries()
    (tmp_path / "anything-1.0.dist-info").mkdir()
    monkeypatch.syspath_prepend(str(tmp_path))
    assert set(libraries()) - set(before) == {"anything-1.0.dist-info"}
    assert any(name.startswith("numpy-") for name in before), sys.path

"""A request is remembered under what decided its answer, and looked for by all that could."""

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from lightstage.cli import run as cli_run
from lightstage.cli.run import add_run_options, deciding_options
from lightstage.dag import recall as dag_recall
from lightstage.dag.recall import libraries, request_now
from lightstage.store.root import Store
from tests.conftest import REPOSITORY, Answer

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
    real = cli_run.plan_for

    def plan_for(*arguments: Any, **more: Any) -> Any:
        before()
        plan = real(*arguments, **more)
        after()
        return plan

    monkeypatch.setattr(cli_run, "plan_for", plan_for)
    return lambda: monkeypatch.setattr(cli_run, "plan_for", real)


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
        patch.setattr(dag_recall, "outdated", lambda _: ["lightstage.stages.register"])
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
        patch.setattr(cli_run, "plan_for", None)
        run(lightstage)  # from the record alone

    def key() -> str:
        found = request_now(
            Store(tmp_path / "store"), session="ball", pipeline=REPOSITORY / "pipeline.yaml", options={}
        )
        assert found is not None
        return found.key

    before = key()
    (item,) = (tmp_path / "store" / "calibration").glob("homography-*/item.json")
    said = json.loads(item.read_text())
    item.write_text(json.dumps({**said, "notes": {"rig": "leeds"}}))
    assert key() != before


def test_every_option_of_a_run_decides_but_where_it_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    parser = argparse.ArgumentParser()
    add_run_options(parser)
    plain = vars(parser.parse_args([]))
    undecided = {name for name in plain if name not in deciding_options(argparse.Namespace(**plain))}
    assert undecided == {"workers", "scheduler", "pipeline"}  # of the pipeline the text counts
    real = add_run_options

    def more(parser: argparse.ArgumentParser) -> None:
        real(parser)
        parser.add_argument("--flavour", default="plain")

    monkeypatch.setattr(cli_run, "add_run_options", more)
    assert deciding_options(argparse.Namespace(**plain, flavour="fine"))["flavour"] == "fine"


def test_whatever_is_installed_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = libraries()
    (tmp_path / "anything-1.0.dist-info").mkdir()
    monkeypatch.syspath_prepend(str(tmp_path))
    assert set(libraries()) - set(before) == {"anything-1.0.dist-info"}
    assert any(name.startswith("numpy-") for name in before), sys.path

"""status, why, graph, path: what there is, and why."""

from pathlib import Path

import pytest

from tests.cli.conftest import Lightstage, check_refusal
from tests.scenes import one_camera_capture


def test_path_prints_the_path_and_nothing_else(lightstage: Lightstage, standing: Path) -> None:
    (line,) = lightstage("path", "normals", "--session", "ball", store=standing).out.splitlines()
    assert Path(line).is_dir()
    assert Path(line).parent.joinpath("current").read_text().strip() == Path(line).name


def test_a_node_that_brings_in_the_session_may_have_any_name(lightstage: Lightstage, tmp_path: Path) -> None:
    lightstage("import", one_camera_capture(tmp_path / "c", ["C", "X", "Y", "Z"], session="ball"))
    pipeline = tmp_path / "p.yaml"
    pipeline.write_text("stages:\n  pictures: {uses: capture}\n  clean: {uses: register, from: pictures}\n")
    done = lightstage("path", "pictures", "--session", "ball", "--pipeline", pipeline)
    assert done.out.strip() == str(tmp_path / "store" / "sessions" / "ball" / "raw.zarr")


def test_status_tells_fresh_stale_and_missing(lightstage: Lightstage, standing: Path) -> None:
    def conditions(*words: str) -> dict[str, str]:
        done = lightstage("status", "--session", "ball", *words, "--json", store=standing)
        return {name: node["status"] for name, node in done.json["sessions"]["ball"].items()}

    assert set(conditions().values()) == {"fresh"}
    changed = conditions("--set", "normals.method=ratio")
    assert (changed["align"], changed["normals"]) == ("fresh", "stale")
    head, line = lightstage("status", "--session", "ball", store=standing).out.splitlines()[:2]
    assert head.split() == ["session", "node", "status", "blocks", "size"]
    assert line.split()[:4] == ["ball", "register", "fresh", "7/7"]


def test_a_session_that_cannot_run_is_a_row_among_others(lightstage: Lightstage, sphere: Path) -> None:
    lightstage("import", sphere)
    lightstage("import", sphere, "--session", "again")
    done = lightstage("status", "--frames", "0:9", "--json")
    assert "frames 0:7" in done.json["sessions"]["again"]["error"]
    assert done.code == 0
    check_refusal(lightstage("status", "--frames", "0:9", "--session", "again"), "frames 0:7")


def test_why_names_the_parameter_that_changed(lightstage: Lightstage, standing: Path) -> None:
    words = ("why", "normals", "--session", "ball", "--set", "normals.method=ratio", "--json")
    done = lightstage(*words, store=standing)
    assert done.json["node"] == "normals"
    (reason,) = [r for r in done.json["reasons"] if "method" in r["what"]]
    assert (reason["node"], reason["new"]) == ("normals", "ratio")


def test_the_graph_is_that_of_the_pipeline(lightstage: Lightstage, tmp_path: Path) -> None:
    pipeline = tmp_path / "p.yaml"
    pipeline.write_text(
        "stages:\n  pictures: {uses: capture}\n  clean: {uses: register, from: pictures, when: asked}\n"
    )
    nodes = lightstage("graph", "--pipeline", pipeline, "--json").json["nodes"]
    assert {name: (node["stage"], node["from"], node["when"]) for name, node in nodes.items()} == {
        "pictures": ("capture", [], "always"),
        "clean": ("register", ["pictures"], "asked"),
    }
    assert nodes["clean"]["outputs"]["signal"] == ["frame", "band", "polarisation", "y", "x"]
    assert "clean" in lightstage("graph", "--pipeline", pipeline).out


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("path", "nrmals"), "no result of a node 'nrmals'; did you mean 'normals'?"),
        (("why", "nrmals"), "did you mean 'normals'"),
        (("why", "capture"), "no result of a node 'capture'"),
    ],
)
def test_a_wrong_request_is_one_sentence(
    lightstage: Lightstage, standing: Path, words: tuple[str, ...], part: str
) -> None:
    check_refusal(lightstage(*words, "--session", "ball", store=standing), part)


def test_a_store_that_is_not_there_is_said_and_not_made(lightstage: Lightstage, tmp_path: Path) -> None:
    for words in (("status",), ("sessions", "list")):
        done = lightstage(*words, store=tmp_path / "typo")
        assert done.code == 0
        assert f"there is no store at {tmp_path / 'typo'} yet" in done.err
    assert not (tmp_path / "typo").exists()

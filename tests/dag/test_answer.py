"""The one way of asking: the same answer from memory and by computing, with what was done for it."""

from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np
import pytest

from lightstage.dag.answer import Answer, NodeAnswer, answer, given_items, lay_out
from lightstage.dag.watcher import Notes
from lightstage.store.errors import RequestError
from lightstage.store.grid import open_dataset
from lightstage.store.root import Store
from tests.dag.conftest import Tiny

Stages = Callable[[], Mapping[str, str]]


def pictures(tiny: Tiny) -> list[np.ndarray]:
    return [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in sorted(tiny.capture.glob("*.png"))]


def test_the_numbers_are_those_of_the_pictures(tiny: Tiny) -> None:
    done = tiny.run(overrides=("scaled.gain=2.0",))
    path = done.nodes["summed"].path
    assert path is not None
    total = open_dataset(path).total.values
    np.testing.assert_array_equal(total[0, 0], 2.0 * sum(p.astype(np.float64) for p in pictures(tiny)))
    assert total.dtype == np.float32


def test_an_answer_is_remembered_and_planned_no_more(tiny: Tiny) -> None:
    first = tiny.run()
    assert {name: (node.computed, node.reused) for name, node in first.nodes.items()} == {
        "scaled": (3, 0),
        "summed": (1, 0),
    }

    def unasked() -> Mapping[str, str]:
        raise AssertionError("a remembered answer needs no stages")

    again = answer(tiny.request(), tiny.store, unasked)
    assert {name: (node.computed, node.reused) for name, node in again.nodes.items()} == {
        "scaled": (0, 3),
        "summed": (0, 1),
    }
    assert again.seconds == 0.0
    for name, node in first.nodes.items():
        assert (again.nodes[name].path, again.nodes[name].bytes) == (node.path, node.bytes)


def test_a_part_of_the_frames_is_a_part_of_the_answer_and_says_what_is_left_out(tiny: Tiny) -> None:
    part = tiny.run(frames=(0, 2))
    assert part.notes == ("summed was not computed: each of its blocks needs frames outside 0:2",)
    assert part.nodes["scaled"].computed == 2
    assert part.nodes["summed"].path is None
    assert tiny.run().nodes["scaled"].computed == 1


@pytest.mark.parametrize(
    ("where", "sentence"),
    [
        ({"workers": 0}, "--workers 0: at least one process is needed"),
        ({"scheduler": " "}, "--scheduler is empty"),
        ({"workers": 2, "scheduler": "tcp://host:8786"}, "--workers and --scheduler: choose one"),
    ],
)
def test_where_it_cannot_be_computed(tiny: Tiny, stages: Stages, where: dict[str, object], sentence: str) -> None:
    with pytest.raises(RequestError, match=sentence):
        answer(tiny.request(), tiny.store, stages, **where)  # type: ignore[arg-type]
    assert not tiny.store.results.exists()


def test_what_the_watcher_is_told_is_not_said_again_in_the_answer(tiny: Tiny, stages: Stages) -> None:
    tiny.run("scaled")
    record = tiny.state().nodes["scaled"].records[0]
    assert record is not None
    with open(tiny.store.chunks.path(record.outputs["value"][0].blob), "r+b") as file:
        file.write(b"\xff")
    watcher = Notes()
    fresh = Store(tiny.store.root)  # that has not just written the chunk, and still has it in memory
    done = answer(tiny.request(), fresh, stages, watcher=watcher)
    assert done.notes == ()
    assert any("was damaged: c/scaled, array value" in text for text in watcher.texts)
    assert (done.nodes["scaled"].computed, done.nodes["summed"].computed) == (1, 1)


def test_items_of_a_request_are_kept_and_used_for_it_alone(tiny: Tiny, tmp_path: Path) -> None:
    path = tmp_path / "bands.yaml"
    path.write_text("item: bands\nbands: [{centre_nm: 0, exposure: 4}]\n")
    plain = tiny.run()
    done = tiny.run(items=(("bands", path),))
    assert done.nodes["summed"].path != plain.nodes["summed"].path
    assert plain.nodes["summed"].path is not None
    assert done.nodes["summed"].path is not None
    whole = open_dataset(plain.nodes["summed"].path).total.values
    np.testing.assert_array_equal(4 * open_dataset(done.nodes["summed"].path).total.values, whole)
    assert tiny.run().nodes["summed"].path == plain.nodes["summed"].path
    (item,) = given_items(tiny.request(items=(("bands", path),)), tiny.store).values()
    assert (tiny.store.calibration / item.name / "item.json").is_file()
    with pytest.raises(RequestError, match=r"'band' is no kind of item; did you mean 'bands'\?"):
        given_items(tiny.request(items=(("band", path),)), tiny.store)


def test_what_was_asked_for_once_is_looked_at_too(tiny: Tiny, stages: Stages) -> None:
    text = tiny.pipeline.read_text().replace("from: scaled}", "from: scaled, when: asked}")
    tiny.pipeline.write_text(text)
    assert list(lay_out(tiny.request(), tiny.store, stages, with_results=True).nodes) == ["capture", "scaled"]
    tiny.run("summed")
    assert "summed" in lay_out(tiny.request(), tiny.store, stages, with_results=True).nodes
    assert "summed" not in lay_out(tiny.request(), tiny.store, stages).nodes


def test_an_answer_shows_a_line_a_node() -> None:
    node = NodeAnswer(None, computed=2, reused=1, seconds=0.5, bytes=2048, remarks={}, warnings=())
    first, second = repr(Answer("c", {"scaled": node}, 1.25)).splitlines()
    assert first == "<Answer for session 'c', 1.25 s>"
    assert second.split() == ["scaled", "2", "computed", "1", "reused", "2.0", "kB"]

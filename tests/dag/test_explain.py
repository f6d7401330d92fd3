"""How nodes stand, and which input of which key changed."""

from pathlib import Path

import cv2
import numpy as np

from lightstage.dag.explain import NodeStatus, Reason, _between, _flat, status, why
from lightstage.store.calibration import read_item
from lightstage.store.importer import import_capture
from lightstage.store.items import put_item
from lightstage.store.results import current_path
from lightstage.store.sessions import bind_item
from tests.dag.conftest import Tiny


def conditions(tiny: Tiny, *overrides: str) -> dict[str, str]:
    return {node.name: node.condition for node in status(tiny.state(overrides=overrides), tiny.store)}


def reasons(tiny: Tiny, node: str, *overrides: str) -> tuple[str, list[Reason]]:
    return why(tiny.state(overrides=overrides), node, tiny.store)


def change_picture(tiny: Tiny, name: str) -> None:
    (path,) = tiny.capture.glob(f"*_{name}_*.png")
    cv2.imwrite(str(path), np.full((2, 3), 7, np.uint16))
    import_capture(tiny.capture, tiny.store)


def use_bands(tiny: Tiny, folder: Path, exposure: float) -> None:
    (folder / "bands.yaml").write_text(f"item: bands\nbands: [{{centre_nm: 0, exposure: {exposure}}}]\n")
    item, original = read_item(folder / "bands.yaml", tiny.store.chunks)
    put_item(item, original, tiny.store)
    bind_item("c", item, tiny.store)


def test_a_node_is_missing_partial_fresh_and_stale(tiny: Tiny) -> None:
    assert conditions(tiny) == {"scaled": "missing", "summed": "missing"}
    tiny.run(frames=(0, 2))
    assert conditions(tiny) == {"scaled": "partial", "summed": "missing"}
    tiny.run()
    assert conditions(tiny) == {"scaled": "fresh", "summed": "fresh"}
    assert conditions(tiny, "scaled.gain=2.0") == {"scaled": "stale", "summed": "stale"}
    change_picture(tiny, "Y")
    assert conditions(tiny) == {"scaled": "stale", "summed": "stale"}


def test_what_is_all_known_and_not_in_use_is_stale(tiny: Tiny) -> None:
    tiny.run()
    tiny.run(overrides=("scaled.gain=2.0",))
    assert conditions(tiny, "scaled.gain=2.0") == {"scaled": "fresh", "summed": "fresh"}
    assert conditions(tiny) == {"scaled": "stale", "summed": "stale"}
    tiny.run()
    assert conditions(tiny) == {"scaled": "fresh", "summed": "fresh"}


def test_what_is_known_is_counted(tiny: Tiny) -> None:
    tiny.run()
    change_picture(tiny, "Y")
    scaled, summed = status(tiny.state(), tiny.store)
    folder = current_path("c", "scaled", tiny.store).name
    size = sum(r.size for r in tiny.state().nodes["scaled"].records if r is not None)
    assert scaled == NodeStatus("scaled", "stale", known=2, blocks=3, size=size, folder=folder)
    assert (summed.known, summed.blocks, summed.size) == (0, 1, 0)


def test_a_group_that_lacks_a_file_is_a_part_of_a_result(tiny: Tiny) -> None:
    tiny.run()
    (current_path("c", "scaled", tiny.store) / "value" / "c.1.0.0.0.0").unlink()
    assert conditions(tiny) == {"scaled": "partial", "summed": "fresh"}
    tiny.run()
    assert conditions(tiny) == {"scaled": "fresh", "summed": "fresh"}


def test_a_run_that_was_stopped_before_it_published(tiny: Tiny) -> None:
    tiny.run()
    tiny.store.scratch.remove(tiny.store.results / "c" / "summed")
    assert conditions(tiny)["summed"] == "partial"


def test_without_a_result_the_work_is_counted(tiny: Tiny) -> None:
    assert reasons(tiny, "summed") == ("summed has no result yet: 1 of 1 blocks have to be computed", [])


def test_a_changed_parameter_is_named_at_its_node_with_both_values(tiny: Tiny) -> None:
    tiny.run()
    sentence, changes = reasons(tiny, "summed", "scaled.gain=2.5")
    assert sentence.startswith("summed is stale: 1 of 1 blocks")
    assert Reason("scaled", "parameters.gain", "1.0", "2.5") in changes
    assert {change.node for change in changes} == {"scaled"}  # what it comes to below is not known yet


def test_a_changed_picture_is_named_by_its_block(tiny: Tiny) -> None:
    tiny.run()
    old = tiny.session.images[1][0][0].value
    change_picture(tiny, "X")
    _, changes = reasons(tiny, "summed")
    new = tiny.state().plan.session.images[1][0][0].value
    assert changes == [Reason("scaled", "input of frame 1 (X)", old[:12], new[:12])]


def test_a_changed_item_is_said_once_for_all_blocks(tiny: Tiny, tmp_path: Path) -> None:
    use_bands(tiny, tmp_path, 2.0)
    tiny.run()
    use_bands(tiny, tmp_path, 4.0)
    _, changes = reasons(tiny, "scaled")
    assert changes == [Reason("scaled", "exposure (3 blocks)", "2.0", "4.0")]


def test_a_fresh_node_is_told_against_the_result_before_it(tiny: Tiny) -> None:
    tiny.run()
    sentence, changes = reasons(tiny, "scaled")
    assert "is fresh: its 3 blocks were computed on" in sentence
    assert sentence.endswith("no result stood before it")
    assert changes == []
    before = current_path("c", "scaled", tiny.store).name
    tiny.pipeline.write_text(
        tiny.pipeline.read_text().replace("{uses: scaled,", "{uses: scaled, params: {gain: 3.0},")
    )
    tiny.run()
    sentence, changes = reasons(tiny, "scaled")
    assert sentence == f"scaled is fresh; against the result before it ({before}) these inputs changed"
    assert changes == [Reason("scaled", "parameters.gain", "1.0", "3.0")]


def test_what_came_and_went_in_a_key() -> None:
    old = {
        "parts": {"code": {"a": "1", "b": "2"}, "context": {"frame 0": {"dark": 1}}},
        "inputs": {"frame 0": ["x"]},
    }
    new = {
        "parts": {"code": {"a": "1", "c": "2"}, "context": {"frame 0": {"dark": 2}}},
        "inputs": {"frame 0": ["not known yet"], "frame 1": ["y"]},
    }
    assert _between("n", old, new) == [
        Reason("n", "code.b", "2", "absent"),
        Reason("n", "code.c", "absent", "2"),
        Reason("n", "dark (frame 0)", "1", "2"),
        Reason("n", "block frame 1", "absent", "new"),
    ]
    assert _between("n", old, old) == []


def test_values_are_shown_short() -> None:
    flat = _flat({"a": {"b": 1.5, "list": [1, 2]}, "dark": {"picture": "0123456789abcdef"}, "text": "x" * 200})
    assert flat == {
        ("a", "b"): "1.5",
        ("a", "list"): "1, 2",
        ("dark",): "picture 0123456789ab",
        ("text",): "x" * 160,
    }

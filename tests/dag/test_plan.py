"""Which blocks there are, what each reads, which a range of frames selects, and what names a result."""

import dataclasses
from pathlib import Path

import pytest

from lightstage.dag.fingerprint import block_key
from lightstage.dag.plan import Block, NodePlan, bound_items, check_frames, known_key
from lightstage.dag.stage import Grid
from lightstage.store.calibration import read_item
from lightstage.store.errors import RequestError
from lightstage.store.grid import ArrayTemplate
from lightstage.store.importer import import_capture
from lightstage.store.items import Item, put_item
from lightstage.store.sessions import bind_item, read_session
from tests.dag.conftest import Tiny


def bands(tiny: Tiny, folder: Path, exposure: float, note: str = "") -> Item:
    path = folder / "bands.yaml"
    path.write_text(f"item: bands\nbands: [{{centre_nm: 0, exposure: {exposure}}}]\n{note}")
    item, original = read_item(path, tiny.store.chunks)
    put_item(item, original, tiny.store)
    return item


def test_blocks_follow_from_labels_alone(tiny: Tiny) -> None:
    plan = tiny.state().plan
    assert list(plan.nodes) == ["capture", "scaled", "summed"]
    scaled, summed = plan.nodes["scaled"], plan.nodes["summed"]
    # what an index is called comes down from the stage that brought the dimension in
    assert [block.label for block in scaled.blocks] == ["frame 0 (C)", "frame 1 (X)", "frame 2 (Y)"]
    assert scaled.arrays["value"].shape == (3, 1, 1, 2, 3)
    assert scaled.arrays["value"].chunk == (1, 1, 1, 2, 3)
    assert [block.frames for block in scaled.blocks] == [{0}, {1}, {2}]
    (block,) = summed.blocks
    assert block.frames == {0, 1, 2}


def test_a_block_reads_its_own_index_or_the_pieces_of_its_group_by_name(tiny: Tiny) -> None:
    plan = tiny.state().plan
    ((piece,),) = plan.nodes["scaled"].blocks[1].reads.values()
    assert (piece.name, piece.chunks) == ("", (("capture", 1, "raw", 0),))
    assert (piece.dtype, piece.chunk_shape, piece.shape) == ("uint16", (1, 1, 1, 2, 3), (1, 2, 3))
    (pieces,) = plan.nodes["summed"].blocks[0].reads.values()
    assert {piece.name: piece.chunks for piece in pieces} == {i: (("scaled", i, "value", 0),) for i in range(3)}


def test_a_range_of_frames_selects_the_blocks_that_need_no_others(tiny: Tiny) -> None:
    nodes = tiny.state(frames=(0, 2)).nodes
    assert nodes["scaled"].selected == [True, True, False]
    assert nodes["scaled"].missing() == [0, 1]
    assert nodes["summed"].selected == [False]
    assert not nodes["summed"].complete
    for wrong in ((0, 4), (2, 2), (-1, 2), (2, 1)):
        with pytest.raises(RequestError, match=r"session 'c' has frames 0:3"):
            check_frames(wrong, tiny.session)
    check_frames((0, 3), tiny.session)
    check_frames(None, tiny.session)


def test_a_key_is_known_when_all_that_a_block_reads_is(tiny: Tiny) -> None:
    state = tiny.state()
    raw = [tiny.session.images[i][0][0].value for i in range(3)]
    scaled = state.nodes["scaled"].plan
    expected = block_key(
        scaled.stage_key, scaled.blocks[2].context, {"raw": [["", [raw[2]], "uint16", [1, 2, 3], None, None]]}
    )
    assert state.nodes["scaled"].keys[2] == expected == known_key(scaled, scaled.blocks[2], state.nodes)
    assert state.nodes["summed"].keys == [None]
    assert state.nodes["summed"].node_key is None
    tiny.run()
    after = tiny.state().nodes
    assert after["scaled"].keys == state.nodes["scaled"].keys
    assert after["summed"].keys != [None]
    assert all(node.complete and not node.missing() for node in after.values())
    assert (after["scaled"].remembered, after["summed"].remembered) == (True, True)


def test_a_record_whose_chunk_is_gone_is_not_known(tiny: Tiny) -> None:
    tiny.run()
    record = tiny.state().nodes["scaled"].records[1]
    assert record is not None
    tiny.store.chunks.path(record.outputs["value"][0].blob).unlink()
    nodes = tiny.state().nodes
    assert nodes["scaled"].missing() == [1]
    assert not nodes["scaled"].remembered
    assert nodes["summed"].missing() == [0]


def test_chunks_of_a_block_stand_in_the_order_of_the_grid() -> None:
    template = ArrayTemplate(("frame", "component", "y"), (2, 2, 6), (1, 1, 3), "uint16")
    plan = NodePlan(
        node=None,  # type: ignore[arg-type]
        grid=Grid({"frame": 2, "component": 2, "y": 6}, {"frame": (("frame",), [7, 9])}),
        arrays={"a": template},
        block_dims=("frame",),
        blocks=(),
        contexts={},
        parts={},
        stage_key="",
        recipe="",
        absent=(),
        units={"frame": "s"},
        places={},
    )
    block = Block((1,), "", {}, "", frozenset())
    assert plan.chunk_indices(block, "a") == [(1, 0, 0), (1, 0, 1), (1, 1, 0), (1, 1, 1)]
    frame = plan.coordinates()["frame"]
    assert (frame.dims, frame.values, frame.attrs) == (("frame",), [7, 9], {"units": "s"})


def test_a_results_name_says_its_values_its_labels_and_its_attributes(tiny: Tiny) -> None:
    tiny.run()
    node = tiny.state().nodes["scaled"]
    name = node.manifest({"units": "counts"})
    assert name == node.manifest({"units": "counts"})
    assert node.manifest({"units": "volts"}) != name
    relabelled = {"illumination": (("frame",), ["C", "X", "Z"])}
    grid = dataclasses.replace(node.plan.grid, labels={**node.plan.grid.labels, **relabelled})
    other = dataclasses.replace(node, plan=dataclasses.replace(node.plan, grid=grid))
    assert other.manifest({"units": "counts"}) != name
    fewer = dataclasses.replace(node, selected=[True, True, False])
    assert fewer.manifest({"units": "counts"}) != name
    assert set(fewer.chunks()["value"]) == {(0, 0, 0, 0, 0), (1, 0, 0, 0, 0)}
    # how it was computed is no part of it
    slower = [dataclasses.replace(record, seconds=9.0) for record in node.records if record is not None]
    assert dataclasses.replace(node, records=slower).manifest({"units": "counts"}) == name


def test_an_item_that_differs_in_what_is_read_alone_costs_something(tiny: Tiny, tmp_path: Path) -> None:
    bind_item("c", bands(tiny, tmp_path, 2.0), tiny.store)
    before = tiny.state().nodes["scaled"].keys
    bind_item("c", bands(tiny, tmp_path, 2.0, "rig: york\n"), tiny.store)
    assert tiny.state().nodes["scaled"].keys == before
    bind_item("c", bands(tiny, tmp_path, 3.0), tiny.store)
    assert not set(tiny.state().nodes["scaled"].keys) & set(before)


def test_an_item_of_another_rig_is_refused_for_the_nodes_that_read_it(tiny: Tiny, tmp_path: Path) -> None:
    description = tiny.capture / "capture.yaml"
    description.write_text(description.read_text() + "rig: york\n")
    import_capture(tiny.capture, tiny.store)
    bind_item("c", bands(tiny, tmp_path, 2.0, "rig: leeds\n"), tiny.store)
    with pytest.raises(RequestError, match=r"scaled: bands-\w+ cannot be used: it was measured on the rig 'leeds'"):
        tiny.state()
    assert list(tiny.state("capture").nodes) == ["capture"]


def test_an_item_given_for_a_run_stands_before_the_bound_one(tiny: Tiny, tmp_path: Path) -> None:
    first, second = bands(tiny, tmp_path, 2.0), bands(tiny, tmp_path, 3.0)
    bind_item("c", first, tiny.store)
    session = read_session("c", tiny.store)
    assert bound_items(session, tiny.store, {}) == {"bands": first}
    assert bound_items(session, tiny.store, {"bands": second}) == {"bands": second}

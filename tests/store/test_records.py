"""What was computed from what: the first of two results stays, and damage is forgotten."""

import json
from pathlib import Path

import pytest

from lightstage.store.chunks import ChunkRef
from lightstage.store.records import BlockRecord, blobs_named, intact_record
from lightstage.store.root import Store

KEY, OTHER = "0a" * 16, "0b" * 16
FIRST, SECOND = ChunkRef("11" * 16, "22" * 16, 30), ChunkRef("33" * 16, "44" * 16, 12)


def record(key: str = KEY, ref: ChunkRef = FIRST, **more: object) -> BlockRecord:
    return BlockRecord(key, {"a": (ref, SECOND), "b": ()}, **more)  # type: ignore[arg-type]


def path_of(store: Store, kind: str, key: str) -> Path:
    return store.records.folder / kind / key[:2] / f"{key}.json"


def test_a_record_comes_back_as_it_was_put(store: Store) -> None:
    full = record(stats={"error": 0.25}, warnings=("look at it",), trace={"stage": "s"}, seconds=1.5, reused=False)
    assert store.records.block(KEY) is None
    assert store.records.put_block(full) == (full, True)
    back = store.records.block(KEY)
    assert back == full
    assert back is not None
    assert (back.size, list(back.chunks())) == (42, [FIRST, SECOND])


def test_what_one_run_knows_of_a_block_is_not_stored(store: Store) -> None:
    store.records.put_block(record(reused=False, contradicted=True))
    back = store.records.block(KEY)
    assert back is not None
    assert (back.reused, back.contradicted, back.stats) == (True, False, {})
    assert back == record(reused=False, contradicted=True)  # what is of one run makes no other record
    plain = json.loads(path_of(store, "blocks", KEY).read_text())
    assert set(plain) == {"seal", "key", "outputs", "stats", "warnings", "trace", "seconds"}


def test_the_first_result_of_a_key_stays_and_another_is_told_apart_by_its_values(store: Store) -> None:
    first = record(seconds=1.0)
    store.records.put_block(first)
    # the same values, compressed otherwise, by another run
    standing, same = store.records.put_block(record(ref=ChunkRef(FIRST.value, "55" * 16, 31), seconds=2.0))
    assert (standing, same) == (first, True)
    standing, same = store.records.put_block(record(ref=ChunkRef("66" * 16, FIRST.blob, 30)))
    assert (standing, same) == (first, False)
    store.records.renew_block(record(ref=SECOND))
    renewed = store.records.block(KEY)
    assert renewed is not None
    assert renewed.outputs["a"][0] == SECOND


@pytest.mark.parametrize("damage", ["flipped", "cut", "of another key"])
def test_a_damaged_record_is_forgotten_and_does_not_stand_in_the_way(store: Store, damage: str) -> None:
    store.records.put_block(record())
    store.records.put_block(record(OTHER))
    path = path_of(store, "blocks", KEY)
    data = path.read_bytes()
    path.write_bytes(
        {
            "flipped": data.replace(b'"seconds":0.0', b'"seconds":9.0'),
            "cut": data[:-1],
            "of another key": path_of(store, "blocks", OTHER).read_bytes(),
        }[damage]
    )
    assert not intact_record(path)
    assert store.records.block(KEY) is None
    assert not path.exists()
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(data[:-1])
    assert store.records.put_block(record(seconds=3.0))[1]
    assert intact_record(path)


def test_a_node_is_the_records_of_its_blocks_without_how_each_came_to_be(store: Store) -> None:
    blocks = [record(KEY, trace={"reads": {"x": 1}}), record(OTHER)]
    store.records.put_node("cc" * 16, blocks)
    back = store.records.node("cc" * 16)
    assert back is not None
    assert [(block.key, block.outputs, block.trace) for block in back] == [
        (KEY, blocks[0].outputs, {}),
        (OTHER, blocks[1].outputs, {}),
    ]
    assert store.records.node("dd" * 16) is None


def test_an_answer_is_kept_whole_and_the_newest_counts(store: Store) -> None:
    store.records.put_run(KEY, {"nodes": {"a": 1}})
    store.records.put_run(KEY, {"nodes": {"a": 2}, "key": "its own"})
    assert store.records.run(KEY) == {"nodes": {"a": 2}, "key": "its own"}
    assert store.records.run(OTHER) is None


def test_files_of_a_kind_in_order_and_the_chunks_that_they_name(store: Store) -> None:
    for key in (OTHER, KEY):
        store.records.put_block(record(key))
    assert [path.stem for path in store.records.files("blocks")] == [KEY, OTHER]
    assert list(store.records.files("runs")) == []
    assert {FIRST.blob, SECOND.blob} <= blobs_named(path_of(store, "blocks", KEY))
    with pytest.raises(FileNotFoundError):
        intact_record(path_of(store, "nodes", KEY))

"""Notes: every file of a group is checked for its place, against a note that lies beside the group."""

import json
from pathlib import Path

import numpy as np
import pytest

from lightstage.store.chunks import ChunkRef
from lightstage.store.digest import digest_bytes
from lightstage.store.errors import DamagedFileError
from lightstage.store.notes import (
    Placed,
    chunk_file,
    digest_of,
    holds,
    is_link,
    note_path,
    own_place,
    read_note,
    whole,
    write_note,
)
from lightstage.store.root import Store


@pytest.fixture
def group(store: Store) -> Path:
    """results/s/n/r-m: metadata of its own, and the chunk (0, 1) of the array `a` as a link."""
    group = store.results / "s" / "n" / "r-m"
    (group / "a").mkdir(parents=True)
    (group / "zarr.json").write_text("{}")
    (group / "a" / "c.0.1").hardlink_to(store.chunks.path(ref(store).blob))
    write_note(store.scratch, group, group, placed(store), {"host": "here"})
    return group


def ref(store: Store) -> ChunkRef:
    return store.chunks.put(np.arange(6, dtype=np.uint16).reshape(2, 3))


def placed(store: Store) -> Placed:
    return {"a": {(0, 1): ref(store)}}


def test_where_notes_and_chunks_lie() -> None:
    assert note_path(Path("/s/results/x/n/r-m")) == Path("/s/results/x/n/r-m.json")
    assert note_path(Path("/s/sessions/x/.raw-12.zarr")) == Path("/s/sessions/x/.raw-12.json")
    assert chunk_file("a", (2, 0, 13)) == "a/c.2.0.13"
    assert chunk_file("scalar", ()) == "scalar/c"
    assert own_place(Path("/anywhere/at/all/results/x/n/r-m")) == "x/n/r-m"


def test_a_note_says_what_each_file_is_and_how_the_group_was_made(store: Store, group: Path) -> None:
    note = read_note(group)
    assert note.own == {"zarr.json": digest_bytes(b"{}")}
    assert note.links == {"a/c.0.1": ref(store)}
    assert note.digests == {"zarr.json": digest_bytes(b"{}"), "a/c.0.1": ref(store).blob}
    assert note.content["host"] == "here"


def test_a_note_of_another_group_is_none(store: Store, group: Path) -> None:
    other = group.with_name("r-o")
    note_path(other).write_bytes(note_path(group).read_bytes())
    with pytest.raises(DamagedFileError, match=r"r-o\.json is damaged; `lightstage verify` sets the group aside"):
        read_note(other)
    # the store itself may lie anywhere
    moved = store.root.with_name("moved")
    store.root.rename(moved)
    assert read_note(moved / group.relative_to(store.root)).content["host"] == "here"
    with pytest.raises(FileNotFoundError):
        read_note(group)


def test_a_changed_note_is_damaged(group: Path) -> None:
    text = note_path(group).read_text()
    note_path(group).write_text(text.replace('"here"', '"there"'))
    json.loads(note_path(group).read_text())
    with pytest.raises(DamagedFileError):
        read_note(group)


def test_a_group_is_whole_with_these_very_chunks(store: Store, group: Path) -> None:
    assert whole(group, placed(store), store.chunks)
    other = store.chunks.put(np.zeros((2, 3), np.uint16))
    assert not whole(group, {"a": {(0, 1): other}}, store.chunks)
    assert not whole(group, {"a": {(0, 0): ref(store)}}, store.chunks)
    (group / "zarr.json").write_text("{ }")
    assert not whole(group, placed(store), store.chunks)
    (group / "zarr.json").write_text("{}")
    assert whole(group, placed(store), store.chunks)
    note_path(group).unlink()
    assert not whole(group, placed(store), store.chunks)


def test_a_copy_holds_a_chunk_as_a_link_does_and_other_bytes_do_not(store: Store, group: Path) -> None:
    path, links = group / "a" / "c.0.1", {"a/c.0.1": ref(store)}
    blob = store.chunks.path(ref(store).blob)
    assert is_link(path, blob)
    data = path.read_bytes()
    path.unlink()
    path.write_bytes(data)
    assert not is_link(path, blob)
    assert holds(group, links, store.chunks)
    path.write_bytes(data[:-1])
    assert not holds(group, links, store.chunks)
    path.unlink()
    assert not holds(group, links, store.chunks)
    assert not is_link(path, blob)
    assert digest_of(path) is None

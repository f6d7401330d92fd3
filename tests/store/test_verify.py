"""`verify`: every file is compared with what is said of it elsewhere; what is intact under one name is restored.

What the command makes of a flipped bit in any kind of file is in `test_integrity`.
"""

from pathlib import Path

import cv2
import numpy as np
import pytest

from lightstage.store.chunks import ChunkRef
from lightstage.store.grid import ArrayTemplate, open_dataset
from lightstage.store.importer import import_capture
from lightstage.store.records import BlockRecord
from lightstage.store.results import ResultName, current, publish, set_current
from lightstage.store.root import Store
from lightstage.store.sessions import read_session
from lightstage.store.verify import Damage, Verified, verify
from tests.scenes import one_camera_capture

NAME = ResultName("c", "node", "a" * 12, "b" * 12)
VALUES = np.arange(12, dtype=np.uint16).reshape(2, 6)


@pytest.fixture
def capture(tmp_path: Path, store: Store) -> Path:
    """A session `c` of two pictures, with a bands item."""
    bands = {"item": "bands", "bands": [{"centre_nm": 0, "exposure": 2.0}]}
    folder = one_camera_capture(tmp_path / "c", ["C", "X"], items={"bands": bands})
    import_capture(folder, store)
    return folder


@pytest.fixture
def result(capture: Path, store: Store) -> ChunkRef:
    """A result of the session, `current`, with the record of its one block; returns its chunk."""
    ref = store.chunks.put(VALUES)
    store.records.put_block(BlockRecord("0a" * 16, {"a": (ref,)}))
    publish(
        NAME,
        store,
        arrays={"a": ArrayTemplate(("y", "x"), (2, 6), (2, 6), "uint16")},
        coordinates={},
        attrs={},
        chunks={"a": {(0, 0): ref}},
        provenance={},
    )
    set_current(NAME, store)
    return ref


def exchange(path: Path, data: bytes) -> None:
    """Other bytes under this name alone."""
    path.unlink()
    path.write_bytes(data)


def damaged(store: Store) -> dict[str, Damage]:
    found = verify(store).damaged
    return {damage.path.relative_to(store.root).as_posix(): damage for damage in found}


def test_of_a_store_that_is_well_every_chunk_is_read_once(store: Store, result: ChunkRef) -> None:
    refs = {*read_session("c", store).refs(), result}
    size = sum(store.chunks.path(ref.blob).stat().st_size for ref in refs)
    assert verify(store) == Verified(chunks=3, size=size)
    seen: list[int] = []

    def progress(things: object, count: int, label: str) -> list[Path]:
        seen.append(count)
        assert label == "chunks"
        return list(things)  # type: ignore[call-overload, no-any-return]

    verify(store, progress=progress)
    assert seen == [3]


def test_an_empty_store_is_well(store: Store) -> None:
    assert verify(store) == Verified()


def test_a_chunk_that_is_right_in_a_group_is_restored_from_there(store: Store, result: ChunkRef) -> None:
    blob = store.chunks.path(result.blob)
    good = blob.read_bytes()
    exchange(blob, good[:-1] + bytes([good[-1] ^ 1]))
    ((path, damage),) = damaged(store).items()
    assert path == f"cache/blobs/{result.blob[:2]}/{result.blob}"
    assert damage.recomputable
    assert "restored from the group that holds it too" in damage.remedy
    assert blob.read_bytes() == good
    assert verify(store).damaged == []


def test_a_groups_file_that_is_wrong_is_linked_to_the_stored_chunk_again(store: Store, result: ChunkRef) -> None:
    path = NAME.path(store) / "a" / "c.0.0"
    exchange(path, b"something else")
    assert "restored from the stored chunk" in damaged(store)[path.relative_to(store.root).as_posix()].remedy
    np.testing.assert_array_equal(open_dataset(NAME.path(store)).a.values, VALUES)
    assert path.samefile(store.chunks.path(result.blob))


def test_a_chunk_that_is_wrong_everywhere_takes_its_record_and_result_with_it(
    store: Store, result: ChunkRef
) -> None:
    blob = store.chunks.path(result.blob)
    with open(blob, "r+b") as file:  # all its names are one file
        file.write(b"\xff")
    damage = damaged(store)[blob.relative_to(store.root).as_posix()]
    assert (damage.belongs_to, damage.recomputable) == ("c/node, array a, chunk 0/0", True)
    assert (store.quarantine / result.blob).is_file()
    assert store.records.block("0a" * 16) is None
    assert current("c", "node", store) is None
    assert not NAME.path(store).exists()
    assert verify(store).damaged == []


def test_a_raw_picture_that_is_lost_must_be_imported_again_and_the_others_stay(store: Store, capture: Path) -> None:
    ref = read_session("c", store).images[1][0][0]
    blob = store.chunks.path(ref.blob)
    with open(blob, "r+b") as file:
        file.write(b"\xff")
    damage = damaged(store)[blob.relative_to(store.root).as_posix()]
    assert damage.belongs_to == "session c, raw picture of frame 1 (X), band 0, cross"
    assert (damage.remedy, damage.recomputable) == (f"import {capture} again", False)
    shown = open_dataset(store.sessions / "c" / "raw.zarr").raw
    picture = cv2.imread(str(capture / "0000_C_0nm_CAM1.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(shown[0, 0, 0].values, picture)
    assert import_capture(capture, store).changes == ("1 damaged or lost picture(s) were restored",)
    assert verify(store).damaged == []


def test_an_item_that_a_session_uses_and_that_is_gone_is_named(store: Store, capture: Path) -> None:
    (item,) = store.calibration.glob("bands-*")
    store.scratch.remove(item)
    ((path, damage),) = damaged(store).items()
    assert path == f"calibration/{item.name}/item.json"
    assert damage.belongs_to == "session c, its bands"
    assert not damage.recomputable


def test_what_people_read_of_an_item_is_written_anew(store: Store, capture: Path) -> None:
    (text,) = store.calibration.glob("bands-*/item.yaml")
    original = text.read_bytes()
    text.write_text("item: bands\nbands: []\n")
    ((_, damage),) = damaged(store).items()
    assert damage.remedy.startswith("written again")
    assert text.read_bytes() == original


def test_what_no_command_has_written_is_named_and_left_alone(store: Store, result: ChunkRef) -> None:
    strange = [
        store.sessions / "c" / "notes.txt",
        store.results / "c" / "node" / "old",
        NAME.path(store) / "thumbnail.png",
        store.root / "cache" / "blobs" / "ab" / "readme",
    ]
    for path in strange:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("mine")
    report = verify(store)
    assert report.damaged == []
    assert sorted(report.strange) == sorted(strange)
    assert all(path.read_text() == "mine" for path in strange)


def test_a_chunk_where_none_was_computed_is_damage(store: Store, result: ChunkRef) -> None:
    stray = NAME.path(store) / "a" / "c.0.1"
    stray.write_bytes(b"would be read")
    assert stray.relative_to(store.root).as_posix() in damaged(store)
    assert not NAME.path(store).exists()  # the next run makes it again


def test_a_current_that_names_nothing_is_removed(store: Store, result: ChunkRef) -> None:
    path = store.results / "c" / "node" / "current"
    path.write_text("c" * 12 + "-" + "d" * 12 + "\n")
    assert list(damaged(store)) == ["results/c/node/current"]
    assert not path.exists()

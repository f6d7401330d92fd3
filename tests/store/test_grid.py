"""The groups that anyone can open: plain xarray reads what was stored, and our own reading checks every byte."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray

from lightstage.store.chunks import ChunkRef
from lightstage.store.errors import DamagedChunkError, DamagedGroupError
from lightstage.store.grid import ArrayTemplate, Coordinate, open_dataset, write_group
from lightstage.store.notes import note_path, write_note
from lightstage.store.root import Store


@pytest.mark.parametrize(
    ("shape", "chunk", "grid"),
    [((7, 12, 16), (1, 12, 16), (7, 1, 1)), ((5,), (2,), (3,)), ((4, 4), (2, 4), (2, 1)), ((), (), ())],
)
def test_the_grid_counts_chunks_and_a_part_of_one(
    shape: tuple[int, ...], chunk: tuple[int, ...], grid: tuple[int, ...]
) -> None:
    assert ArrayTemplate(tuple("abc"[: len(shape)]), shape, chunk, "uint16").grid() == grid


def test_what_was_not_computed_reads_as_its_kind_of_nothing() -> None:
    def fill(dtype: str, **attrs: object) -> object:
        return ArrayTemplate(("x",), (1,), (1,), dtype, attrs).fill

    assert np.isnan(fill("float32"))  # type: ignore[call-overload]
    assert fill("bool") is False
    assert fill("uint16") == 0
    assert fill("int16", _FillValue=-32768) == -32768


def test_two_coordinates_of_one_dimension_are_both_coordinates_and_chunks_lie_flat(store: Store) -> None:
    group = written(store)
    opened = open_dataset(group)
    assert set(opened.coords) == {"band", "name"}
    assert opened.coords["name"].dims == ("band",)
    assert sorted(path.name for path in (group / "a").iterdir()) == ["c.0.0", "c.1.0", "zarr.json"]
    assert json.loads((group / "zarr.json").read_text())["attributes"]["coordinates"] == "name"
    np.testing.assert_array_equal(opened.a.values, [[0, 1, 2], [3, 4, 5]])


def written(store: Store) -> Path:
    """results/s/n/g with its note: a(band, x) = [[0, 1, 2], [3, 4, 5]], one chunk a band."""
    group = store.results / "s" / "n" / "g"
    group.parent.mkdir(parents=True)
    refs = {(i, 0): store.chunks.put(np.arange(3 * i, 3 * i + 3, dtype=np.uint16)[None]) for i in range(2)}
    write_group(
        group,
        arrays={"a": ArrayTemplate(("band", "x"), (2, 3), (1, 3), "uint16")},
        coordinates={
            "band": Coordinate(("band",), [445.0, 576.0], {"units": "nm"}),
            "name": Coordinate(("band",), ["b", "g"]),
        },
        attrs={},
        chunks={"a": refs},
        source=store.chunks,
    )
    write_note(store.scratch, group, group, {"a": refs}, {})
    return group


@pytest.mark.parametrize("file", ["a/c.1.0", "band/c.0", "zarr.json"])
def test_a_changed_file_is_never_read(store: Store, file: str) -> None:
    group = written(store)
    path = group / file
    data = path.read_bytes()
    path.unlink()  # it may be a link to a stored chunk
    path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    with pytest.raises(DamagedGroupError, match="its bytes are not the ones that were stored"):
        open_dataset(group).load()


def test_a_group_without_its_note_is_not_read(store: Store) -> None:
    group = written(store)
    note = note_path(group).read_bytes()
    note_path(group).write_bytes(note[:-1])
    with pytest.raises(DamagedGroupError, match="is damaged"):
        open_dataset(group)
    note_path(group).unlink()
    with pytest.raises(DamagedGroupError, match=r"the note of .* cannot be read"):
        open_dataset(group)


def test_a_chunk_that_is_gone_is_named(store: Store) -> None:
    with pytest.raises(DamagedChunkError, match="is gone") as caught:
        write_group(
            store.root / "group",
            arrays={"a": ArrayTemplate(("x",), (1,), (1,), "uint16")},
            coordinates={},
            attrs={},
            chunks={"a": {(0,): ChunkRef("11" * 16, "22" * 16, 3)}},
            source=store.chunks,
        )
    assert caught.value.blob == "22" * 16


def test_a_chunk_that_was_not_computed_reads_as_not_valid(store: Store) -> None:
    template = ArrayTemplate(("frame", "y", "x"), (2, 4, 4), (1, 4, 4), "float32")
    folder = store.root / "group"
    ref = store.chunks.put(np.ones((1, 4, 4), np.float32))
    write_group(
        folder,
        arrays={"a": template},
        coordinates={},
        attrs={},
        chunks={"a": {(0, 0, 0): ref}},
        source=store.chunks,
    )
    values = xarray.open_zarr(folder, chunks=None).a.values
    assert values[0].min() == 1
    assert np.isnan(values[1]).all()


def test_scaled_integers_decode_to_floats_with_nan(store: Store) -> None:
    stored = np.array([[[32767, -32768]]], np.int16)
    attrs = {"scale_factor": 1 / 32767, "_FillValue": -32768}
    template = ArrayTemplate(("frame", "y", "x"), (1, 1, 2), (1, 1, 2), "int16", attrs)
    folder = store.root / "group"
    ref = store.chunks.put(stored)
    write_group(
        folder,
        arrays={"n": template},
        coordinates={},
        attrs={},
        chunks={"n": {(0, 0, 0): ref}},
        source=store.chunks,
    )
    values = xarray.open_zarr(folder, chunks=None).n.values
    assert values[0, 0, 0] == pytest.approx(1)
    assert np.isnan(values[0, 0, 1])

"""Stored chunks and the zarr groups made of them."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import xarray
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from lightstage.store.chunks import ChunkRef, shuffle_for
from lightstage.store.errors import DamagedChunkError
from lightstage.store.grid import ArrayTemplate, Coordinate, write_group
from lightstage.store.root import Store

dtypes = st.sampled_from(["<u2", "<i2", "<f4", "?"])


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_what_is_stored_comes_back_equal(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    store = Store(tmp_path_factory.mktemp("s"))
    array = data.draw(npst.arrays(data.draw(dtypes), npst.array_shapes(min_dims=1, max_dims=3, max_side=7)))
    ref = store.chunks.put(array)
    back = store.chunks.get(ref, dtype=array.dtype.str, shape=array.shape)
    assert back.tobytes() == np.ascontiguousarray(array).tobytes()
    assert not back.flags.writeable
    assert store.chunks.put(array.copy()) == ref


@pytest.mark.parametrize("shape", [(6, 8), (5, 7)])
@pytest.mark.parametrize("dtype", ["uint16", "int16", "float32", "bool"])
def test_zarr_reads_our_chunks_with_and_without_bit_shuffle(
    store: Store, shape: tuple[int, int], dtype: str
) -> None:
    """The trap: blosc's bit shuffle does not compress unless the element count is a multiple of 8."""
    values = (np.arange(2 * shape[0] * shape[1]).reshape(2, *shape) % 3).astype(dtype)
    refs = {(i, 0, 0): store.chunks.put(values[i : i + 1]) for i in range(2)}
    template = ArrayTemplate(("frame", "y", "x"), values.shape, (1, *shape), dtype)
    folder = store.root / "group"
    write_group(
        folder,
        arrays={"a": template},
        coordinates={
            "illumination": Coordinate(("frame",), ["X", "Xc"]),
            "time_s": Coordinate(("frame",), [0.0, np.nan]),
        },
        attrs={"units": "counts"},
        chunks={"a": refs},
        source=store.chunks,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        opened = xarray.open_zarr(folder, chunks=None)
    np.testing.assert_array_equal(opened.a.values, values)
    assert opened.a.dtype == np.dtype(dtype)
    assert list(opened.coords["illumination"].values) == ["X", "Xc"]
    assert np.isnan(opened.coords["time_s"].values[1])


def test_bit_shuffle_only_where_it_compresses() -> None:
    assert shuffle_for((1, 8, 10)) == "bitshuffle"
    assert shuffle_for((1, 309, 406)) == "shuffle"


def test_every_flipped_byte_is_noticed_on_reading(store: Store) -> None:
    array = np.random.default_rng(0).integers(0, 1000, (4, 6)).astype(np.uint16)
    ref = store.chunks.put(array)
    path = store.chunks.path(ref.blob)
    good = path.read_bytes()
    store = Store(store.root)  # one that has not just written it and still has it in memory
    for position in range(0, len(good), 7):
        path.write_bytes(good[:position] + bytes([good[position] ^ 1]) + good[position + 1 :])
        with pytest.raises(DamagedChunkError, match="is damaged"):
            store.chunks.get(ref, dtype="<u2", shape=array.shape)
    path.unlink()
    with pytest.raises(DamagedChunkError, match="cannot be read"):
        store.chunks.get(ref, dtype="<u2", shape=array.shape)


def test_a_reference_survives_json() -> None:
    ref = ChunkRef("v", "b", 3)
    assert ChunkRef.from_plain(ref.as_plain()) == ref


def test_a_shortened_chunk_is_not_taken_for_there(store: Store, tmp_path: Path) -> None:
    ref = store.chunks.put(np.arange(64, dtype=np.uint16))
    assert store.chunks.has(ref)
    store.chunks.path(ref.blob).write_bytes(b"x")
    assert not store.chunks.has(ref)

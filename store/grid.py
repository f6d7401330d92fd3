"""The zarr v3 groups that anyone can open with xarray: metadata by zarr, chunks by hard link.

With `store.checked`, the only module that imports zarr. It writes metadata and small coordinates; pixels are stored
chunks already, encoded by `store.chunks` just as these arrays declare, and are linked into place.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lightstage.store.chunks import ChunkIndex, ChunkRef, Chunks, shuffle_for
from lightstage.store.errors import DamagedChunkError, DamagedFileError, DamagedGroupError
from lightstage.store.files import link_or_copy
from lightstage.store.notes import chunk_file, read_note

FLAT: Any = {"name": "default", "separator": "."}
"""How chunk files are named (zarr v3): `c.0.0.0`, where the default would make a folder for each dimension."""


@dataclass(frozen=True)
class ArrayTemplate:
    """One array of a group. `attrs` may hold `scale_factor` (CF), and then `_FillValue` stands for NaN."""

    dims: tuple[str, ...]
    shape: tuple[int, ...]
    chunk: tuple[int, ...]
    dtype: str
    attrs: Mapping[str, Any] = field(default_factory=dict)

    @property
    def fill(self) -> Any:
        """What a chunk that was not computed reads as."""
        if "_FillValue" in self.attrs:
            return self.attrs["_FillValue"]
        return {"f": float("nan"), "b": False}.get(_kind(self.dtype), 0)

    def grid(self) -> tuple[int, ...]:
        """Number of chunks along each dimension."""
        return tuple(-(-size // step) for size, step in zip(self.shape, self.chunk, strict=True))


@dataclass(frozen=True)
class Coordinate:
    """Labels along one or more dimensions: text, integers or numbers."""

    dims: tuple[str, ...]
    values: Any
    attrs: Mapping[str, Any] = field(default_factory=dict)


def _kind(dtype: str) -> str:
    import numpy as np

    return np.dtype(dtype).kind


def write_group(
    folder: Path,
    *,
    arrays: Mapping[str, ArrayTemplate],
    coordinates: Mapping[str, Coordinate],
    attrs: Mapping[str, Any],
    chunks: Mapping[str, Mapping[ChunkIndex, ChunkRef]],
    source: Chunks,
) -> None:
    """Write a whole group into a folder that does not exist yet (in scratch: the caller renames it).

    `chunks` gives, per array, the chunks that exist by their place in the chunk grid; a missing one reads as
    the array's fill value.
    """
    import numpy as np
    import zarr
    from zarr.codecs import BloscCodec

    from lightstage.store.unshared import UnsharedStore

    secondary = [name for name, coordinate in coordinates.items() if coordinate.dims != (name,)]
    group_attrs = {**attrs, **({"coordinates": " ".join(secondary)} if secondary else {})}
    group = zarr.create_group(UnsharedStore(folder), zarr_format=3, attributes=group_attrs)
    for name, array in arrays.items():
        group.create_array(
            name,
            shape=array.shape,
            chunks=array.chunk,
            dtype=array.dtype,
            fill_value=array.fill,
            dimension_names=array.dims,
            compressors=BloscCodec(cname="lz4", clevel=1, shuffle=shuffle_for(array.chunk)),
            chunk_key_encoding=FLAT,
            attributes=dict(array.attrs),
        )
        for index, ref in chunks[name].items():
            try:
                link_or_copy(source.path(ref.blob), folder / chunk_file(name, index))
            except FileNotFoundError:
                raise DamagedChunkError(f"the stored chunk {source.path(ref.blob)} is gone", ref.blob) from None
    for name, coordinate in coordinates.items():
        values = np.asarray(coordinate.values)
        text = values.dtype.kind in "UO"
        labels = group.create_array(
            name,
            shape=values.shape,
            dtype="str" if text else values.dtype,
            dimension_names=coordinate.dims,
            chunk_key_encoding=FLAT,
            attributes=dict(coordinate.attrs),
            **({} if text else {"fill_value": values.dtype.type(0)}),
        )
        labels[...] = values.astype(object) if text else values
    with warnings.catch_warnings():
        # xarray warns without consolidated metadata, zarr with it: version 3 of the format leaves it open
        warnings.simplefilter("ignore")
        zarr.consolidate_metadata(UnsharedStore(folder))


def open_dataset(folder: Path) -> Any:
    """A group as an xarray dataset, decoded (integers with a scale become floats, fill becomes NaN), unchunked.

    Every command of ours that reads a group reads it here: each file is checked when it is read, so that nothing
    is made of damaged bytes. Users call `xarray.open_zarr` themselves.

    Raises:
        DamagedGroupError: now or when values are read; a file is not the one that was stored, or is gone.
    """
    import xarray

    from lightstage.store.checked import CheckedStore

    group = folder.resolve()
    try:
        digests = read_note(group).digests
    except OSError as error:
        raise DamagedGroupError(f"the note of {folder} cannot be read ({error.strerror})", group) from None
    except DamagedFileError as error:
        raise DamagedGroupError(f"{error.path} is damaged", group) from None
    return xarray.open_zarr(CheckedStore(group, digests), chunks=None)

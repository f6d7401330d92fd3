"""Stored chunks, addressed by content.

A chunk is one C-ordered block of numbers, encoded exactly as zarr's `bytes` and `blosc` codecs would, so that
a result folder can hard-link it. It lies at `cache/blobs/<2 digits>/<digest of the stored bytes>` and is
never changed. Reading checks that digest: a damaged chunk can stop a run but cannot enter a result.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

from store.digest import digest_array, digest_bytes
from store.errors import DamagedChunkError
from store.files import Scratch, put_if_absent

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class ChunkRef:
    """What is known of a stored chunk without opening it."""

    value: str
    """Digest of the decoded values, dtype and shape: what keys are made of."""
    blob: str
    """Digest of the stored bytes: its name on disk."""
    size: int
    """Stored bytes."""

    def as_plain(self) -> list[Any]:
        """For JSON."""
        return [self.value, self.blob, self.size]

    @classmethod
    def from_plain(cls, plain: list[Any]) -> Self:
        """From JSON."""
        return cls(str(plain[0]), str(plain[1]), int(plain[2]))


def shuffle_for(shape: tuple[int, ...]) -> Literal["bitshuffle", "shuffle"]:
    """Blosc's bit shuffle leaves a chunk uncompressed unless its element count is a multiple of 8."""
    count = 1
    for size in shape:
        count *= size
    return "bitshuffle" if count % 8 == 0 else "shuffle"


class Chunks:
    """The folder of chunks."""

    def __init__(self, folder: Path, scratch: Scratch) -> None:
        self.folder = folder
        self._scratch = scratch

    def path(self, blob: str) -> Path:
        """Where a chunk lies, or would lie."""
        return self.folder / blob[:2] / blob

    def has(self, ref: ChunkRef) -> bool:
        """Whether the chunk is there with its full length (its content is checked on reading)."""
        try:
            return os.stat(f"{self.folder}/{ref.blob[:2]}/{ref.blob}").st_size == ref.size
        except OSError:
            return False

    def put(self, array: "NDArray[np.generic]") -> ChunkRef:
        """Store an array as one chunk; an equal one that is already there is used."""
        value = digest_array(array)
        encoded = _encode(array)
        blob = digest_bytes(encoded)
        path = self.path(blob)
        if not path.exists():
            put_if_absent(self._scratch, path, encoded)
        return ChunkRef(value, blob, len(encoded))

    def get(self, ref: ChunkRef, *, dtype: str, shape: tuple[int, ...]) -> "NDArray[Any]":
        """Read a chunk, read-only.

        Raises:
            DamagedChunkError: it is gone, or its bytes are not the ones that were stored.
        """
        import numpy as np

        path = self.path(ref.blob)
        try:
            encoded = path.read_bytes()
        except OSError as error:
            raise DamagedChunkError(
                f"the stored chunk {path} cannot be read ({error.strerror})", ref.blob
            ) from None
        if digest_bytes(encoded) != ref.blob:
            raise DamagedChunkError(
                f"the stored chunk {path} is damaged: its bytes do not have its digest", ref.blob
            )
        array = np.frombuffer(_decode(encoded), dtype=dtype).reshape(shape)
        array.flags.writeable = False
        return array


def _encode(array: "NDArray[np.generic]") -> bytes:
    from numcodecs import Blosc, blosc

    blosc.use_threads = False  # Dask has the threads
    mode = Blosc.BITSHUFFLE if shuffle_for(array.shape) == "bitshuffle" else Blosc.SHUFFLE
    little = array.astype(array.dtype.newbyteorder("<"), order="C", copy=False)
    return bytes(Blosc(cname="lz4", clevel=1, shuffle=mode).encode(little))


def _decode(encoded: bytes) -> bytes:
    from numcodecs import Blosc, blosc

    blosc.use_threads = False
    return Blosc().decode(encoded)  # type: ignore[no-any-return]

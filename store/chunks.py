"""Stored chunks, addressed by content.

A chunk is one C-ordered block of numbers, encoded exactly as zarr's `bytes` and `blosc` codecs would, so that
a result folder can hard-link it. It lies at `cache/blobs/<2 digits>/<digest of the stored bytes>` and is
never changed. Reading checks that digest: a damaged chunk can stop a run but cannot enter a result.

A chunk is flushed to the disk beside the work, and waited for before a session or a result refers to it. A block's
record may be on the disk before its chunks are; after a loss of power the check on reading catches that.
"""

import contextlib
import os
import shutil
import threading
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

from lightstage.store.digest import digest_array, digest_bytes
from lightstage.store.errors import DamagedChunkError, WorkError
from lightstage.store.files import Scratch, disk_faults_named, put_if_absent, renewed, replace

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


ChunkIndex = tuple[int, ...]
"""A chunk's place in the chunk grid of its array."""
RECENT_BYTES, RECENT_CHUNKS = 128_000_000, 256
"""What a process keeps of the arrays that it has just written. Blocks are computed depth first: of a performance of
2,000 pictures none was read again after more than 133 others."""


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
        self._recent: OrderedDict[str, NDArray[Any]] = OrderedDict()
        self._recent_bytes = 0
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[type, tuple[Path, Scratch]]:
        # a store travels to workers; what was just written here stays here
        return (type(self), (self.folder, self._scratch))

    def path(self, blob: str) -> Path:
        """Where a chunk lies, or would lie."""
        return self.folder / blob[:2] / blob

    def has(self, ref: ChunkRef) -> bool:
        """Whether the chunk is there with its full length (its content is checked on reading)."""
        try:
            return os.stat(f"{self.folder}/{ref.blob[:2]}/{ref.blob}").st_size == ref.size
        except OSError:
            return False

    def intact(self, ref: ChunkRef) -> bool:
        """Whether the chunk is there with its content; reads it."""
        try:
            return digest_bytes(self.path(ref.blob).read_bytes()) == ref.blob
        except OSError:
            return False

    def put(self, array: "NDArray[np.generic]") -> ChunkRef:
        """Store an array as one chunk; an equal one that is already there is used.

        What is there is compared, not believed. Damaged bytes are replaced by a new file: groups that hold the old
        one as a link are made again when they are published, or mended by `verify`.
        """
        ref, encoded = _stored_form(array)
        path = self.path(ref.blob)
        self._remember(ref.blob, array)
        if self._holds(path, encoded) and renewed(path):
            return ref
        if not put_if_absent(self._scratch, path, encoded, durable=False) and not self._holds(path, encoded):
            replace(self._scratch, path, encoded)
        return ref

    def _holds(self, path: Path, encoded: bytes) -> bool:
        try:
            return os.stat(path).st_size == len(encoded) and path.read_bytes() == encoded
        except OSError:
            return False

    def _remember(self, blob: str, array: "NDArray[Any]") -> None:
        """Keep what was just written: the next stage reads it at once, and need not read and decode it."""
        if array.nbytes * 2 > RECENT_BYTES:
            return
        view = array.view()
        view.flags.writeable = False
        with self._lock:
            former = self._recent.pop(blob, None)
            self._recent[blob] = view
            self._recent_bytes += view.nbytes - (0 if former is None else former.nbytes)
            while self._recent_bytes > RECENT_BYTES or len(self._recent) > RECENT_CHUNKS:
                self._recent_bytes -= self._recent.popitem(last=False)[1].nbytes

    def get(self, ref: ChunkRef, *, dtype: str, shape: tuple[int, ...]) -> "NDArray[Any]":
        """Read a chunk, read-only.

        Raises:
            DamagedChunkError: it is gone, or its bytes are not the ones that were stored.
        """
        import numpy as np

        with self._lock:
            recent = self._recent.get(ref.blob)
        if recent is not None and recent.dtype == np.dtype(dtype):
            return recent.reshape(shape)
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


class Staging(Chunks):
    """Chunks that become part of the store all together, when all else is known to be right, or not at all."""

    def __init__(self, target: Chunks, scratch: Scratch) -> None:
        super().__init__(scratch.path(), scratch)
        self._target = target

    def put(self, array: "NDArray[np.generic]") -> ChunkRef:
        """Store an array for the time being; one that the store has already is not written again."""
        ref, encoded = _stored_form(array)
        if self._target.intact(ref) and renewed(self._target.path(ref.blob)):
            return ref
        if not self.path(ref.blob).exists():
            put_if_absent(self._scratch, self.path(ref.blob), encoded, durable=False)
        return ref

    def commit(self) -> None:
        """Let the store have them."""
        self._scratch.flush()
        for path in sorted(self.folder.glob("*/*")):
            target = self._target.path(path.name)
            with disk_faults_named(target):
                self._scratch.make_folder(target.parent)
                os.replace(path, target)
        self.discard()

    def discard(self) -> None:
        """Forget them."""
        with contextlib.suppress(WorkError):
            self._scratch.flush()
        shutil.rmtree(self.folder, ignore_errors=True)


def _stored_form(array: "NDArray[np.generic]") -> tuple[ChunkRef, bytes]:
    encoded = _encode(array)
    return ChunkRef(digest_array(array), digest_bytes(encoded), len(encoded)), encoded


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

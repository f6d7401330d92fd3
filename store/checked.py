"""A group read with every byte checked: zarr's local store, which hands out only what the group's note names.

Metadata, coordinates and chunks are each read whole and compared with their digest before zarr sees them, when
they are asked for; what is not read costs nothing. A file that the note names and that is missing is damage; what
it does not name is not there, so that a stray file cannot stand where an array has its fill value.
"""

import asyncio
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Self

from zarr.abc.store import ByteRequest, OffsetByteRequest, RangeByteRequest, SuffixByteRequest
from zarr.core.buffer import Buffer, BufferPrototype, default_buffer_prototype
from zarr.storage import LocalStore

from lightstage.store.digest import digest_bytes
from lightstage.store.errors import DamagedGroupError


class CheckedStore(LocalStore):
    """The files of one group."""

    def __init__(self, group: Path, digests: Mapping[str, str]) -> None:
        super().__init__(group, read_only=True)
        self._digests = digests

    def with_read_only(self, read_only: bool = False) -> Self:
        """It is never anything else."""
        if not read_only:
            raise ValueError("a checked group is only read")
        return self

    def _read(
        self, key: str, prototype: BufferPrototype | None = None, byte_range: ByteRequest | None = None
    ) -> Buffer | None:
        digest = self._digests.get(key)
        if digest is None:
            return None
        path = self.root / key
        try:
            data = path.read_bytes()
        except OSError as error:
            raise DamagedGroupError(f"{path} cannot be read ({error.strerror})", self.root) from None
        if digest_bytes(data) != digest:
            raise DamagedGroupError(f"{path} is damaged: its bytes are not the ones that were stored", self.root)
        return (prototype or default_buffer_prototype()).buffer.from_bytes(_part(data, byte_range))

    async def get(
        self, key: str, prototype: BufferPrototype | None = None, byte_range: ByteRequest | None = None
    ) -> Buffer | None:
        """One file, or a part of it."""
        return await asyncio.to_thread(self._read, key, prototype, byte_range)

    def get_sync(self, key: str, **options: Any) -> Buffer | None:
        """The same, for callers that do not wait."""
        return self._read(key, **options)

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, ByteRequest | None]]
    ) -> list[Buffer | None]:
        """Several."""
        return list(await asyncio.gather(*(self.get(key, prototype, part) for key, part in key_ranges)))

    async def exists(self, key: str) -> bool:
        """Whether the group has such a file."""
        return key in self._digests


def _part(data: bytes, wanted: ByteRequest | None) -> bytes:
    match wanted:
        case RangeByteRequest(start, end):
            return data[start:end]
        case OffsetByteRequest(offset):
            return data[offset:]
        case SuffixByteRequest(suffix):
            return data[-suffix:] if suffix else b""
        case _:
            return data

"""A group being written where nobody else writes: zarr's local store, without what it does for company.

zarr puts the metadata of a new group where none is yet by a hard link, which some file systems do not have; and it
makes every folder above a file anew, also those of a store that was moved away in the meantime.
"""

import asyncio
from typing import Any

from zarr.core.buffer import Buffer
from zarr.storage import LocalStore


class UnsharedStore(LocalStore):
    """The files of a group in scratch.

    Raises:
        FileNotFoundError: from whatever writes; the folder that is to hold the group is gone.
    """

    async def _open(self, *, mode: Any = None) -> None:
        self._ensure_open_sync()

    def _ensure_open_sync(self) -> None:
        if not self._is_open:
            self.root.mkdir(exist_ok=True)
            self._is_open = True

    async def set(self, key: str, value: Buffer) -> None:
        """Nobody reads it yet, so that it may be seen half."""
        await asyncio.to_thread(self.set_sync, key, value)

    async def set_if_not_exists(self, key: str, value: Buffer) -> None:
        """Nobody can come between."""
        if not await self.exists(key):
            await self.set(key, value)

    def set_sync(self, key: str, value: Buffer) -> None:
        """The folders of the group, and no others, are made as they are needed."""
        path = self.root / key
        for folder in reversed(path.relative_to(self.root).parents):
            (self.root / folder).mkdir(exist_ok=True)
        path.write_bytes(value.to_bytes())

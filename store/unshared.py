"""A group being written where nobody else writes: zarr's local store, without the links that it makes for company.

zarr puts the metadata of a new group where none is yet by a hard link, which some file systems do not have.
"""

from zarr.core.buffer import Buffer
from zarr.storage import LocalStore


class UnsharedStore(LocalStore):
    """The files of a group in scratch."""

    async def set_if_not_exists(self, key: str, value: Buffer) -> None:
        """Nobody can come between."""
        if not await self.exists(key):
            await self.set(key, value)

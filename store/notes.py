"""Notes: beside each group, what its files should be.

    results/<session>/<node>/<recipe>-<manifest>/        sessions/<session>/.raw-<digest>.zarr/
    results/<session>/<node>/<recipe>-<manifest>.json    sessions/<session>/.raw-<digest>.json

A note is sealed. It names the chunk of every place in the group's chunk grids that has one, and the digests of the
group's other files, which are its metadata and coordinates; so every file of a group can be checked for its place.
What else it holds is how the group was made.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from lightstage.store.chunks import ChunkIndex, ChunkRef, Chunks
from lightstage.store.digest import digest_bytes
from lightstage.store.errors import DamagedFileError
from lightstage.store.files import Scratch, files_below, replace
from lightstage.store.sealed import seal, unseal

Placed = Mapping[str, Mapping[ChunkIndex, ChunkRef]]
"""By array, the chunks by their place in its chunk grid."""


@dataclass(frozen=True)
class Note:
    """What is known of a group."""

    own: Mapping[str, str]
    """Metadata and coordinates: file to digest."""
    links: Mapping[str, ChunkRef]
    """Chunk files: file to chunk."""
    content: Mapping[str, Any]
    """The whole note, with how the group was made."""

    @cached_property
    def digests(self) -> Mapping[str, str]:
        """Of every file that the group has."""
        return {**self.own, **{file: ref.blob for file, ref in self.links.items()}}


def note_path(group: Path) -> Path:
    """Where a group's note lies."""
    return group.with_name(f"{group.name.removesuffix('.zarr')}.json")


def chunk_file(array: str, index: ChunkIndex) -> str:
    """Where a chunk lies in a group: zarr's default naming with a dot, so that an array is one folder."""
    return f"{array}/{'.'.join(['c', *map(str, index)])}"


def write_note(scratch: Scratch, group: Path, written: Path, chunks: Placed, provenance: Mapping[str, Any]) -> None:
    """Note what a group's files are, before it appears.

    Args:
        group: where it will be.
        written: where it has been written.
        chunks: what was linked into it.
        provenance: what else the note says: how the group was made.
    """
    links = {chunk_file(array, index) for array, placed in chunks.items() for index in placed}
    below = (entry.path.removeprefix(f"{written}{os.sep}") for entry in files_below(written))
    own = [name for name in below if name not in links]
    plain = {
        **provenance,
        "group": own_place(group),
        "chunks": {
            array: {".".join(map(str, index)): ref.as_plain() for index, ref in placed.items()}
            for array, placed in chunks.items()
        },
        "files": {name: digest_bytes((written / name).read_bytes()) for name in own},
    }
    replace(scratch, note_path(group), seal(plain, indent=1))


def read_note(group: Path) -> Note:
    """The note of a group.

    Raises:
        FileNotFoundError: there is none.
        DamagedFileError: it cannot be read, or is the note of another group.
    """
    path = note_path(group)
    remedy = "`lightstage verify` sets the group aside, and the next run makes it again"
    plain = unseal(path.read_bytes(), path, remedy)
    try:
        links = {
            f"{array}/c.{index}": ChunkRef.from_plain(ref)
            for array, refs in plain["chunks"].items()
            for index, ref in refs.items()
        }
        if plain["group"] != own_place(group):
            raise DamagedFileError(path, remedy)
        return Note(dict(plain["files"]), links, plain)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError):
        raise DamagedFileError(path, remedy) from None


def own_place(group: Path) -> str:
    """A group's place in the store, which may itself lie anywhere."""
    return "/".join(group.parts[-3:])


def whole(group: Path, chunks: Placed, source: Chunks) -> bool:
    """Whether a group is as its note says, with these very chunks; reads what is no link to a stored chunk."""
    try:
        note = read_note(group)
    except (OSError, DamagedFileError):
        return False
    placed_at = {chunk_file(array, index): ref for array, placed in chunks.items() for index, ref in placed.items()}
    own = all(digest_of(group / file) == digest for file, digest in note.own.items())
    return own and holds(group, placed_at, source)


def holds(group: Path, links: Mapping[str, ChunkRef], source: Chunks) -> bool:
    """Whether each of these files of a group is there, and is its chunk."""
    return all(
        is_link(group / file, source.path(ref.blob)) or digest_of(group / file) == ref.blob
        for file, ref in links.items()
    )


def is_link(path: Path, blob: Path) -> bool:
    """Whether a file of a group and a stored chunk are two names of one file."""
    try:
        return os.path.samestat(os.stat(path), os.stat(blob))
    except OSError:
        return False


def digest_of(path: Path) -> str | None:
    """Digest of a file's bytes; None where there is no file."""
    try:
        return digest_bytes(path.read_bytes())
    except OSError:
        return None

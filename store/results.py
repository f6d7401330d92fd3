"""Results: `results/<session>/<node>/<recipe>-<manifest>/`, plain zarr groups that never change.

Beside each group lies `<recipe>-<manifest>.json`, its provenance (how it was made, when, where), and beside
them the text file `current`, which names the group that the last run used.
"""

import contextlib
import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from store.chunks import ChunkRef
from store.digest import digest_bytes
from store.errors import RequestError
from store.files import disk_faults_named, replace
from store.grid import ArrayTemplate, ChunkIndex, Coordinate, write_group
from store.root import Store


@dataclass(frozen=True)
class ResultName:
    """Which result: of which session and node, under which recipe, with which content."""

    session: str
    node: str
    recipe: str
    manifest: str

    @property
    def folder(self) -> str:
        """The folder's name."""
        return f"{self.recipe}-{self.manifest}"

    def path(self, store: Store) -> Path:
        """The zarr group."""
        return store.results / self.session / self.node / self.folder


def publish(
    name: ResultName,
    store: Store,
    *,
    arrays: Mapping[str, ArrayTemplate],
    coordinates: Mapping[str, Coordinate],
    attrs: Mapping[str, Any],
    chunks: Mapping[str, Mapping[ChunkIndex, ChunkRef]],
    provenance: Mapping[str, Any],
) -> Path:
    """Make the group appear, whole, unless it is there already."""
    path = name.path(store)
    if path.is_dir() and not (_whole(path, chunks) and path.with_name(f"{path.name}.json").is_file()):
        store.scratch.remove(path)
    if path.is_dir():
        with contextlib.suppress(OSError):
            os.utime(path.with_name(f"{path.name}.json"))  # in use again: `gc` must not take it for old
    else:
        temporary = store.scratch.path()
        with disk_faults_named(path):
            write_group(
                temporary,
                arrays=arrays,
                coordinates=coordinates,
                attrs=attrs,
                chunks=chunks,
                source=store.chunks,
            )
            store.chunks.flush()
            path.parent.mkdir(parents=True, exist_ok=True)
            note = {**provenance, "files": _own_files(temporary, chunks)}
            replace(store.scratch, path.with_name(f"{path.name}.json"), json.dumps(note, indent=1).encode())
            try:
                os.rename(temporary, path)
            except OSError:
                if not path.is_dir():  # another run has published the same result
                    raise
                shutil.rmtree(temporary)
    return path


def _own_files(group: Path, chunks: Mapping[str, Mapping[ChunkIndex, ChunkRef]]) -> dict[str, str]:
    """Digests of what is not a link to a stored chunk: metadata and coordinates."""
    links = {chunk_file(array, index) for array, placed in chunks.items() for index in placed}
    files = (path for path in sorted(group.rglob("*")) if path.is_file())
    names = {path.relative_to(group).as_posix(): path for path in files}
    return {name: digest_bytes(path.read_bytes()) for name, path in names.items() if name not in links}


def _whole(path: Path, chunks: Mapping[str, Mapping[ChunkIndex, ChunkRef]]) -> bool:
    """Whether a group has its metadata and every chunk with its full length."""
    return (path / "zarr.json").is_file() and all(
        (path / array / "zarr.json").is_file()
        and all(_has(path, chunk_file(array, index), ref.size) for index, ref in placed.items())
        for array, placed in chunks.items()
    )


def chunk_file(array: str, index: ChunkIndex) -> str:
    """Where a chunk lies in a group, after zarr's default naming."""
    return f"{array}/c/{'/'.join(map(str, index))}"


def _has(group: Path, file: str, size: int) -> bool:
    try:
        return os.stat(f"{group}/{file}").st_size == size
    except OSError:
        return False


def lacks(path: Path, made: Mapping[str, Any]) -> list[str]:
    """Files that a result group should have and does not, after its provenance."""
    wanted = ["zarr.json", *made.get("files", {})]
    missing = [name for name in wanted if not (path / name).is_file()]
    for array, refs in made.get("chunks", {}).items():
        missing += [
            f"{array}/c/{index}" for index, ref in refs.items() if not _has(path, f"{array}/c/{index}", ref[2])
        ]
    return missing


def set_current(name: ResultName, store: Store) -> None:
    """Say that this is the result that the last run used."""
    if current(name.session, name.node, store) != name.folder:
        replace(store.scratch, store.results / name.session / name.node / "current", f"{name.folder}\n".encode())


def current(session: str, node: str, store: Store) -> str | None:
    """The folder name of the result in use, if it is there."""
    folder = store.results / session / node
    try:
        with open(folder / "current", encoding="utf-8") as file:
            name = file.read().strip()
    except (FileNotFoundError, NotADirectoryError):
        return None
    return name if (folder / name / "zarr.json").is_file() else None


def current_path(session: str, node: str, store: Store) -> Path:
    """The group in use.

    Raises:
        RequestError: the node has no result for this session.
    """
    name = current(session, node, store)
    if name is None:
        folder = store.results / session
        have = (
            sorted(p.name for p in folder.iterdir() if current(session, p.name, store)) if folder.is_dir() else []
        )
        raise RequestError(
            f"session '{session}' has no result of '{node}' yet (it has {', '.join(have) or 'none'}); "
            f"`lightstage run {node} --session {session}` computes it"
        )
    return store.results / session / node / name


def provenance(session: str, node: str, folder: str, store: Store) -> dict[str, Any] | None:
    """How a result was made, if it is known."""
    try:
        data = (store.results / session / node / f"{folder}.json").read_bytes()
        plain = json.loads(data)
    except (FileNotFoundError, ValueError):
        return None
    return plain if isinstance(plain, dict) else None

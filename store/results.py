"""Results: `results/<session>/<node>/<recipe>-<manifest>/`, plain zarr groups that never change.

Beside each group lies `<recipe>-<manifest>.json`, its note: what its files are, and how it was made, when and
where. Beside them the text file `current` names the group that the last run used.
"""

import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightstage.store.errors import DamagedFileError, RequestError
from lightstage.store.files import disk_faults_named, renewed, replace
from lightstage.store.grid import ArrayTemplate, Coordinate, write_group
from lightstage.store.notes import Placed, note_path, read_note, whole, write_note
from lightstage.store.root import Store


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
    chunks: Placed,
    provenance: Mapping[str, Any],
) -> Path:
    """Make the group appear, whole, unless it is there already."""
    path = name.path(store)
    if path.is_dir() and not whole(path, chunks, store.chunks):
        store.scratch.remove(path)
    if not (path.is_dir() and renewed(note_path(path))):
        temporary = store.scratch.path()
        with disk_faults_named(path), store.scratch.present():
            write_group(
                temporary,
                arrays=arrays,
                coordinates=coordinates,
                attrs=attrs,
                chunks=chunks,
                source=store.chunks,
            )
            store.scratch.flush()
            store.scratch.make_folder(path.parent)
            write_note(store.scratch, path, temporary, chunks, provenance)
            try:
                os.rename(temporary, path)
            except OSError:
                if not path.is_dir():  # another run has published the same result
                    raise
                shutil.rmtree(temporary)
    return path


def _has(group: Path, file: str, size: int) -> bool:
    try:
        return os.stat(f"{group}/{file}").st_size == size
    except OSError:
        return False


def lacks(path: Path, record: Mapping[str, Any]) -> list[str]:
    """Files that a result group should have and does not, after its provenance."""
    wanted = ["zarr.json", *record.get("files", {})]
    missing = [name for name in wanted if not (path / name).is_file()]
    for array, refs in record.get("chunks", {}).items():
        missing += [
            f"{array}/c.{index}" for index, ref in refs.items() if not _has(path, f"{array}/c.{index}", ref[2])
        ]
    return missing


def set_current(name: ResultName, store: Store) -> bool:
    """Say that this is the result that the last run used; returns whether it is there, and so stays there."""
    if current(name.session, name.node, store) != name.folder:
        replace(store.scratch, store.results / name.session / name.node / "current", f"{name.folder}\n".encode())
    return current(name.session, name.node, store) == name.folder


def current(session: str, node: str, store: Store) -> str | None:
    """The folder name of the result in use, if it is there."""
    folder = os.path.join(store.results, session, node)  # asked for each node of each session
    try:
        with open(os.path.join(folder, "current"), encoding="ascii", errors="replace") as file:
            name = file.read().strip()
    except (FileNotFoundError, NotADirectoryError):
        return None
    return name if os.path.isfile(os.path.join(folder, name, "zarr.json")) else None


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
        return dict(read_note(store.results / session / node / folder).content)
    except (OSError, DamagedFileError):
        return None

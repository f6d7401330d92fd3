"""Freeing what nothing refers to, also while others are at work.

What is to go is decided first, so that a dry run can say it, and looked at once more when it goes: it is taken
aside by a rename, and then it is put back, where something has come to use it since, or deleted. Whoever comes to
use a thing says so first and looks afterwards whether it is still there: a run links or renews a chunk
(`link_or_copy`, `Chunks.put`), renews a note, writes `current` and then looks for the group that it names. One of
the two always sees the other. What a kill leaves is garbage: for the next `gc` where it stood, or in `tmp/`.

Young is what was written or renewed lately. Links that come and go change the inode, but say nothing of use.
"""

import contextlib
import json
import os
import time
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from lightstage.store.digest import SHORT
from lightstage.store.errors import DamagedFileError
from lightstage.store.files import delete, disk_faults_named, files_below, put_back
from lightstage.store.items import all_items
from lightstage.store.marker import NAME, gone
from lightstage.store.notes import note_path
from lightstage.store.records import KINDS, blobs_named
from lightstage.store.results import current, provenance
from lightstage.store.root import Store
from lightstage.store.sessions import Session, raw_group, read_session


@dataclass
class Freed:
    """What `gc` frees, or would free."""

    results: int = 0
    chunks: int = 0
    records: int = 0
    items: int = 0
    size: int = 0
    """Bytes of all files that go, with those out of `tmp/`; a file with several names goes with its last."""


def gc(store: Store, *, grace_s: float, dry_run: bool, before: Callable[[Path], None] = lambda path: None) -> Freed:
    """Free what no session and no result in use refers to.

    In use are: all sessions, the calibration items bound to them, and per node the result that `current` names
    and, while that is a partial one, the newest complete one. Anything younger than `grace_s` seconds stays,
    because a run in progress may be about to use it; so does, whatever the grace, what is used while gc works.
    Damaged chunks leave the quarantine at that age.

    Args:
        store: where.
        grace_s: what counts as young.
        dry_run: only say what would be freed.
        before: is called with each thing when it has been decided to free it, right before that is done.

    Raises:
        WorkError: a session or an item cannot be read; nothing is freed before `verify` has said what to do.
    """
    with disk_faults_named(store.root):
        return _Collection(store, grace_s, dry_run, before).made()


class _Collection:
    """One going through the store."""

    def __init__(self, store: Store, grace_s: float, dry_run: bool, before: Callable[[Path], None]) -> None:
        self._store, self._dry_run, self._before = store, dry_run, before
        self._freed = Freed()
        self._pretended: Counter[tuple[int, int]] = Counter()
        self._doomed: set[Path] = set()
        began = time.time_ns() if dry_run else store.scratch.now_ns()
        self._limit = began - int(grace_s * 1e9)
        if not dry_run and grace_s < 5:
            store.scratch.next_ns(began)  # what is used from here on is younger than the limit

    def made(self) -> Freed:
        sessions = self._sessions()
        all_items(self._store)  # one that cannot be read is said before anything is freed
        self._free_results(sessions)
        self._free_pictures(sessions)
        self._free_items()
        self._free_chunks()
        self._free_quarantined()
        if self._dry_run:
            for path in self._store.scratch.leavings():
                self._pretend(path)
        else:
            self._store.scratch.sweep(self._count)
            self._store.scratch.leave()
        return self._freed

    # what there is

    def _sessions(self) -> dict[str, Session]:
        """The sessions as they are now. A folder that cannot be listed must not pass for an empty one."""
        folders = _listed(self._store.sessions)
        if not (self._store.root / NAME).is_file():
            raise gone(self._store.root)
        for folder in folders:
            if os.path.lexists(folder / "raw.zarr") and not (folder / "session.json").exists():
                remedy = f"it is gone; import the capture folder of session '{folder.name}' again"
                raise DamagedFileError(folder / "session.json", remedy)
        names = [folder.name for folder in folders if (folder / "session.json").exists()]
        return {name: read_session(name, self._store) for name in names}

    def _old(self, path: Path) -> bool:
        try:
            return path.stat(follow_symlinks=False).st_mtime_ns <= self._limit
        except FileNotFoundError:
            return False

    def _referred(self) -> set[str]:
        """The chunks that something refers to now."""
        blobs = {ref.blob for session in self._sessions().values() for ref in session.refs()}
        for item in all_items(self._store):
            if self._store.calibration / item.name not in self._doomed:
                blobs |= {picture.chunk.blob for picture in item.pictures.values()}
        for node in _nodes(self._store):
            for group in _groups(node):
                if group not in self._doomed:
                    record = provenance(node.parent.name, node.name, group.name, self._store) or {}
                    blobs |= {ref[1] for refs in record.get("chunks", {}).values() for ref in refs.values()}
        return blobs

    # what goes

    def _free_results(self, sessions: Iterable[str]) -> None:
        for node in _nodes(self._store):
            in_use = _in_use(node, self._store) if node.parent.name in sessions else set()
            for group in _groups(node):
                note = note_path(group)
                if group.name not in in_use and self._old(note if note.exists() else group):
                    self._freed.results += self._free_result(group, note)
            if node.parent.name not in sessions and not self._dry_run and self._old(node):
                _clear(node)

    def _free_result(self, group: Path, note: Path) -> bool:
        def used(aside: Path) -> bool:
            return _named(group.parent) == group.name or (note.exists() and not self._old(note))

        if not self._free(group, used) and group.exists():
            return False
        # where a run has published it again since, this is the new note, or the group stands there
        self._free(note, lambda aside: group.exists() or not self._old(aside))
        return True

    def _free_pictures(self, sessions: Iterable[str]) -> None:
        """The groups of older pictures, and of imports that were killed, with their notes."""
        for folder in _listed(self._store.sessions):
            for path in sorted(folder.glob(".raw-*")):
                if self._old(path) and not self._shown(path):
                    self._free(path, self._shown_at(path))
            if folder.name not in sessions and not self._dry_run and self._old(folder):
                _clear(folder)

    def _shown_at(self, path: Path) -> Callable[[Path], bool]:
        return lambda aside: self._shown(path)

    def _shown(self, path: Path) -> bool:
        """Whether a group of pictures, or its note, is of its session as it is now."""
        name = path.parent.name
        shown = {(path.parent / "raw.zarr").resolve().stem}
        if (path.parent / "session.json").is_file():
            shown.add(raw_group(read_session(name, self._store), self._store).stem)
        return path.stem in shown

    def _free_items(self) -> None:
        bound = self._bound()
        for item in all_items(self._store):
            folder = self._store.calibration / item.name

            def used(aside: Path, name: str = item.name) -> bool:
                return not self._old(aside / "item.json") or name in self._bound()

            if item.name not in bound and self._old(folder / "item.json"):
                self._freed.items += self._free(folder, used)

    def _bound(self) -> set[str]:
        return {
            f"{kind}-{digest[:SHORT]}"
            for session in self._sessions().values()
            for kind, digest in session.items.items()
        }

    def _free_chunks(self) -> None:
        referred = self._referred()
        lost = {}
        for entry in files_below(self._store.chunks.folder):
            status = entry.stat(follow_symlinks=False)
            if entry.name not in referred and status.st_mtime_ns <= self._limit:
                lost[entry.name] = Path(entry.path), status.st_nlink
        # records first: a chunk without a record is garbage, a record without its chunk is computed again
        for kind in KINDS if lost else ():
            for path in self._store.records.files(kind):
                if self._old(path) and blobs_named(path) & lost.keys():
                    self._freed.records += self._free(path, lambda aside: not self._old(aside))
        for path, links in lost.values():
            self._freed.chunks += self._free(path, self._taken_up(links))

    def _free_quarantined(self) -> None:
        """Damaged chunks, which are kept for as long as somebody may want to look at them."""
        for entry in list(files_below(self._store.quarantine)):
            path = Path(entry.path)
            if self._old(path):
                self._freed.chunks += self._free(path, lambda aside: not self._old(aside))

    def _taken_up(self, links: int) -> Callable[[Path], bool]:
        """Whether a chunk has been renewed, or has more names than it had."""
        return lambda aside: not self._old(aside) or aside.stat().st_nlink > links

    def _free(self, path: Path, used: Callable[[Path], bool]) -> bool:
        """Free a file or a folder unless it is used by now; says whether it did.

        Args:
            path: where it lies.
            used: whether somebody has come to use it, asked when it has been taken aside to the path given.
        """
        if self._dry_run:
            self._doomed.add(path)
            self._pretend(path)
            return True
        self._before(path)
        aside = self._store.scratch.path()
        try:
            os.rename(path, aside)
        except FileNotFoundError:
            return False
        if used(aside):
            put_back(self._store.scratch, aside, path)
            return False
        delete(aside, self._count)
        return True

    # how much it is

    def _count(self, status: os.stat_result) -> None:
        """A name of a file goes; its bytes do with the last."""
        inode = status.st_dev, status.st_ino
        if status.st_nlink - self._pretended[inode] <= 1:
            self._freed.size += status.st_size
        if self._dry_run and status.st_nlink > 1:
            self._pretended[inode] += 1

    def _pretend(self, path: Path) -> None:
        if path.is_dir() and not path.is_symlink():
            for entry in files_below(path):
                self._count(entry.stat(follow_symlinks=False))
        else:
            with contextlib.suppress(FileNotFoundError):
                self._count(path.stat(follow_symlinks=False))


def _listed(folder: Path) -> list[Path]:
    """The folders in a folder; unlike a glob, this says when it cannot look."""
    try:
        return sorted(Path(entry.path) for entry in os.scandir(folder) if entry.is_dir(follow_symlinks=False))
    except FileNotFoundError:
        return []


def _nodes(store: Store) -> list[Path]:
    return [node for session in _listed(store.results) for node in _listed(session)]


def _groups(node: Path) -> list[Path]:
    """The results of a node, also those of which only the group or only the note is there."""
    return [node / name for name in sorted({path.name.removesuffix(".json") for path in node.glob("*-*")})]


def _clear(folder: Path) -> None:
    """Take away what is left of a session that is not in the store, where nothing else is in it."""
    names = set(os.listdir(folder))
    if names <= {"current", ".lock", "raw.json"}:
        with contextlib.suppress(OSError):  # a run or an import that is just beginning here
            for name in names:
                (folder / name).unlink()
            folder.rmdir()
            if folder.parent.parent.name == "results":
                folder.parent.rmdir()


def _named(node: Path) -> str | None:
    """What `current` names, whether it is there or not."""
    try:
        return (node / "current").read_text(encoding="utf-8").strip()
    except (FileNotFoundError, NotADirectoryError):
        return None


def _in_use(node: Path, store: Store) -> set[str]:
    """The result that `current` names, and the newest complete one while that is partial."""
    session = node.parent.name
    name = current(session, node.name, store)
    if name is None:
        return set()
    if not _partial(node / name):
        return {name}
    finished = {}
    for group in _groups(node):
        if group.is_dir() and note_path(group).is_file() and not _partial(group):
            finished[group.name] = str(
                (provenance(session, node.name, group.name, store) or {}).get("finished", "")
            )
    return {name, *([max(finished, key=lambda n: finished[n])] if finished else [])}


def _partial(group: Path) -> bool:
    try:
        return "partial" in json.loads((group / "zarr.json").read_bytes()).get("attributes", {})
    except (OSError, ValueError):
        return False

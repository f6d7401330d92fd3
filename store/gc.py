"""Freeing what nothing refers to."""

import json
import time
from dataclasses import dataclass
from pathlib import Path

from store.calibration import all_items
from store.digest import SHORT
from store.files import files_below
from store.records import blobs_named
from store.results import current, provenance
from store.root import Store
from store.sessions import read_session, session_names


@dataclass
class Freed:
    """What `gc` frees, or would free."""

    results: int = 0
    chunks: int = 0
    records: int = 0
    items: int = 0
    size: int = 0


def gc(store: Store, *, grace_s: float, dry_run: bool) -> Freed:
    """Free what no session and no result in use refers to.

    In use are: all sessions, the calibration items bound to them, and per node the result that `current` names
    and, while that is a partial one, the newest complete one. Anything younger than `grace_s` seconds stays,
    because a run in progress may be about to use it.

    Raises:
        WorkError: a session or an item cannot be read; nothing is freed before `verify` has said what to do.
    """
    freed = Freed()
    now = time.time()

    def old(path: Path) -> bool:
        try:
            return now - path.stat(follow_symlinks=False).st_ctime >= grace_s
        except FileNotFoundError:
            return False

    sessions = [read_session(name, store) for name in session_names(store)]
    keep = {ref.blob for session in sessions for ref in session.refs()}
    bound = {f"{kind}-{digest[:SHORT]}" for session in sessions for kind, digest in session.items.items()}
    folders: list[Path] = []
    for session in sessions:
        shown = (store.sessions / session.name / "raw.zarr").resolve()
        folders += [p for p in (store.sessions / session.name).glob(".raw-*") if p.stem != shown.stem and old(p)]
    for node in sorted(path for path in store.results.glob("*/*") if path.is_dir()):
        known = node.parent.name in {session.name for session in sessions}
        in_use = _in_use(node, store) if known else set()
        for name in sorted({path.name.removesuffix(".json") for path in node.glob("*-*")}):
            group, note = node / name, node / f"{name}.json"
            if name in in_use or not old(note if note.exists() else group):
                made = provenance(node.parent.name, node.name, name, store) or {}
                keep |= {ref[1] for refs in made.get("chunks", {}).values() for ref in refs.values()}
            else:
                folders += [group, note]
                freed.results += 1
    for item in all_items(store):
        folder = store.calibration / item.name
        if item.name in bound or not old(folder / "item.json"):
            keep |= {picture.chunk.blob for picture in item.pictures.values()}
        else:
            folders.append(folder)
            freed.items += 1
    lost = {entry.name: entry for entry in files_below(store.chunks.folder) if entry.name not in keep}
    lost = {name: entry for name, entry in lost.items() if old(Path(entry.path))}
    records = [
        path
        for kind in ("blocks", "nodes", "runs")
        for path in store.records.files(kind)
        if old(path) and blobs_named(path) & lost.keys()
    ]
    freed.chunks, freed.records = len(lost), len(records)
    freed.size = sum(entry.stat().st_size for entry in lost.values())
    if not dry_run:
        # records first: a chunk without a record is garbage, a record without its chunk is computed again
        for path in records:
            path.unlink(missing_ok=True)
        for path in folders:
            store.scratch.remove(path)
        for entry in lost.values():
            if old(Path(entry.path)):  # a run may have taken it up in the meantime
                Path(entry.path).unlink(missing_ok=True)
        for path in (p for p in store.results.glob("*") if p.is_dir() and p.name not in {s.name for s in sessions}):
            for node in path.iterdir():
                if not any(node.glob("*-*")):
                    store.scratch.remove(node)
        store.scratch.sweep()
        store.scratch.leave()
    return freed


def _in_use(node: Path, store: Store) -> set[str]:
    """The result that `current` names, and the newest complete one while that is partial."""
    session = node.parent.name
    name = current(session, node.name, store)
    if name is None:
        return set()
    if not _partial(node / name):
        return {name}
    finished = {}
    for note in node.glob("*-*.json"):
        group = note.with_suffix("")
        if group.is_dir() and not _partial(group):
            finished[group.name] = str(
                (provenance(session, node.name, group.name, store) or {}).get("finished", "")
            )
    return {name, *([max(finished, key=lambda n: finished[n])] if finished else [])}


def _partial(group: Path) -> bool:
    try:
        return "partial" in json.loads((group / "zarr.json").read_bytes()).get("attributes", {})
    except (OSError, ValueError):
        return False

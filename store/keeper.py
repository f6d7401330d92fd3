"""Looking after the store: `verify` reads every byte, `gc` frees what nothing refers to."""

import contextlib
import json
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from store.calibration import Item, all_items
from store.digest import SHORT, digest_bytes
from store.errors import LightstageError
from store.files import link_or_copy
from store.results import current, provenance
from store.root import Store
from store.sessions import Session, read_session, session_names, show_raw

Progress = Callable[[Iterable[Any], int, str], Iterable[Any]]


@dataclass(frozen=True)
class Damage:
    """One thing that is damaged or gone."""

    path: Path
    belongs_to: str
    remedy: str
    recomputable: bool
    """Whether the next run mends it by itself."""


@dataclass
class Verified:
    """What `verify` read and found."""

    chunks: int = 0
    size: int = 0
    damaged: list[Damage] = field(default_factory=list)


@dataclass(frozen=True)
class _Owner:
    """What a chunk belongs to."""

    text: str
    remedy: str
    recomputable: bool


_AGAIN = "the next run makes it again"


def verify(store: Store, *, progress: Progress | None = None) -> Verified:
    """Read every stored chunk under every name that it has, and see that everything that is referred to is there.

    A chunk that is intact under one of its names is restored under the others. One that is not goes into
    quarantine with the records and results that refer to it, and the next run makes it again; a raw picture
    must be imported again. Nothing that is intact is removed.
    """
    report = Verified()
    checked: dict[tuple[int, int], bool] = {}
    blobs = [Path(entry.path) for entry in _files(store.chunks.folder)]
    bad: set[str] = set()
    for path in progress(blobs, len(blobs), "chunks") if progress else blobs:
        with contextlib.suppress(FileNotFoundError):  # gc may be at work beside us
            stat = path.stat()
            data = path.read_bytes()
            report.chunks += 1
            report.size += len(data)
            checked[stat.st_dev, stat.st_ino] = good = digest_bytes(data) == path.name
            if not good:
                bad.add(path.name)
    sessions, items = _readable(store, report)
    views = _views(store, sessions)
    owners = _owners(sessions, items, views)
    bad |= {blob for blob in owners if not store.chunks.path(blob).is_file()}
    restored = _restore(store, bad, views, report)
    _mend_views(store, bad - restored, views, checked, report)
    for blob in sorted(bad - restored):
        owner = owners.get(blob, _Owner("nothing that is in use", "nothing needs to be done", True))
        report.damaged.append(Damage(store.chunks.path(blob), owner.text, owner.remedy, owner.recomputable))
    _quarantine(store, bad - restored, views)
    return report


def _files(folder: Path) -> Iterator["os.DirEntry[str]"]:
    if not folder.is_dir():
        return
    for entry in sorted(os.scandir(folder), key=lambda item: item.name):
        if entry.is_dir(follow_symlinks=False):
            yield from _files(Path(entry.path))
        else:
            yield entry


def _readable(store: Store, report: Verified) -> tuple[list[Session], list[Item]]:
    """Sessions and items; one that cannot be read is reported."""
    sessions = []
    for name in session_names(store):
        try:
            sessions.append(read_session(name, store))
        except LightstageError as error:
            path = store.sessions / name / "session.json"
            report.damaged.append(Damage(path, f"session {name}", str(error), False))
    items = []
    try:
        items = all_items(store)
    except LightstageError as error:
        report.damaged.append(Damage(store.calibration, "a calibration item", str(error), False))
    return sessions, items


@dataclass(frozen=True)
class _View:
    """A group that anyone can open, and what its files should be."""

    group: Path
    links: Mapping[str, str]
    """File -> blob, for chunks."""
    own: Mapping[str, str]
    """File -> digest, for metadata and coordinates; empty where it is not known."""
    session: Session | None
    """The session, when this is its raw group."""


def _views(store: Store, sessions: Iterable[Session]) -> list[_View]:
    views = []
    for session in sessions:
        link = store.sessions / session.name / "raw.zarr"
        links = {
            f"raw/c/{f}/{b}/{p}/0/0": ref.blob
            for f, frame in enumerate(session.images)
            for b, band in enumerate(frame)
            for p, ref in enumerate(band)
        }
        if session.mask is not None:
            links["mask/c/0/0"] = session.mask.chunk.blob
        views.append(_View(link.resolve(), links, {}, session))
    for group in sorted(path for path in store.results.glob("*/*/*-*") if path.is_dir()):
        made = provenance(group.parent.parent.name, group.parent.name, group.name, store) or {}
        chunks = made.get("chunks", {})
        links = {f"{array}/c/{index}": ref[1] for array, refs in chunks.items() for index, ref in refs.items()}
        # a group without its note, or with a damaged one, has no known file: it is made again
        views.append(_View(group, links, made.get("files", {"zarr.json": "not known"}), None))
    return views


def _owners(sessions: Iterable[Session], items: Iterable[Item], views: Iterable[_View]) -> dict[str, _Owner]:
    """Everything that refers to a chunk, by blob; a raw picture speaks louder than what was made of it."""
    owners: dict[str, _Owner] = {}
    for view in views:
        if view.session is None:
            node = f"{view.group.parent.parent.name}/{view.group.parent.name}"
            for file, blob in view.links.items():
                array, _, index = file.partition("/c/")
                owners[blob] = _Owner(f"{node}, array {array}, chunk {index}", _AGAIN, True)
    for item in items:
        for camera, picture in item.pictures.items():
            remedy = "import the capture that it came with again"
            owners[picture.chunk.blob] = _Owner(f"calibration item {item.name}, {camera}", remedy, False)
    for session in sessions:
        remedy = f"import {session.source['folder']} again"
        for label, blob in _labelled(session):
            owners[blob] = _Owner(f"session {session.name}, {label}", remedy, False)
    return owners


def _labelled(session: Session) -> Iterator[tuple[str, str]]:
    facts = session.facts
    for f, frame in enumerate(session.images):
        for b, band in enumerate(frame):
            for p, ref in enumerate(band):
                yield (
                    f"raw picture of frame {f} ({facts['illumination'][f]}), band {facts['bands_nm'][b]:g}, "
                    f"{session.polarisations[p]}",
                    ref.blob,
                )
    if session.mask is not None:
        yield "mask", session.mask.chunk.blob


def _restore(store: Store, bad: set[str], views: Iterable[_View], report: Verified) -> set[str]:
    """Chunks whose bytes are still right in a group that holds them are taken back from there."""
    restored: set[str] = set()
    for view in views:
        for file, blob in view.links.items():
            path = view.group / file
            if blob not in bad or blob in restored or not path.is_file() or digest_bytes(path.read_bytes()) != blob:
                continue
            target = store.chunks.path(blob)
            store.scratch.remove(target)
            target.parent.mkdir(parents=True, exist_ok=True)
            link_or_copy(path, target)
            restored.add(blob)
            text = "restored from the group that holds it too; nothing needs to be done"
            report.damaged.append(Damage(target, str(path.relative_to(store.root)), text, True))
    return restored


def _mend_views(
    store: Store, bad: set[str], views: Iterable[_View], checked: dict[tuple[int, int], bool], report: Verified
) -> None:
    """Chunk files that are wrong or gone are linked anew; a group whose own files are wrong is made again."""
    for view in views:
        name = str(view.group.relative_to(store.root))
        own_wrong = [f for f, digest in view.own.items() if _digest_of(view.group / f) != digest]
        if view.session is not None and not (view.group / "zarr.json").is_file():
            own_wrong = ["zarr.json"]
        for file in own_wrong:
            report.damaged.append(Damage(view.group / file, name, _AGAIN, True))
        if own_wrong:
            store.scratch.remove(view.group)
            continue
        for file, blob in view.links.items():
            path = view.group / file
            try:
                stat = path.stat()
                good = checked.get((stat.st_dev, stat.st_ino))
                if good is None:  # a copy, or a link that somebody broke
                    good = digest_bytes(path.read_bytes()) == blob
            except FileNotFoundError:
                good = False
            if not good and blob not in bad:
                store.scratch.remove(path)
                path.parent.mkdir(parents=True, exist_ok=True)
                link_or_copy(store.chunks.path(blob), path)
                text = "restored from the stored chunk; nothing needs to be done"
                report.damaged.append(Damage(path, name, text, True))
        if view.session is not None and not bad & set(view.links.values()):
            show_raw(view.session, store)


def _digest_of(path: Path) -> str | None:
    try:
        return digest_bytes(path.read_bytes())
    except OSError:
        return None


def _quarantine(store: Store, bad: set[str], views: Iterable[_View]) -> None:
    if not bad:
        return
    store.quarantine.mkdir(parents=True, exist_ok=True)
    for blob in bad:
        with contextlib.suppress(FileNotFoundError):
            os.replace(store.chunks.path(blob), store.quarantine / blob)
    for kind in ("blocks", "nodes", "runs"):
        for path in list(store.records.files(kind)):
            with contextlib.suppress(FileNotFoundError):
                if _blobs_named(path) & bad:
                    path.unlink()
    for view in views:
        wrong = [file for file, blob in view.links.items() if blob in bad]
        if view.session is None and wrong:
            store.scratch.remove(view.group)
        for file in wrong:  # of a raw group: the other pictures stay readable
            (view.group / file).unlink(missing_ok=True)


def _blobs_named(record: Path) -> set[str]:
    return set(re.findall(r"[0-9a-f]{32}", record.read_text()))


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
        folders += [p for p in (store.sessions / session.name).glob(".raw-*.zarr") if p != shown and old(p)]
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
    lost = {entry.name: entry for entry in _files(store.chunks.folder) if entry.name not in keep}
    lost = {name: entry for name, entry in lost.items() if old(Path(entry.path))}
    records = [
        path
        for kind in ("blocks", "nodes", "runs")
        for path in store.records.files(kind)
        if old(path) and _blobs_named(path) & lost.keys()
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

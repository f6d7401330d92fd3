"""Looking after the store: `verify` reads every byte, mends what can be mended and names the rest."""

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from store.calibration import Item, all_items
from store.digest import digest_bytes
from store.errors import LightstageError
from store.files import files_below, link_or_copy
from store.records import blobs_named
from store.results import provenance
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
    blobs = [Path(entry.path) for entry in files_below(store.chunks.folder)]
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
                if blobs_named(path) & bad:
                    path.unlink()
    for view in views:
        wrong = [file for file, blob in view.links.items() if blob in bad]
        if view.session is None and wrong:
            store.scratch.remove(view.group)
        for file in wrong:  # of a raw group: the other pictures stay readable
            (view.group / file).unlink(missing_ok=True)

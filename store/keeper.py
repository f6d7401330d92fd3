"""Looking after the store: `verify` reads every byte, `gc` frees what nothing refers to."""

import json
import os
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from store.calibration import all_items
from store.digest import digest_bytes
from store.results import current
from store.root import Store
from store.sessions import Session, read_session, session_names

Progress = Callable[[Iterable[Any], int, str], Iterable[Any]]


@dataclass(frozen=True)
class Damage:
    """One damaged chunk."""

    blob: str
    path: Path
    belongs_to: str
    remedy: str


@dataclass
class Verified:
    """What `verify` read and found."""

    chunks: int = 0
    size: int = 0
    damaged: list[Damage] = field(default_factory=list)


def verify(store: Store, *, progress: Progress | None = None) -> Verified:
    """Read every stored chunk, under every name that it has, and take damaged ones into quarantine.

    What refers to a damaged chunk (block, node and run records, result groups) is taken out with it, so that
    the next run computes it again; a damaged raw picture must be imported again.
    """
    report = Verified()
    bad: dict[str, Path] = {}
    checked: dict[tuple[int, int], bool] = {}
    blobs = [Path(entry.path) for entry in _files(store.chunks.folder)]
    for path in progress(blobs, len(blobs), "chunks") if progress else blobs:
        stat = path.stat()
        data = path.read_bytes()
        report.chunks += 1
        report.size += len(data)
        good = digest_bytes(data) == path.name
        checked[stat.st_dev, stat.st_ino] = good
        if not good:
            bad[path.name] = path
    damaged_views = dict(_damaged_views(store, checked))
    owners = _owners(store, set(bad) | set(damaged_views.values()))
    for blob, path in bad.items():
        text, remedy = owners.get(blob, ("nothing that is in use", "nothing needs to be done"))
        report.damaged.append(Damage(blob, path, text, remedy))
    for view, blob in damaged_views.items():
        if blob not in bad:
            text = f"{view.relative_to(store.root)}"
            remedy = owners.get(blob, ("", "the next run restores it from the intact copy"))[1]
            report.damaged.append(Damage(blob, view, text, remedy))
    _quarantine(store, bad, damaged_views)
    return report


def quarantine_chunk(store: Store, blob: str) -> str:
    """Take one damaged chunk out, and all that refers to it; says what it belonged to and what to do."""
    path = store.chunks.path(blob)
    owner, remedy = _owners(store, {blob}).get(blob, ("nothing that is in use", "nothing needs to be done"))
    _quarantine(store, {blob: path}, {})
    return f"{owner}; {remedy}"


def _files(folder: Path) -> Iterator[os.DirEntry[str]]:
    if not folder.is_dir():
        return
    for entry in sorted(os.scandir(folder), key=lambda item: item.name):
        if entry.is_dir(follow_symlinks=False):
            yield from _files(Path(entry.path))
        else:
            yield entry


def _groups(store: Store) -> Iterator[Path]:
    for pattern in ("sessions/*/.raw-*.zarr", "results/*/*/*-*/"):
        yield from sorted(path for path in store.root.glob(pattern) if path.is_dir())


def _damaged_views(store: Store, checked: dict[tuple[int, int], bool]) -> Iterator[tuple[Path, str]]:
    """Chunk files of the groups whose bytes are wrong, with the blob that they should hold."""
    by_group = _expected_blobs(store)
    for group in _groups(store):
        expected = by_group.get(group, {})
        for entry in _files(group):
            relative = Path(entry.path).relative_to(group).as_posix()
            if relative not in expected:
                continue
            stat = entry.stat(follow_symlinks=False)
            good = checked.get((stat.st_dev, stat.st_ino))
            if good is None:  # a copy, or a link that somebody broke
                good = digest_bytes(Path(entry.path).read_bytes()) == expected[relative]
            if not good:
                yield Path(entry.path), expected[relative]


def _expected_blobs(store: Store) -> dict[Path, dict[str, str]]:
    """For every group, which blob each chunk file links to."""
    expected: dict[Path, dict[str, str]] = {}
    for name in session_names(store):
        session = read_session(name, store)
        link = store.sessions / name / "raw.zarr"
        if link.exists():
            expected[link.resolve()] = {
                f"raw/c/{f}/{b}/{p}/0/0": ref.blob
                for f, frame in enumerate(session.images)
                for b, band in enumerate(frame)
                for p, ref in enumerate(band)
            }
    for path in store.results.glob("*/*/*-*.json"):
        chunks = json.loads(path.read_bytes()).get("chunks", {})
        expected[path.with_suffix("")] = {
            f"{array}/c/{index}": ref[1] for array, refs in chunks.items() for index, ref in refs.items()
        }
    return expected


def _owners(store: Store, blobs: set[str]) -> dict[str, tuple[str, str]]:
    """What a blob belongs to, in words, and what to do when it is damaged."""
    owners: dict[str, tuple[str, str]] = {}
    if not blobs:
        return owners
    for path in store.results.glob("*/*/*-*.json"):
        plain = json.loads(path.read_bytes())
        for array, refs in plain.get("chunks", {}).items():
            for index, ref in refs.items():
                if ref[1] in blobs:
                    place = f"{path.parent.parent.name}/{path.parent.name}, array {array}, chunk {index}"
                    owners[ref[1]] = (place, "the next run computes it again")
    for item in all_items(store):
        for camera, picture in item.pictures.items():
            if picture.chunk.blob in blobs:
                owners[picture.chunk.blob] = (
                    f"calibration item {item.name}, {camera}",
                    "import the capture that it came with again",
                )
    for name in session_names(store):
        session = read_session(name, store)
        for label, ref in _labelled(session):
            if ref in blobs:
                owners[ref] = (
                    f"session {name}, {label}",
                    f"import {session.source['folder']} again",
                )
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


def _quarantine(store: Store, bad: dict[str, Path], views: dict[Path, str]) -> None:
    for group, expected in _expected_blobs(store).items():
        wrong_link = any(view.is_relative_to(group) for view in views)
        if not (wrong_link or any(blob in bad for blob in expected.values())):
            continue
        shutil.rmtree(group)  # a hard link to the damaged file; the next run or import links it anew
    store.quarantine.mkdir(parents=True, exist_ok=True)
    for blob, path in bad.items():
        if path.exists():
            os.replace(path, store.quarantine / blob)
    for kind in ("blocks", "nodes", "runs"):
        for path in list(store.records.files(kind)):
            text = path.read_text()
            if any(blob in text for blob in bad):
                path.unlink(missing_ok=True)


@dataclass
class Freed:
    """What `gc` frees, or would free."""

    results: int = 0
    chunks: int = 0
    records: int = 0
    items: int = 0
    size: int = 0
    paths: list[Path] = field(default_factory=list)


def gc(store: Store, *, grace_s: float, dry_run: bool) -> Freed:
    """Free what no session and no result in use refers to.

    In use are: all sessions, the calibration items bound to them, and per node the result that `current`
    names. Anything younger than `grace_s` seconds stays, because a run in progress may be about to use it.
    """
    now = time.time()
    freed = Freed()
    keep: set[str] = set()
    items_in_use: set[str] = set()

    def old(path: Path) -> bool:
        try:
            return now - path.stat(follow_symlinks=False).st_ctime >= grace_s
        except FileNotFoundError:
            return False

    doomed: list[Path] = []
    for name in session_names(store):
        session = read_session(name, store)
        keep |= {ref.blob for ref in session.refs()}
        items_in_use |= {f"{kind}-{digest[:12]}" for kind, digest in session.items.items()}
        link = store.sessions / name / "raw.zarr"
        stale = [p for p in (store.sessions / name).glob(".raw-*.zarr") if p != link.resolve()]
        doomed += [path for path in stale if old(path)]
    for node in sorted(store.results.glob("*/*/")):
        in_use = current(node.parent.name, node.name, store)
        for sidecar in sorted(node.glob("*-*.json")):
            group = sidecar.with_suffix("")
            if group.name == in_use or not old(sidecar):
                plain = json.loads(sidecar.read_bytes())
                keep |= {ref[1] for refs in plain.get("chunks", {}).values() for ref in refs.values()}
            else:
                doomed += [group, sidecar]
                freed.results += 1
    for item in all_items(store):
        folder = store.calibration / item.name
        if item.name in items_in_use or not old(folder / "item.json"):
            keep |= {picture.chunk.blob for picture in item.pictures.values()}
        else:
            doomed.append(folder)
            freed.items += 1
    lost: set[str] = set()
    for entry in _files(store.chunks.folder):
        path = Path(entry.path)
        if entry.name not in keep and old(path):
            freed.chunks += 1
            freed.size += entry.stat().st_size
            lost.add(entry.name)
            doomed.append(path)
    for path in store.records.files("blocks"):
        record = json.loads(path.read_bytes())
        if any(ref[1] in lost for refs in record["outputs"].values() for ref in refs):
            doomed.append(path)
            freed.records += 1
    for kind in ("nodes", "runs"):
        for path in store.records.files(kind):
            if old(path) and any(blob in path.read_text() for blob in lost):
                doomed.append(path)
                freed.records += 1
    freed.paths = doomed
    if not dry_run:
        # records first: a chunk without a record is garbage, a record without its chunk is computed again
        for path in sorted(doomed, key=lambda p: p.suffix != ".json"):
            shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink(missing_ok=True)
        store.scratch.sweep()
    return freed

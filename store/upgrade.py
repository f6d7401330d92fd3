"""Carrying an older store over, one format after the other.

A step (STEPS, by the format that it begins with) goes through the store and writes anew, file by file, what the
next format has otherwise; what it finds written so it leaves alone. So an upgrade can be stopped anywhere and goes
on where it was. `store.json` says "upgrading" from the first change to the last, and no command but this one takes
the store for its own meanwhile. Nothing is removed but short cuts, which are made again.
"""

import contextlib
import fcntl
import json
import os
import secrets
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from dataclasses import replace as changed
from functools import partial
from pathlib import Path
from typing import Any

from lightstage.store import marker
from lightstage.store.chunks import ChunkRef
from lightstage.store.digest import digest_bytes
from lightstage.store.errors import LightstageError, RequestError, WorkError
from lightstage.store.files import delete, disk_faults_named, files_below, replace
from lightstage.store.items import get_item, item_names
from lightstage.store.marker import FORMAT, DamagedMarkerError, Marker
from lightstage.store.notes import digest_of, own_place
from lightstage.store.records import BlockRecord
from lightstage.store.root import Store
from lightstage.store.sealed import is_sealed, seal
from lightstage.store.sessions import show_raw

Progress = Callable[[Iterable[Any], int, str], Iterable[Any]]


@dataclass
class Upgraded:
    """What an upgrade did."""

    began: int
    """The format that the store had; the present one where there was nothing to do."""
    carried: Counter[str] = field(default_factory=Counter)
    """How many of each kind of file were written anew."""
    left: list[str] = field(default_factory=list)
    """What could not be carried over, a line each; it lies where it lay."""


def upgrade(root: str | Path, *, progress: Progress | None = None) -> Upgraded:
    """Carry the store at `root` over to the format of this program.

    Raises:
        RequestError: there is no store, or one of a newer lightstage.
        WorkError: another process uses it.
    """
    store = Store.of_any_format(root)
    with disk_faults_named(store.root), _alone(store):
        old = _present_marker(store.root)
        refusal = marker.other_format(old, store.root)
        if old.format > FORMAT and refusal is not None:
            raise refusal
        done = Upgraded(old.format)
        if refusal is not None:
            _refuse_company(store)
            try:
                _carry(store, old, done, progress or _silently)
            finally:
                store.scratch.leave()
        return done


def _carry(store: Store, old: Marker, done: Upgraded, progress: Progress) -> None:
    path = store.root / marker.NAME
    present = Marker(old.format, old.id or secrets.token_hex(16), upgrading=True)
    for step in range(old.format, FORMAT):
        present = changed(present, format=step)
        replace(store.scratch, path, present.as_bytes())
        STEPS[step](store, done, progress)
        os.sync()  # a step is on the disk before the store says that it is done
    replace(store.scratch, path, changed(present, format=FORMAT, upgrading=False).as_bytes())


def _silently(things: Iterable[Any], count: int, label: str) -> Iterable[Any]:
    return things


def _present_marker(root: Path) -> Marker:
    try:
        present = marker.read(root)
    except DamagedMarkerError:
        return Marker(1, "", upgrading=True)  # whatever it was: each step leaves alone what it has done
    if present is None:
        raise RequestError(f"--store {root}: there is no store to upgrade")
    return present


@contextlib.contextmanager
def _alone(store: Store) -> Iterator[None]:
    try:
        folder = os.open(store.root, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except (FileNotFoundError, NotADirectoryError):
        raise RequestError(f"--store {store.root}: there is no store to upgrade") from None
    try:
        try:
            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise WorkError(f"another `lightstage upgrade` is at work in {store.root}; wait for it") from None
        except OSError:
            pass  # no locks here: two do the same twice, in steps that are whole each
        yield
    finally:
        os.close(folder)


def _refuse_company(store: Store) -> None:
    others = store.scratch.others()
    if others:
        raise WorkError(
            f"the store {store.root} is in use by {', '.join(others)}; wait until that has ended (or remove the "
            "folder, if it has)"
        )


def _seal_all(store: Store, done: Upgraded, progress: Progress) -> None:
    """1 -> 2: sessions, items, records and notes are sealed, groups of pictures noted, and short cuts dropped; an
    array's chunk files are in one folder."""
    work: list[tuple[str, Callable[[bytes, Path], bytes], list[Path]]] = [
        ("items", _sealed_item, sorted(store.calibration.glob("*/item.json"))),
        ("sessions", _sealed_session, sorted(store.sessions.glob("*/session.json"))),
        ("results", partial(_flat_note, store), sorted(store.results.glob("*/*/*-*.json"))),
        ("records", _sealed_record, list(store.records.files("blocks"))),
    ]
    for kind, sealed, paths in work:
        for path in progress(paths, len(paths), kind):
            data = path.read_bytes()
            if is_sealed(data):
                continue
            try:
                replace(store.scratch, path, sealed(data, path), durable=False)
                done.carried[kind] += 1
            except (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError):
                done.left.append(f"{path} is damaged; `lightstage verify` says what can be done")
    names = sorted(path.parent.name for path in store.sessions.glob("*/session.json"))
    for name in progress(names, len(names), "pictures"):
        with _faults_noted(done):
            show_raw(name, store)
    for kind, digits in item_names(store):
        with _faults_noted(done):
            get_item(kind, digits, store)
    for kind in ("nodes", "runs"):
        delete(store.records.folder / kind)


@contextlib.contextmanager
def _faults_noted(done: Upgraded) -> Iterator[None]:
    try:
        yield
    except LightstageError as error:
        done.left.append(str(error))


def _sealed_item(data: bytes, path: Path) -> bytes:
    return seal({**json.loads(data), "original": path.with_name("item.yaml").read_text(encoding="utf-8")}, indent=1)


def _sealed_session(data: bytes, path: Path) -> bytes:
    return seal(json.loads(data))


def _flat_note(store: Store, data: bytes, path: Path) -> bytes:
    """The note of a group, whose chunk files are named in one folder an array from now on."""
    plain, group = json.loads(data), path.with_suffix("")
    chunks = {
        array: {index.replace("/", "."): ChunkRef.from_plain(ref).as_plain() for index, ref in refs.items()}
        for array, refs in plain["chunks"].items()
    }
    own = dict(plain["files"])
    if group.is_dir():
        for name, digest in own.items():
            _refuse_damaged(group, name, digest)
        _flatten(store, group)
        own = {_flat_name(name): str(digest_of(group / _flat_name(name))) for name in own}
    return seal({**plain, "chunks": chunks, "files": own, "group": own_place(group)}, indent=1)


def _flat_name(name: str) -> str:
    """`band/c/0/1` is `band/c.0.1`."""
    array, separator, index = name.partition("/c/")
    return f"{array}/c.{index.replace('/', '.')}" if separator else name


def _refuse_damaged(group: Path, name: str, digest: str) -> None:
    """What is carried over must be what was noted, unless this command has carried it over before."""
    path = group / name
    try:
        data = (path if path.exists() else group / _flat_name(name)).read_bytes()
    except OSError:
        raise ValueError(path) from None
    if digest_bytes(data) != digest and not (path.name == "zarr.json" and data == _flat_metadata(data)):
        raise ValueError(path)


def _flatten(store: Store, group: Path) -> None:
    for nested in sorted(path for path in group.glob("*/c") if path.is_dir()):
        for entry in list(files_below(nested)):
            os.rename(entry.path, group / _flat_name(Path(entry.path).relative_to(group).as_posix()))
        delete(nested)
    # the metadata last: until then it is as it was noted
    for path in [*sorted(group.glob("*/zarr.json")), group / "zarr.json"]:
        data = path.read_bytes()
        if data != _flat_metadata(data):
            replace(store.scratch, path, _flat_metadata(data), durable=False)


def _flat_metadata(data: bytes) -> bytes:
    """A zarr.json whose arrays name their chunks so."""
    plain = json.loads(data)
    consolidated = (plain.get("consolidated_metadata") or {}).get("metadata") or {}
    for array in [plain, *consolidated.values()]:
        if array["node_type"] == "array":
            array["chunk_key_encoding"] = {"name": "default", "configuration": {"separator": "."}}
    return json.dumps(plain, indent=2).encode()


def _sealed_record(data: bytes, path: Path) -> bytes:
    record = BlockRecord.from_plain(json.loads(data))
    if record.key != path.stem:
        raise ValueError(path)
    return seal(record.as_plain())


STEPS: Mapping[int, Callable[[Store, Upgraded, Progress], None]] = {1: _seal_all}
"""By the format that a step begins with: what makes the next one of it."""

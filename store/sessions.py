"""Sessions: captures brought into the store.

    sessions/<session>/session.json   what the session is: its facts, its pictures by content, its items
    sessions/<session>/raw.zarr/      the pictures as anyone can open them

`session.json` is the truth, is sealed, and is replaced in one step; the pictures themselves are stored chunks. The
group `raw.zarr` is a link to the newest of the folders `.raw-<digest>.zarr` beside it, made of hard links to those
chunks, so that a run that is reading the old version is not disturbed by an import. A file system without symbolic
links has the newest one at `raw.zarr` itself, whose note `raw.json` says which version it is.

Whoever changes a session says from which session.json it was made. Where another command has put a newer one in
between, nothing is written, and the change is made again from that one. The comparison and the replacement are
one step under a lock on the file `.lock` beside them, which the kernel frees when its holder ends. On the few file
systems that cannot lock (NFS without its lock service) it is a comparison right before the replacement, and two
commands that meet within a millisecond can still lose one change.
"""

import contextlib
import errno
import fcntl
import math
import os
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

from lightstage.store import document, files
from lightstage.store.chunks import ChunkIndex, ChunkRef
from lightstage.store.digest import SHORT, digest_bytes, digest_value
from lightstage.store.errors import DamagedFileError, RequestError, WorkError
from lightstage.store.files import disk_faults_named
from lightstage.store.grid import ArrayTemplate, Coordinate, write_group
from lightstage.store.items import Item, StoredPicture
from lightstage.store.names import SESSION_NAME
from lightstage.store.notes import holds, note_path, read_note, whole, write_note
from lightstage.store.root import Store
from lightstage.store.sealed import seal, unseal

FORMAT = "lightstage-session/1"
PATIENCE_S = 30.0
"""How long a command waits for another that is just changing the session; that takes milliseconds."""
Progress = Callable[[Iterable[Any], int, str], Iterable[Any]]


class SessionChangedError(WorkError):
    """Another command has changed the session since it was read."""


@dataclass(frozen=True)
class Session:
    """An imported capture."""

    name: str
    facts: Mapping[str, Any]
    """What the capture says of itself: cameras, mount, white_level, bands_nm, illumination, ..."""
    shape: tuple[int, int]
    images: tuple[tuple[tuple[ChunkRef, ...], ...], ...]
    """By frame, band, polarisation."""
    mask: StoredPicture | None
    items: Mapping[str, str]
    """Bound calibration items: kind to digest."""
    source: Mapping[str, Any]
    """Folder, and per file the digest of its bytes and the planes it holds."""
    verdict: tuple[Mapping[str, Any], ...]
    digest: str
    """Of session.json, with everything in it."""

    @property
    def polarisations(self) -> tuple[str, ...]:
        """In the order of the axis."""
        return tuple(self.facts["polarisation"])

    @property
    def sizes(self) -> dict[str, int]:
        """Length of every dimension of `raw`."""
        height, width = self.shape
        lengths = (len(self.images), len(self.facts["bands_nm"]), len(self.polarisations), height, width)
        return dict(zip(("frame", "band", "polarisation", "y", "x"), lengths, strict=True))

    def refs(self) -> Iterable[ChunkRef]:
        """Every stored picture."""
        for frame in self.images:
            for band in frame:
                yield from band
        if self.mask is not None:
            yield self.mask.chunk

    @property
    def size(self) -> int:
        """Stored bytes of the pictures."""
        return sum(ref.size for ref in self.refs())


def session_names(store: Store) -> list[str]:
    """The sessions in the store."""
    return sorted(path.parent.name for path in store.sessions.glob("*/session.json"))


def read_session(name: str, store: Store) -> Session:
    """A session by name.

    Raises:
        RequestError: there is none of that name.
        DamagedFileError: its session.json is not as it was written.
    """
    data = _standing(name, store) if SESSION_NAME.fullmatch(name) else None
    if data is None:
        known = session_names(store)
        hint = document.nearest(name, known) or "; it holds none yet (`lightstage import FOLDER` brings one in)"
        raise RequestError(f"no session '{name}' in the store {store.root}{hint}") from None
    return _parsed(name, data, store)


def present_session(name: str, store: Store) -> tuple[Session | None, str | None]:
    """What stands under a name, for whoever is to replace it: the session, if it can be read, and the digest of its
    session.json, if there is one."""
    data = _standing(name, store)
    if data is None:
        return None, None
    try:
        return _parsed(name, data, store), digest_bytes(data)
    except DamagedFileError:
        return None, digest_bytes(data)


def _standing(name: str, store: Store) -> bytes | None:
    try:
        return (store.sessions / name / "session.json").read_bytes()
    except OSError:
        return None


def _parsed(name: str, data: bytes, store: Store) -> Session:
    path = store.sessions / name / "session.json"
    remedy = f"import the capture folder of session '{name}' again"
    plain = unseal(data, path, remedy)
    try:
        session = _from_plain(plain, digest_bytes(data))
    except (ValueError, KeyError, TypeError, IndexError):
        raise DamagedFileError(path, remedy) from None
    if session.name != name:
        raise DamagedFileError(path, remedy)
    return session


def _from_plain(plain: Mapping[str, Any], digest: str) -> Session:
    images = tuple(
        tuple(tuple(ChunkRef.from_plain(ref) for ref in band) for band in frame) for frame in plain["images"]
    )
    return Session(
        name=plain["session"],
        facts=plain["facts"],
        shape=(plain["shape"][0], plain["shape"][1]),
        images=images,
        mask=None if plain["mask"] is None else StoredPicture.from_plain(plain["mask"]),
        items=plain["items"],
        source=plain["source"],
        verdict=tuple(plain["verdict"]),
        digest=digest,
    )


def _as_plain(session: Session) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "session": session.name,
        "facts": dict(session.facts),
        "shape": list(session.shape),
        "images": [[[ref.as_plain() for ref in band] for band in frame] for frame in session.images],
        "mask": None if session.mask is None else session.mask.as_plain(),
        "items": dict(session.items),
        "source": dict(session.source),
        "verdict": [dict(row) for row in session.verdict],
    }


def bind_item(name: str, item: Item, store: Store) -> str | None:
    """Use another calibration item for a session from now on; returns the digest of the one bound before."""
    while True:
        session = read_session(name, store)
        before = session.items.get(item.kind)
        if before == item.digest:
            return before
        bound = changed(session, items={**session.items, item.kind: item.digest})
        with contextlib.suppress(SessionChangedError):
            commit_session(bound, store, expected=session.digest)
            return before


def restore_session(before: Session, after: Session, store: Store) -> None:
    """Let a session be again what it was before it became `after`, but for items that have been bound since."""
    while True:
        present = read_session(after.name, store)
        since = {kind: digest for kind, digest in present.items.items() if after.items.get(kind) != digest}
        with contextlib.suppress(SessionChangedError):
            commit_session(changed(before, items={**before.items, **since}), store, expected=present.digest)
            return


def remove_session(name: str, store: Store) -> int:
    """Take a session and its results out of the store; returns the bytes of its folders.

    Its chunks stay until `gc`, so that an import of the same capture costs little.
    """
    if name not in session_names(store):
        read_session(name, store)  # says which there are
    total = 0
    with _changing(name, store):
        # results first: what a kill leaves is then still a session, and can be removed again
        for folder in (store.results / name, store.sessions / name):
            if folder.exists():
                total += files.folder_size(folder)
                store.scratch.remove(folder)
    return total


def commit_session(session: Session, store: Store, *, expected: str | None) -> Session:
    """Let a session be what it says: its pictures as a group first, then session.json, then the link.

    Args:
        session: as it is to be.
        store: where.
        expected: digest of the session.json that it was made from; None for a new session.

    Raises:
        SessionChangedError: another one stands there by now; nothing was changed.
    """
    data = seal(_as_plain(session))
    session = changed(session, digest=digest_bytes(data))
    _expect(expected, session.name, store)
    write_raw(session, store)
    with _changing(session.name, store, new=expected is None):
        _expect(expected, session.name, store)
        files.replace(store.scratch, store.sessions / session.name / "session.json", data)
        _link_raw(session, store)
    return session


def _expect(digest: str | None, name: str, store: Store) -> None:
    data = _standing(name, store)
    if (None if data is None else digest_bytes(data)) != digest:
        raise SessionChangedError(f"session '{name}' was changed by another command; run again")


@contextlib.contextmanager
def _changing(name: str, store: Store, *, new: bool = False) -> Iterator[None]:
    """Alone in changing a session, or in making a new one."""
    path = store.sessions / name / ".lock"
    give_up = time.monotonic() + PATIENCE_S
    while True:
        with disk_faults_named(path):
            if new:
                store.scratch.make_folder(path.parent)
            try:
                file = open(path, "wb")  # noqa: SIM115
            except FileNotFoundError:
                if new:
                    continue  # made between, and removed again
                raise SessionChangedError(f"session '{name}' was removed by another command") from None
        with file:
            while not _locked(file.fileno()):
                if time.monotonic() > give_up:
                    raise WorkError(
                        f"another command has been changing session '{name}' for {PATIENCE_S:g} s; "
                        "see whether it has been stopped, and try again"
                    )
                time.sleep(0.01)
            try:
                alone = os.path.samestat(os.fstat(file.fileno()), os.stat(path))
            except FileNotFoundError:
                alone = False  # it was the lock of a session that has been removed in the meantime
            if alone:
                yield
                return


def _locked(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL):
            raise
    return True


def raw_group(session: Session, store: Store) -> Path:
    """The group of a session's pictures: of this version, whatever `raw.zarr` shows.

    Where `raw.zarr` is no link but this version itself, that is the group.
    """
    content = {
        "facts": session.facts,
        "images": [[[ref.blob for ref in band] for band in frame] for frame in session.images],
        "mask": session.mask and session.mask.chunk.blob,
    }
    hidden = store.sessions / session.name / f".raw-{digest_value(content)[:SHORT]}.zarr"
    shown = hidden.with_name("raw.zarr")
    return shown if _version(shown) == hidden.name else hidden


def _version(shown: Path) -> str | None:
    """Which version `raw.zarr` is, where it is no link to one."""
    if shown.is_symlink():
        return None
    try:
        return str(read_note(shown).content.get("version"))
    except (OSError, DamagedFileError):
        return None


def raw_chunks(session: Session) -> dict[str, dict[ChunkIndex, ChunkRef]]:
    """Per array of a session's group, the stored pictures by their place."""
    chunks: dict[str, dict[ChunkIndex, ChunkRef]] = {
        "raw": {
            (f, b, p, 0, 0): ref
            for f, frame in enumerate(session.images)
            for b, band in enumerate(frame)
            for p, ref in enumerate(band)
        }
    }
    if session.mask is not None:
        chunks["mask"] = {(0, 0): session.mask.chunk}
    return chunks


def write_raw(session: Session, store: Store) -> None:
    """Make the group of a session's pictures, unless it is there, whole."""
    target = raw_group(session, store)
    chunks = raw_chunks(session)
    if whole(target, chunks, store.chunks):
        return
    lost = [ref for ref in session.refs() if not store.chunks.has(ref)]
    if lost:
        raise WorkError(
            f"{len(lost)} picture(s) of session '{session.name}' are lost; import {session.source['folder']} again"
        )
    store.scratch.remove(target)
    sizes, facts = session.sizes, session.facts
    dims = tuple(sizes)
    shape = tuple(sizes.values())
    arrays = {"raw": ArrayTemplate(dims, shape, (1, 1, 1, *session.shape), "uint16", {"units": "counts"})}
    if session.mask is not None:
        arrays["mask"] = ArrayTemplate(("y", "x"), session.shape, session.shape, "bool")
    hidden = ("illumination", "time_s", "polarisation", "bands_nm")
    temporary = store.scratch.path()
    with disk_faults_named(target), store.scratch.present():
        write_group(
            temporary,
            arrays=arrays,
            coordinates=raw_coordinates(session),
            attrs={
                "session": session.name,
                **{k: v for k, v in facts.items() if k not in hidden and v is not None},
            },
            chunks=chunks,
            source=store.chunks,
        )
        store.scratch.flush()
        write_note(store.scratch, target, temporary, chunks, _provenance(session, target))
        try:
            os.rename(temporary, target)
        except OSError:
            if not target.is_dir():  # another import has made the same folder
                raise
            shutil.rmtree(temporary)


def _provenance(session: Session, group: Path) -> dict[str, Any]:
    """What a note of the session's group says beside its files: of which session it is, and which version."""
    version = {} if group.name.startswith(".") else {"version": _version(group)}
    return {"session": session.name, **version}


def raw_coordinates(session: Session) -> dict[str, Coordinate]:
    """The labels of `raw`."""
    facts = session.facts
    times = [math.nan if t is None else float(t) for t in facts["time_s"]]
    return {
        "illumination": Coordinate(("frame",), facts["illumination"]),
        "time_s": Coordinate(("frame",), times, {"units": "s"}),
        "band": Coordinate(("band",), [float(b) for b in facts["bands_nm"]], {"units": "nm"}),
        "polarisation": Coordinate(("polarisation",), facts["polarisation"]),
    }


def show_raw(name: str, store: Store, *, anew: bool = False) -> None:
    """Let `raw.zarr` name the session's present version, also after a kill between the two steps of a commit.

    Args:
        name: the session's.
        store: where.
        anew: make the group again, although it is there.
    """
    session = read_session(name, store)
    group = raw_group(session, store)
    link = store.sessions / name / "raw.zarr"
    shown = group == link or (link.is_symlink() and os.readlink(link) == group.name)
    if shown and not anew and whole(group, raw_chunks(session), store.chunks):
        return
    if anew:
        store.scratch.remove(group)
    write_raw(session, store)
    with _changing(name, store):
        # an import that came in between has shown its own
        if read_session(name, store).digest == session.digest:
            _link_raw(session, store)


def _link_raw(session: Session, store: Store) -> None:
    link = store.sessions / session.name / "raw.zarr"
    group = raw_group(session, store)
    if group == link or (link.is_symlink() and os.readlink(link) == group.name):
        return
    before = link.resolve()
    temporary = store.scratch.path()
    with disk_faults_named(link):
        try:
            os.symlink(group.name, temporary)
        except OSError as error:
            if error.errno not in files.NO_LINKS:
                raise
            _move_raw(session, group, link, store)
        else:
            if not link.is_symlink():  # it was on a file system without such links
                store.scratch.remove(link)
                note_path(link).unlink(missing_ok=True)
            os.replace(temporary, link)
    if before not in (link, group):
        _remove_unless_whole(before, store)


def _remove_unless_whole(group: Path, store: Store) -> None:
    """Remove a group that is no longer shown and lacks a picture, which whoever opens it would read as black."""
    with contextlib.suppress(OSError, DamagedFileError):
        if not holds(group, read_note(group).links, store.chunks):
            store.scratch.remove(group)
            note_path(group).unlink(missing_ok=True)


def _move_raw(session: Session, group: Path, shown: Path, store: Store) -> None:
    """Let a group be `raw.zarr`; after a kill at any point it is moved, or made, at the next look."""
    store.scratch.remove(shown)
    write_note(store.scratch, shown, group, raw_chunks(session), {"session": session.name, "version": group.name})
    os.rename(group, shown)
    note_path(group).unlink(missing_ok=True)

"""Looking after the store: `verify` reads every byte, mends what can be mended and names the rest.

Every file is compared with what is said of it elsewhere, for its place: a chunk with its name; a group's files
with the group's note, or with the session's own description for its pictures; sealed files with their seals; an
item with its digest. What lies there that no command of ours has written is named and left alone.
"""

import contextlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lightstage.store.digest import SHORT, digest_bytes
from lightstage.store.errors import DamagedFileError, LightstageError, RequestError, WorkError
from lightstage.store.files import files_below, link_or_copy, replace
from lightstage.store.items import Item, get_item, item_names, original_of
from lightstage.store.notes import Note, chunk_file, digest_of, note_path, read_note
from lightstage.store.records import KINDS, blobs_named, intact_record
from lightstage.store.root import Store
from lightstage.store.sessions import Session, raw_chunks, raw_group, read_session, session_names, show_raw

Progress = Callable[[Iterable[Any], int, str], Iterable[Any]]


@dataclass(frozen=True)
class Damage:
    """One thing that is damaged or gone."""

    path: Path
    belongs_to: str
    remedy: str
    recomputable: bool
    """Whether the next run mends it by itself, or it is mended already."""


@dataclass
class Verified:
    """What `verify` read and found."""

    chunks: int = 0
    size: int = 0
    damaged: list[Damage] = field(default_factory=list)
    strange: list[Path] = field(default_factory=list)
    """Files that no command of ours has written; they are left alone."""

    def add(self, path: Path, belongs_to: str, remedy: str, *, recomputable: bool = True) -> None:
        """Something is damaged or gone."""
        self.damaged.append(Damage(path, belongs_to, remedy, recomputable))


_AGAIN = "the next run makes it again"
_MENDED = "nothing needs to be done"


def verify(store: Store, *, progress: Progress | None = None) -> Verified:
    """Read every file of the store under every name that it has, and see that all that is referred to is there.

    A chunk that is intact under one of its names is restored under the others. One that is not goes into
    quarantine with the records and results that refer to it, and the next run makes it again; a raw picture
    must be imported again. Nothing that is intact is removed.

    Raises:
        WorkError: something is damaged, and the store cannot be written.
    """
    report = Verified()
    try:
        _verify(store, report, progress)
    except (OSError, WorkError) as error:
        if not report.damaged:
            raise
        first = report.damaged[0]
        raise WorkError(
            f"{first.path} is damaged ({first.belongs_to}), and the store cannot be mended: {error}"
        ) from error
    return report


def _verify(store: Store, report: Verified, progress: Progress | None) -> None:
    chunks = _read_chunks(store, report, progress)
    bad = {path.name for path, digest in chunks.values() if digest != path.name}
    by_inode = {inode: digest for inode, (_, digest) in chunks.items()}
    _check_records(store, report)
    sessions, items = _check_sessions(store, report), _check_items(store, report)
    _check_bindings(store, sessions, items, report)
    _check_current(store, report)
    views = [*_raw_views(store, sessions), *_result_views(store, report)]
    owners = _owners(sessions, items, views, store)
    bad |= {
        blob for blob, owner in owners.items() if not store.chunks.path(blob).is_file() and owner.stands.exists()
    }
    bad -= _restore(store, bad, views, report)
    for view in views:
        _mend_view(store, view, bad, by_inode, report)
    for blob in sorted(bad):
        owner = owners.get(blob, _Owner("nothing that is in use", _MENDED, True, store.root))
        report.add(store.chunks.path(blob), owner.text, owner.remedy, recomputable=owner.recomputable)
    _quarantine(store, bad, views)
    report.strange += _strange(store)


def _read_chunks(
    store: Store, report: Verified, progress: Progress | None
) -> dict[tuple[int, int], tuple[Path, str]]:
    """Every stored chunk by its inode: where it lies, and the digest that its bytes have."""
    chunks: dict[tuple[int, int], tuple[Path, str]] = {}
    blobs = [Path(entry.path) for entry in files_below(store.chunks.folder) if _BLOB.fullmatch(entry.name)]
    for path in progress(blobs, len(blobs), "chunks") if progress else blobs:
        with contextlib.suppress(FileNotFoundError):  # gc may be at work beside us
            stat = path.stat()
            data = path.read_bytes()
            report.chunks += 1
            report.size += len(data)
            chunks[stat.st_dev, stat.st_ino] = path, digest_bytes(data)
    return chunks


def _check_records(store: Store, report: Verified) -> None:
    """A damaged record is forgotten."""
    for kind in KINDS:
        for path in list(store.records.files(kind)):
            with contextlib.suppress(FileNotFoundError):
                if not intact_record(path):
                    report.add(path, f"the records of {kind}", _AGAIN)
                    path.unlink()


def _check_sessions(store: Store, report: Verified) -> list[Session]:
    """The sessions that can be read."""
    sessions = []
    for name in session_names(store):
        try:
            sessions.append(read_session(name, store))
        except LightstageError as error:
            remedy = error.remedy if isinstance(error, DamagedFileError) else str(error)
            report.add(store.sessions / name / "session.json", f"session {name}", remedy, recomputable=False)
    for link in sorted(store.sessions.glob("*/raw.zarr")):
        path = link.with_name("session.json")
        if not path.exists() and link.is_symlink():
            name = link.parent.name
            remedy = f"it is gone; import the capture folder of session '{name}' again"
            report.add(path, f"session {name}", remedy, recomputable=False)
    return sessions


def _check_items(store: Store, report: Verified) -> list[Item]:
    """The items that can be read; what people read of them is written anew where it is another file."""
    items = []
    for kind, digits in item_names(store):
        folder = store.calibration / f"{kind}-{digits}"
        try:
            item = get_item(kind, digits, store)
            original = original_of(item, store)
        except LightstageError as error:
            remedy = error.remedy if isinstance(error, DamagedFileError) else str(error)
            report.add(folder / "item.json", f"calibration item {folder.name}", remedy, recomputable=False)
            continue
        items.append(item)
        if digest_of(folder / "item.yaml") != digest_bytes(original):
            report.add(folder / "item.yaml", f"calibration item {folder.name}", f"written again; {_MENDED}")
            replace(store.scratch, folder / "item.yaml", original)
    return items


def _check_bindings(store: Store, sessions: Iterable[Session], items: Iterable[Item], report: Verified) -> None:
    """Items that a session uses and that are not there at all."""
    for session in sessions:
        for kind, digest in session.items.items():
            path = store.calibration / f"{kind}-{digest[:SHORT]}" / "item.json"
            if not path.exists():
                remedy = f"it is gone; import {session.source['folder']} again, or bind another"
                report.add(path, f"session {session.name}, its {kind}", remedy, recomputable=False)


def _check_current(store: Store, report: Verified) -> None:
    """`current` names a group that is there."""
    for path in sorted(store.results.glob("*/*/current")):
        with contextlib.suppress(FileNotFoundError):
            name = path.read_bytes().strip().decode("ascii", "replace")
            if not (_GROUP.fullmatch(name) and (path.parent / name).is_dir()):
                report.add(path, "/".join(path.parts[-3:-1]), _AGAIN)
                path.unlink()


@dataclass(frozen=True)
class _View:
    """A group that anyone can open, and what its files should be."""

    group: Path
    note: Note | None
    """What is said of it; None where that cannot be read."""
    links: Mapping[str, str]
    """Chunk files: file to blob."""
    session: Session | None = None
    """The session, where these are its pictures as they are now."""

    def remade(self, store: Store) -> bool:
        """Take it away, to be made again: at once, where all that it is made of is there."""
        if self.session is not None:
            with contextlib.suppress(LightstageError):
                show_raw(self.session.name, store, anew=True)
                return True
        store.scratch.remove(self.group)
        note_path(self.group).unlink(missing_ok=True)
        current = self.group.with_name("current")
        with contextlib.suppress(FileNotFoundError):
            if current.read_bytes().strip() == self.group.name.encode():
                current.unlink()
        return False


def _raw_views(store: Store, sessions: Iterable[Session]) -> Iterator[_View]:
    """The pictures of each session: by its own description, never by that of another version."""
    for session in sessions:
        present = raw_group(session, store)
        links = {
            chunk_file(array, index): ref.blob
            for array, placed in raw_chunks(session).items()
            for index, ref in placed.items()
        }
        yield _View(present, _noted(present), links, session)
        for group in sorted((store.sessions / session.name).glob(".raw-*.zarr")):
            if group != present:
                note = _noted(group)
                yield _View(group, note, {f: ref.blob for f, ref in note.links.items()} if note else {})


def _result_views(store: Store, report: Verified) -> Iterator[_View]:
    for group in sorted(path for path in store.results.glob("*/*/*-*") if path.is_dir()):
        note = _noted(group)
        yield _View(group, note, {f: ref.blob for f, ref in note.links.items()} if note else {})
    for path in sorted(store.results.glob("*/*/*-*.json")):
        group = path.with_suffix("")
        if not group.is_dir() and path.is_file() and _noted(group) is None:
            report.add(path, f"{path.parent.parent.name}/{path.parent.name}", _MENDED)
            path.unlink(missing_ok=True)  # of a result that is not there


def _noted(group: Path) -> Note | None:
    try:
        return read_note(group)
    except (OSError, DamagedFileError):
        return None


@dataclass(frozen=True)
class _Owner:
    """What a chunk belongs to."""

    text: str
    remedy: str
    recomputable: bool
    stands: Path
    """Is there while the owner is: gc and imports may be at work beside us."""


def _owners(
    sessions: Iterable[Session], items: Iterable[Item], views: Iterable[_View], store: Store
) -> dict[str, _Owner]:
    """Everything that refers to a chunk, by blob; a raw picture speaks louder than what was made of it."""
    owners: dict[str, _Owner] = {}
    for view in views:
        if view.session is None and view.group.suffix == ".zarr":
            text = f"an older version of the pictures of session {view.group.parent.name}"
            owners |= dict.fromkeys(view.links.values(), _Owner(text, _MENDED, True, view.group))
        elif view.session is None:
            node = f"{view.group.parent.parent.name}/{view.group.parent.name}"
            for file, blob in view.links.items():
                array, _, index = file.partition("/c.")
                owners[blob] = _Owner(
                    f"{node}, array {array}, chunk {index.replace('.', '/')}", _AGAIN, True, view.group
                )
    for item in items:
        path = store.calibration / item.name
        for camera, picture in item.pictures.items():
            remedy = "import the capture that it came with again"
            owners[picture.chunk.blob] = _Owner(f"calibration item {item.name}, {camera}", remedy, False, path)
    for session in sessions:
        remedy = f"import {session.source['folder']} again"
        path = store.sessions / session.name / "session.json"
        for label, blob in _labelled(session):
            owners[blob] = _Owner(f"session {session.name}, {label}", remedy, False, path)
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
            if blob not in bad or blob in restored or digest_of(path) != blob:
                continue
            _link(store, path, store.chunks.path(blob))
            restored.add(blob)
            remedy = f"restored from the group that holds it too; {_MENDED}"
            report.add(store.chunks.path(blob), str(path.relative_to(store.root)), remedy)
    return restored


def _link(store: Store, source: Path, target: Path) -> None:
    """Let `target` be `source`, in one step."""
    temporary = store.scratch.path()
    link_or_copy(source, temporary)
    store.scratch.make_folder(target.parent)
    os.replace(temporary, target)


def _mend_view(
    store: Store, view: _View, bad: set[str], by_inode: Mapping[tuple[int, int], str], report: Verified
) -> None:
    """Chunk files that are wrong or gone are linked anew; a group whose own files are wrong is made again."""
    name = str(view.group.relative_to(store.root))
    own = {} if view.note is None else view.note.own
    wrong = [view.group / file for file, digest in own.items() if digest_of(view.group / file) != digest]
    if view.note is None:
        wrong = [note_path(view.group)]
    for entry in files_below(view.group):
        file = Path(entry.path).relative_to(view.group).as_posix()
        if view.note is not None and file not in own and file not in view.links:
            if _CHUNK.search(file):  # where nothing was computed: whoever opens the group would read it
                wrong.append(view.group / file)
            else:
                report.strange.append(view.group / file)
    if wrong:
        if view.session is None and not view.group.is_dir():
            return  # gc, or a run that publishes, is at work beside us
        remedy = f"made again; {_MENDED}" if view.remade(store) else _AGAIN
        for path in wrong:
            report.add(path, name, remedy)
        return
    for file, blob in view.links.items():
        path = view.group / file
        if blob in bad or _digest_in(path, by_inode) == blob or not view.group.is_dir():
            continue
        with contextlib.suppress(FileNotFoundError):
            _link(store, store.chunks.path(blob), path)
            report.add(path, name, f"restored from the stored chunk; {_MENDED}")
    if view.session is not None and not bad & set(view.links.values()):
        with contextlib.suppress(RequestError):  # it was removed in the meantime
            show_raw(view.session.name, store)


def _digest_in(path: Path, by_inode: Mapping[tuple[int, int], str]) -> str | None:
    """Digest of a chunk file of a group: known, where it is a link to a chunk that has been read."""
    try:
        stat = path.stat()
    except OSError:
        return None
    # of a file without other names the number may have been another's: some file systems use them again
    known = by_inode.get((stat.st_dev, stat.st_ino)) if stat.st_nlink > 1 else None
    return known or digest_of(path)


def _quarantine(store: Store, bad: set[str], views: Iterable[_View]) -> None:
    if not bad:
        return
    store.scratch.make_folder(store.quarantine)
    for blob in sorted(bad):
        path = store.chunks.path(blob)
        if digest_of(path) == blob:
            bad.discard(blob)  # a run has written it again in the meantime
            continue
        with contextlib.suppress(FileNotFoundError):
            os.replace(path, store.quarantine / blob)
            os.utime(store.quarantine / blob)  # how long it has been there
    for kind in KINDS:
        for path in list(store.records.files(kind)):
            with contextlib.suppress(FileNotFoundError):
                if blobs_named(path) & bad:
                    path.unlink()
    for view in views:
        wrong = [file for file, blob in view.links.items() if blob in bad]
        if view.session is None and wrong:
            view.remade(store)
        elif view.session is not None:
            for file in wrong:  # the other pictures stay readable
                (view.group / file).unlink(missing_ok=True)


_BLOB = re.compile(r"[0-9a-f]{32}")
_GROUP = re.compile(rf"[0-9a-f]{{{SHORT}}}-[0-9a-f]{{{SHORT}}}")
_CHUNK = re.compile(r"/c(\.[0-9]+)*$")
_RAW = rf"\.raw-[0-9a-f]{{{SHORT}}}"
_OURS = {
    "sessions": re.compile(
        rf"[^/]+/(session\.json|\.lock|raw\.zarr(/.*)?|raw\.json|{_RAW}\.json|{_RAW}\.zarr/.*|truth/.*)"
    ),
    "results": re.compile(rf"[^/]+/[^/]+/(current|{_GROUP.pattern}(\.json|/.*))"),
    "calibration": re.compile(r"[^/]+/item\.(json|yaml)"),
    "cache": re.compile(r"blobs/[0-9a-f]{2}/[0-9a-f]{32}|(blocks|nodes|runs)/[0-9a-f]{2}/[0-9a-f]{32}\.json"),
}
"""By folder of the store, what our commands write there; what is right within a group, its note says."""


def _strange(store: Store) -> Iterator[Path]:
    for folder, ours in _OURS.items():
        for entry in files_below(store.root / folder):
            path = Path(entry.path)
            if not ours.fullmatch(path.relative_to(store.root / folder).as_posix()):
                yield path

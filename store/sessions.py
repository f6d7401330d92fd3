"""Sessions: captures brought into the store.

    sessions/<session>/session.json   what the session is: its facts, its pictures by content, its items
    sessions/<session>/raw.zarr/      the pictures as anyone can open them

`session.json` is the truth and is replaced in one step; the pictures themselves are stored chunks. The group
`raw.zarr` is a link to the newest of the folders `.raw-<digest>.zarr` beside it, made of hard links to those
chunks, so that a run that is reading the old version is not disturbed by an import.
"""

import json
import os
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from dataclasses import replace as changed
from typing import Any

import numpy as np

from store import document, files
from store.calibration import Item, StoredPicture
from store.capture import SESSION_NAME
from store.chunks import ChunkRef
from store.digest import SHORT, digest_bytes, digest_value
from store.errors import DamagedFileError, RequestError, WorkError
from store.files import disk_faults_named
from store.grid import ArrayTemplate, ChunkIndex, Coordinate, write_group
from store.root import Store

FORMAT = "lightstage-session/1"
Progress = Callable[[Iterable[Any], int, str], Iterable[Any]]


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
    """
    path = store.sessions / name / "session.json"
    try:
        data = path.read_bytes() if SESSION_NAME.fullmatch(name) else None
    except OSError:
        data = None
    if data is None:
        known = session_names(store)
        hint = document.nearest(name, known) or "; it holds none yet (`lightstage import FOLDER` brings one in)"
        raise RequestError(f"no session '{name}' in the store {store.root}{hint}") from None
    try:
        return _from_plain(json.loads(data), digest_bytes(data))
    except (ValueError, KeyError, TypeError, IndexError):
        raise DamagedFileError(path, f"import the capture folder of session '{name}' again") from None


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


def bind_item(session: Session, item: Item, store: Store) -> Session:
    """Use another calibration item for a session from now on."""
    return commit_session(changed(session, items={**session.items, item.kind: item.digest}), store)


def remove_session(name: str, store: Store) -> int:
    """Take a session and its results out of the store; returns the bytes of its folders.

    Its chunks stay until `gc`, so that an import of the same capture costs little.
    """
    if name not in session_names(store):
        read_session(name, store)  # says which there are
    total = 0
    # results first: what a kill leaves is then still a session, and can be removed again
    for folder in (store.results / name, store.sessions / name):
        if folder.exists():
            total += files.folder_size(folder)
            store.scratch.remove(folder)
    return total


def commit_session(session: Session, store: Store) -> Session:
    """Let a session be what it says: its pictures as a group first, then session.json, then the link."""
    data = json.dumps(_as_plain(session), separators=(",", ":")).encode()
    session = changed(session, digest=digest_bytes(data))
    _write_raw(session, store)
    files.replace(store.scratch, store.sessions / session.name / "session.json", data)
    show_raw(session, store)
    return session


def _raw_folder(session: Session) -> str:
    content = {
        "facts": session.facts,
        "images": [[[ref.blob for ref in band] for band in frame] for frame in session.images],
        "mask": session.mask and session.mask.chunk.blob,
    }
    return f".raw-{digest_value(content)[:SHORT]}.zarr"


def _write_raw(session: Session, store: Store) -> None:
    target = store.sessions / session.name / _raw_folder(session)
    if target.is_dir():
        return
    lost = [ref for ref in session.refs() if not store.chunks.has(ref)]
    if lost:
        raise WorkError(
            f"{len(lost)} picture(s) of session '{session.name}' are lost; import {session.source['folder']} again"
        )
    sizes, facts = session.sizes, session.facts
    dims = tuple(sizes)
    shape = tuple(sizes.values())
    arrays = {"raw": ArrayTemplate(dims, shape, (1, 1, 1, *session.shape), "uint16", {"units": "counts"})}
    chunks: dict[str, dict[ChunkIndex, ChunkRef]] = {
        "raw": {
            (f, b, p, 0, 0): ref
            for f, frame in enumerate(session.images)
            for b, band in enumerate(frame)
            for p, ref in enumerate(band)
        }
    }
    if session.mask is not None:
        arrays["mask"] = ArrayTemplate(("y", "x"), session.shape, session.shape, "bool")
        chunks["mask"] = {(0, 0): session.mask.chunk}
    hidden = ("illumination", "time_s", "polarisation", "bands_nm")
    temporary = store.scratch.path()
    with disk_faults_named(target):
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
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.rename(temporary, target)
        except OSError:
            if not target.is_dir():  # another import has made the same folder
                raise
            shutil.rmtree(temporary)


def raw_coordinates(session: Session) -> dict[str, Coordinate]:
    """The labels of `raw`."""
    facts = session.facts
    times = [np.nan if t is None else float(t) for t in facts["time_s"]]
    return {
        "illumination": Coordinate(("frame",), facts["illumination"]),
        "time_s": Coordinate(("frame",), times, {"units": "s"}),
        "band": Coordinate(("band",), [float(b) for b in facts["bands_nm"]], {"units": "nm"}),
        "polarisation": Coordinate(("polarisation",), facts["polarisation"]),
    }


def show_raw(session: Session, store: Store, *, anew: bool = False) -> None:
    """Let `raw.zarr` name the session's present version, also after a kill between the two steps of a commit."""
    link = store.sessions / session.name / "raw.zarr"
    wanted = _raw_folder(session)
    if anew:
        store.scratch.remove(link.parent / wanted)
    elif link.is_symlink() and os.readlink(link) == wanted and link.is_dir():
        return
    _write_raw(session, store)
    temporary = store.scratch.path()
    os.symlink(wanted, temporary)
    os.replace(temporary, link)

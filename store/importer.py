"""Importing a capture folder: whole or not at all, repeatable, and exactly what changed.

Everything is read and checked first, pictures into staging; then the store changes. Files whose bytes have not
changed are not decoded again.
"""

import io
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.hw import illuminations
from lightstage.store.calibration import items_in
from lightstage.store.capture import Capture, PictureFile, read_captures
from lightstage.store.chunks import ChunkRef, Chunks, Staging
from lightstage.store.digest import digest_bytes
from lightstage.store.errors import RequestError, raise_all
from lightstage.store.intake import FileError, open_regular, read_regular
from lightstage.store.items import Item, StoredPicture, get_item, put_item
from lightstage.store.names import NAME_RULE, SESSION_NAME
from lightstage.store.picture import LARGEST_FILE, Declared, declared, decode
from lightstage.store.root import Store
from lightstage.store.sessions import Session, SessionChangedError, commit_session, present_session, show_raw

Progress = Callable[[Iterable[Any], int, str], Iterable[Any]]
_MEMORY = 1500 << 20
"""Bytes that pictures may take while they are decoded, each three times its size; large ones come fewer at once."""


@dataclass(frozen=True)
class Imported:
    """What an import did."""

    session: Session
    changes: tuple[str, ...]
    """One line each; empty when everything was there already."""
    warnings: tuple[str, ...]
    new: bool


@dataclass(frozen=True)
class _ReadPicture:
    file: PictureFile
    digest: str
    refs: tuple[ChunkRef, ...] | None
    problem: str | None = None


def import_capture(
    folder: Path | Sequence[Path], store: Store, *, name: str | None = None, progress: Progress | None = None
) -> Imported:
    """Bring a capture folder into the store, or update the session that came from it. Several become one session.

    Everything is read and checked before the session appears or changes. Unchanged files (by their bytes) are
    not decoded again.

    Raises:
        RequestError: anything in the folder is wrong; every problem is listed.
    """
    capture = read_captures([folder] if isinstance(folder, Path) else folder)
    session_name = capture.description.session if name is None else name
    if not SESSION_NAME.fullmatch(session_name):
        raise RequestError(f"--session {session_name[:100]!r}: a name has {NAME_RULE}")
    staging = Staging(store.chunks, store.scratch)
    try:
        return _import(capture, session_name, store, staging, progress)
    finally:
        staging.discard()


def _import(
    capture: Capture, session_name: str, store: Store, staging: Staging, progress: Progress | None
) -> Imported:
    before, standing = present_session(session_name, store)
    lost = 0 if before is None else sum(not store.chunks.intact(ref) for ref in before.refs())
    pictures = capture.pictures()
    warnings = [f"{path} is not mentioned in capture.yaml; passed over" for path in capture.extra_pictures()]
    if before is None and standing is not None:
        warnings.append(
            f"session '{session_name}' was damaged and is made anew from its folder; calibration items that were "
            "bound to it by hand have to be bound again"
        )

    read, shape = _read_pictures(capture, pictures, store, staging, before, progress)
    mask, mask_file = _read_mask(capture, shape, staging)
    items: dict[str, tuple[Item, bytes]] = {}
    if capture.description.calibration is not None:
        items, more = items_in(capture.folder / capture.description.calibration, staging)
        warnings += more

    # everything is right: from here on the store changes
    staging.commit()
    for item, original in items.values():
        put_item(item, original, store)
    facts = _facts(capture)
    images = _arrange(read, facts)
    came = {kind: item.digest for kind, (item, _) in items.items()}
    source = {
        "folder": str(capture.folder),
        "files": {
            result.file.path.relative_to(capture.folder).as_posix(): {
                "digest": result.digest,
                "frame": result.file.frame,
                "bands": list(result.file.bands),
                "polarisation": result.file.polarisation,
            }
            for result in read
        },
        "mask": mask_file,
        "items": came,
    }
    incoming = Session(session_name, facts, shape, images, mask, came, source, (), "")
    while True:
        try:
            done = _become(incoming, before, standing, store, lost=lost)
        except SessionChangedError:  # an item was bound, or somebody imports it, too: again, from what stands now
            before, standing = present_session(session_name, store)
        else:
            return changed(done, warnings=(*warnings, *done.warnings))


def _become(
    incoming: Session, before: Session | None, standing: str | None, store: Store, *, lost: int
) -> Imported:
    """Let the session be what lies in its folder, with the items that are bound to it.

    Args:
        incoming: the session as its folder alone says.
        before: the session as it stands, if there is one that can be read.
        standing: the digest of what stands.
        store: where.
        lost: how many of its pictures were damaged or gone, and are there again.
    """
    session = changed(incoming, items=_bound_items(before, incoming.source["items"]))
    changes = _changes(before, session)
    if before is not None and not changes:
        if lost or before.source != session.source:
            # restored pictures may be stored in other bytes; or the archive has moved and nothing of it has changed
            session = commit_session(changed(session, verdict=before.verdict), store, expected=standing)
        else:
            session = before
        show_raw(session.name, store, anew=lost > 0)
        restored = (f"{lost} damaged or lost picture(s) were restored",) if lost else ()
        return Imported(session, restored, (), new=False)
    session = changed(session, verdict=tuple(_verdict(session, store)))
    warnings = []
    if before is not None and before.source["folder"] != session.source["folder"]:
        warnings.append(f"session '{session.name}' came from {before.source['folder']} before")
    session = commit_session(session, store, expected=standing)
    return Imported(session, tuple(changes), tuple(warnings), new=before is None)


def _bound_items(before: Session | None, came: Mapping[str, str]) -> dict[str, str]:
    """Kind -> digest after an import: what came with the folder is bound when it is new there, so that an item that
    somebody has bound by hand stays until the folder's own changes; what has left the folder is released."""
    bound = {} if before is None else dict(before.items)
    came_before = {} if before is None else before.source.get("items", {})
    for kind, digest in came.items():
        if came_before.get(kind) != digest or kind not in bound:
            bound[kind] = digest
    for kind, digest in came_before.items():
        if kind not in came and bound.get(kind) == digest:
            del bound[kind]
    return bound


def _facts(capture: Capture) -> dict[str, Any]:
    d = capture.description
    bits = 16 if d.encoding == "srgb" else d.bits
    return {
        "rig": d.rig,
        "captured": d.captured,
        "bits": bits,
        "white_level": (1 << bits) - 1,
        "frame_rate_hz": d.frame_rate_hz,
        "cameras": dict(d.cameras),
        "polarisation": list(capture.polarisations),
        "mount": {camera: mount.model_dump() for camera, mount in d.mount.items()},
        "bands_nm": list(d.bands_nm),
        "colour": d.colour,
        "encoding": d.encoding,
        "illumination": [frame.illumination for frame in d.frames],
        "time_s": [frame.time_s for frame in d.frames],
        "intensities": {
            k: [float(v)] * len(d.bands_nm) if isinstance(v, int | float) else [float(x) for x in v]
            for k, v in d.intensities.items()
        },
        "target": None if d.target is None else d.target.model_dump(mode="json", exclude_none=True),
        **{
            key: [getattr(frame, key) for frame in d.frames]
            for key in ("exposure_s", "polariser_deg", "part")
            if any(getattr(frame, key) for frame in d.frames)
        },
    }


def _read_pictures(
    capture: Capture,
    pictures: list[PictureFile],
    store: Store,
    staging: Staging,
    before: Session | None,
    progress: Progress | None,
) -> tuple[list[_ReadPicture], tuple[int, int]]:
    """Every picture, and the (y, x) that they have in common.

    What the files declare is read first: one that differs from the others, or is larger than any camera's, is
    refused before it is decoded.

    Raises:
        RequestError: a picture is wrong; every problem is listed.
    """
    known: dict[tuple[str, int, str, tuple[int, ...]], tuple[ChunkRef, ...]] = {}
    same_decoding = before is not None and all(
        before.facts[key] == _facts(capture)[key] for key in ("bits", "encoding", "colour")
    )
    if before is not None and same_decoding:
        axis = {p: i for i, p in enumerate(before.polarisations)}
        for file in before.source["files"].values():
            refs = tuple(before.images[file["frame"]][b][axis[file["polarisation"]]] for b in file["bands"])
            if all(store.chunks.intact(ref) for ref in refs):
                known[file["digest"], file["frame"], file["polarisation"], tuple(file["bands"])] = refs

    with ThreadPoolExecutor(max_workers=len(os.sched_getaffinity(0))) as pool:
        promised = list(pool.map(_declared, pictures))
    readable = [promise for promise in promised if isinstance(promise, Declared)]
    shapes = [promise.shape for promise in readable]
    usual = max(set(shapes), key=shapes.count, default=(0, 0))

    def read(picture: PictureFile, promise: Declared | str) -> _ReadPicture:
        if isinstance(promise, str):
            return _ReadPicture(picture, "", None, f"{picture.path} {promise}")
        if promise.shape != usual:
            return _ReadPicture(
                picture,
                "",
                None,
                f"{picture.path} is {promise.width} x {promise.height}; the other pictures are "
                f"{usual[1]} x {usual[0]}",
            )
        try:
            data = read_regular(picture.path, LARGEST_FILE)
            digest = digest_bytes(data)
            refs = known.get((digest, picture.frame, picture.polarisation, picture.bands))
            if refs is not None:
                return _ReadPicture(picture, digest, refs)
            planes = capture.planes(data)
            if planes.shape[1:] != usual:
                raise FileError("changed while it was read; wait until it is complete")
        except FileError as error:
            return _ReadPicture(picture, "", None, f"{picture.path} {error}")
        return _ReadPicture(
            picture, digest, tuple(staging.put(np.ascontiguousarray(plane)[None, None, None]) for plane in planes)
        )

    at_once = _MEMORY // max([3 * promise.size for promise in readable], default=1)
    workers = max(1, min(at_once, len(os.sched_getaffinity(0))))
    with ThreadPoolExecutor(max_workers=workers) as pool:
        results = pool.map(read, pictures, promised)
        read_all = list(progress(results, len(pictures), "pictures") if progress else results)
    problems = [result.problem for result in read_all if result.problem is not None]
    if len(problems) > 20:
        problems[20:] = [f"... and {len(problems) - 20} more pictures like these"]
    raise_all(problems)
    return read_all, usual


def _declared(picture: PictureFile) -> Declared | str:
    """What a picture says of itself, or what is wrong with it."""
    try:
        with open_regular(picture.path) as file:
            return declared(file)
    except FileError as error:
        return str(error)


def _read_mask(capture: Capture, shape: tuple[int, int], chunks: Chunks) -> tuple[StoredPicture | None, Any]:
    if capture.description.mask is None:
        return None, None
    path = capture.folder / capture.description.mask
    try:
        data = read_regular(path, LARGEST_FILE)
        promised = declared(io.BytesIO(data))
        if promised.shape == shape:
            picture = decode(data)
    except FileError as error:
        raise RequestError(f"{path} {error}; capture.yaml names it as the mask") from None
    if promised.shape != shape:
        raise RequestError(
            f"{path} is {promised.width} x {promised.height}; the mask must be as large as the pictures, "
            f"{shape[1]} x {shape[0]}"
        )
    if picture.ndim == 3:
        picture = picture.max(axis=2)
    mask = np.ascontiguousarray(picture > 0)
    stored = StoredPicture(chunks.put(mask), mask.dtype.str, mask.shape)
    return stored, {"name": capture.description.mask, "digest": digest_bytes(data)}


def _arrange(read: list[_ReadPicture], facts: Mapping[str, Any]) -> tuple[tuple[tuple[ChunkRef, ...], ...], ...]:
    place: dict[tuple[int, int, str], ChunkRef] = {}
    for result in read:
        for band, ref in zip(result.file.bands, result.refs or (), strict=True):
            place[result.file.frame, band, result.file.polarisation] = ref
    return tuple(
        tuple(
            tuple(place[frame, band, polarisation] for polarisation in facts["polarisation"])
            for band in range(len(facts["bands_nm"]))
        )
        for frame in range(len(facts["illumination"]))
    )


def _changes(before: Session | None, after: Session) -> list[str]:
    if before is None:
        return [f"session '{after.name}' is new"]
    changes = []
    for key, value in after.facts.items():
        if before.facts.get(key) != value:
            shown = f"{before.facts.get(key)} -> {value}"
            changes.append(f"{key} changed" + (f": {shown}" if len(shown) < 120 else ""))
    old_files = {_plane(f): f["digest"] for f in before.source["files"].values()}
    for file_name, file in after.source["files"].items():
        old = old_files.get(_plane(file))
        if old is None:
            changes.append(f"picture {file_name} is new")
        elif old != file["digest"] and _refs_of(before, file) != _refs_of(after, file):
            changes.append(f"picture {file_name} changed")
    dropped = len(set(old_files) - {_plane(f) for f in after.source["files"].values()})
    if dropped:
        changes.append(f"{dropped} picture(s) are gone")
    if (before.mask and before.mask.chunk.value) != (after.mask and after.mask.chunk.value):
        changes.append("the mask changed")
    for kind, digest in after.items.items():
        old = before.items.get(kind)
        if old != digest:
            changes.append(f"calibration item {kind} " + ("is new" if old is None else "changed"))
    changes += [f"calibration item {kind} is gone" for kind in before.items if kind not in after.items]
    return changes


def _plane(file: Mapping[str, Any]) -> tuple[Any, ...]:
    return (file["frame"], file["polarisation"], tuple(file["bands"]))


def _refs_of(session: Session, file: Mapping[str, Any]) -> list[str]:
    axis = session.polarisations.index(file["polarisation"])
    return [session.images[file["frame"]][band][axis].value for band in file["bands"]]


def _verdict(session: Session, store: Store) -> Iterable[dict[str, Any]]:
    """One row an illumination, band and camera: is this capture any good?

    saturated: fraction of pixels at the white level. underexposed: fraction below 2 % of the range above the
    dark. complement_residual: median of |a + a' - c| / c where c is bright, for gradients whose complement
    and constant image are there. Repeated illuminations count together (worst fraction, first residual).
    """
    facts, white = session.facts, session.facts["white_level"]
    dark = _mean_dark(session, store)
    frames: dict[str, list[int]] = {}
    for i, illumination in enumerate(facts["illumination"]):
        frames.setdefault(illumination, []).append(i)

    named = facts.get("exposure_s", [None])
    shares = [1.0] * len(facts["illumination"]) if None in named else illuminations.relative_exposures(named)

    def load(frame: int, band: int, polarisation: int) -> NDArray[np.uint16]:
        ref = session.images[frame][band][polarisation]
        return store.chunks.get(ref, dtype="<u2", shape=session.shape)

    for b, band_nm in enumerate(facts["bands_nm"]):
        for p, polarisation in enumerate(session.polarisations):
            offset = dark.get(polarisation, 0.0)
            for illumination, indices in frames.items():
                saturated = under = 0.0
                for i in indices:
                    picture = load(i, b, p)
                    saturated = max(saturated, float(np.mean(picture >= white)))
                    under = max(under, float(np.mean(picture < offset + 0.02 * (white - offset))))
                residual = None
                opposite = illuminations.complement(illumination)
                if illuminations.is_gradient(illumination) and opposite in frames and "C" in frames:
                    first = _nearest(indices[0], frames[opposite])
                    lit = _nearest(indices[0], frames["C"])
                    constant, one_side, other_side = (
                        (load(i, b, p) - offset) / shares[i] for i in (lit, indices[0], first)
                    )
                    total = one_side + other_side
                    bright = constant > 0.1 * np.percentile(constant, 99)
                    if bright.any():
                        residual = float(np.median(np.abs(total - constant)[bright] / constant[bright]))
                yield {
                    "band_nm": band_nm,
                    "polarisation": polarisation,
                    "illumination": illumination,
                    "saturated": saturated,
                    "underexposed": under,
                    "complement_residual": residual,
                }


def _nearest(frame: int, candidates: list[int]) -> int:
    return min(candidates, key=lambda i: abs(i - frame))


def _mean_dark(session: Session, store: Store) -> dict[str, float]:
    if "dark" not in session.items:
        return {}
    item = get_item("dark", session.items["dark"], store)
    means = {camera: float(np.mean(p.load(store))) / item.values["scale"] for camera, p in item.pictures.items()}
    return {p: means[camera] for p, camera in session.facts["cameras"].items() if camera in means}

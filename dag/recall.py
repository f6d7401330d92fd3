"""The short cut of a fully cached run: answer from one record, without the graph, the stages, Dask or zarr.

A request is recognised by everything that could change its answer: all its fields, the session and its items, the
text of the pipeline file, our own source files (`sources`, which walks the folders), and the installed libraries.
The answer is given only while every result folder and every chunk that it names is there.

A request is looked for by what the files hold, and remembered by what the plan has read of them: a binding that was
changed for a moment while a run began must not lend its result to another.
"""

import json
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, TypeGuard

from lightstage.dag.request import Request
from lightstage.dag.sources import Sources, outdated, read_sources
from lightstage.store.digest import SHORT, digest_bytes, digest_value
from lightstage.store.results import ResultName, set_current
from lightstage.store.root import Store


@dataclass(frozen=True)
class Snapshot:
    """A request and all that could change its answer, at one moment; files by their content."""

    request: Request
    session: str
    """Digest of session.json."""
    pipeline: str
    """Digest of the pipeline file."""
    items: Mapping[str, str]
    """Per kind, the digest of what its item.json says; notes count, they decide whether an item may be used."""
    sources: Sources
    libraries: tuple[str, ...]

    @property
    def key(self) -> str:
        """What its answer is remembered under: every field of this class and of the request."""
        request = _fields(self.request)
        request["pipeline"] = self.pipeline  # what the file holds, wherever it lies
        return digest_value({**_fields(self), "request": request, "sources": self.sources.digest})


def _fields(record: Any) -> dict[str, Any]:
    return {field.name: getattr(record, field.name) for field in fields(record)}


def snapshot(request: Request, store: Store) -> Snapshot | None:
    """The request with its files as they stand, or None where it cannot be looked for.

    That is: the session, the pipeline file or an item is not there, or items are given for this request alone,
    whose pictures are not looked at here.
    """
    if request.items:
        return None
    try:
        session_bytes = (store.sessions / request.session / "session.json").read_bytes()
        bound = json.loads(session_bytes)["items"]
        items = {}
        for kind, digest in bound.items():
            plain = json.loads((store.calibration / f"{kind}-{digest[:SHORT]}" / "item.json").read_bytes())
            items[kind] = item_digest(
                plain["kind"], plain["digest"], plain["values"], plain["notes"], plain["pictures"]
            )
        return Snapshot(
            request,
            session=digest_bytes(session_bytes),
            pipeline=digest_bytes(request.pipeline.read_bytes()),
            items=items,
            sources=read_sources(),
            libraries=libraries(),
        )
    except (OSError, ValueError, KeyError, TypeError):
        return None


def item_digest(
    kind: str, digest: str, values: Mapping[str, Any], notes: Mapping[str, Any], pictures: Mapping[str, Any]
) -> str:
    """Digest of all that a stored item says."""
    return digest_bytes(json.dumps([kind, digest, values, notes, pictures], sort_keys=True).encode())


def lasting(taken: Snapshot | None) -> TypeGuard[Snapshot]:
    """Whether our sources are still those of the snapshot, untouched, and those that this process executed."""
    return taken is not None and taken.sources == read_sources() and not outdated(taken.sources)


def libraries() -> tuple[str, ...]:
    """All that is installed, with versions, from the names of folders; `importlib.metadata` would load too long."""
    distributions = set()
    for folder in sys.path:
        try:
            names = os.listdir(folder or ".")
        except OSError:
            continue
        distributions |= {name for name in names if name.endswith((".dist-info", ".egg-info"))}
    return tuple(sorted(distributions))


def recall(store: Store, taken: Snapshot) -> dict[str, Any] | None:
    """The record of the answer to a request, if all of it is still there; lets `current` name its results."""
    answer = store.records.run(taken.key)
    if answer is None:
        return None
    blobs = str(store.chunks.folder)
    for node in answer["nodes"].values():
        if node["folder"] is None:
            continue
        group = os.path.join(store.results, answer["session"], node["name"], node["folder"])
        if not os.path.exists(f"{group}/zarr.json"):
            return None
        for file, blob, size in node["files"]:
            try:
                if (
                    os.stat(f"{group}/{file}").st_size != size
                    or os.stat(f"{blobs}/{blob[:2]}/{blob}").st_size != size
                ):
                    return None
            except OSError:
                return None
    for name, node in answer["nodes"].items():
        if node["folder"] is not None:
            recipe, _, manifest = node["folder"].partition("-")
            if not set_current(ResultName(answer["session"], name, recipe, manifest), store):
                return None  # `gc` has just taken it
    return answer

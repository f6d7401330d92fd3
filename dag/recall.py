"""The short cut of a fully cached run: answer from one record, without the graph, the stages, Dask or zarr.

A request is recognised by everything that could change its answer: the pipeline file, the session, its items,
our own source files (`sources`, which walks the folders), the installed libraries, and the options. The answer is
given only while every result folder and every chunk that it names is there.

A request is looked for by what the files hold, and remembered by what the plan has read of them: a binding that was
changed for a moment while a run began must not lend its result to another.
"""

import json
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeGuard

from lightstage.dag.sources import Sources, outdated, read_sources
from lightstage.store.digest import SHORT, digest_bytes, digest_value
from lightstage.store.results import ResultName, set_current
from lightstage.store.root import Store

_SAID = ("method", "engine", "note", "cannot_be_made", "distance_mm", "warnings")
"""What of a result's attributes a run tells."""


@dataclass(frozen=True)
class Request:
    """What is asked for: `options` as the user gave them, the files by their content."""

    options: Mapping[str, Any]
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
        """What its answer is remembered under."""
        return digest_value(
            {
                "options": dict(self.options),
                "session": self.session,
                "pipeline": self.pipeline,
                "items": dict(self.items),
                "sources": self.sources.digest,
                "libraries": list(self.libraries),
            }
        )


def request_now(store: Store, *, session: str, pipeline: Path, options: Mapping[str, Any]) -> Request | None:
    """The request as the files stand, or None when the session, the pipeline file or an item is not there."""
    try:
        session_bytes = (store.sessions / session / "session.json").read_bytes()
        bound = json.loads(session_bytes)["items"]
        items = {}
        for kind, digest in bound.items():
            plain = json.loads((store.calibration / f"{kind}-{digest[:SHORT]}" / "item.json").read_bytes())
            items[kind] = item_digest(
                plain["kind"], plain["digest"], plain["values"], plain["notes"], plain["pictures"]
            )
        return Request(
            options=options,
            session=digest_bytes(session_bytes),
            pipeline=digest_bytes(pipeline.read_bytes()),
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


def lasting(request: Request | None) -> TypeGuard[Request]:
    """Whether our sources are still those of the request, untouched, and those that this process executed."""
    return request is not None and request.sources == read_sources() and not outdated(request.sources)


def libraries() -> tuple[str, ...]:
    """All that is installed, with versions, from the names of folders; `importlib.metadata` would load too long."""
    found = set()
    for folder in sys.path:
        try:
            names = os.listdir(folder or ".")
        except OSError:
            continue
        found |= {name for name in names if name.endswith((".dist-info", ".egg-info"))}
    return tuple(sorted(found))


def recall(store: Store, request: Request) -> dict[str, Any] | None:
    """The answer to a request, if all of it is still there; lets `current` name its results."""
    answer = store.records.run(request.key)
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


def remember(store: Store, request: Request | None, session: str, results: Mapping[str, Any]) -> dict[str, Any]:
    """The answer to a request, kept under its key if there is one.

    Args:
        results: node name -> `dag.publish.NodeResult`.
    """
    nodes = {
        name: {
            "name": name,
            "folder": None if result.path is None else result.path.name,
            "blocks": result.computed + result.reused,
            "bytes": result.size,
            "attrs": {k: result.attrs[k] for k in _SAID if k in result.attrs},
            "files": [[file, ref.blob, ref.size] for file, ref in result.files.items()],
        }
        for name, result in results.items()
    }
    answer = {"session": session, "nodes": nodes}
    if request is not None:
        store.records.put_run(request.key, answer)
    return answer

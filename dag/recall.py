"""The short cut of a fully cached run: answer from one record, without the graph, the stages, Dask or zarr.

A request is recognised by the bytes of everything that could change its answer: the pipeline file, the
session, the source files of the engine and the stages, the numeric libraries, and the options. The answer is
given only while every result folder and every chunk that it names is there.
"""

import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from store.digest import SHORT, digest_bytes, digest_value
from store.results import ResultName, set_current
from store.root import Store

PACKAGES = ("stages", "hw", "dag", "store")
_LIBRARIES = (
    "colour_science",
    "numba",
    "numpy",
    "opencv_contrib_python_headless",
    "pyamg",
    "scikit_image",
    "scipy",
)


_SAID = ("method", "engine", "note", "cannot_be_made", "distance_mm", "distance_found", "warnings")
"""What of a result's attributes a run tells."""


def request_key(
    store: Store,
    *,
    session: str,
    pipeline: Path,
    overrides: Sequence[str],
    nodes: Sequence[str],
    frames: tuple[int, int] | None,
) -> str | None:
    """Key of a request, or None when the session or the pipeline file is not there."""
    try:
        session_bytes = (store.sessions / session / "session.json").read_bytes()
        pipeline_bytes = pipeline.read_bytes()
        bound = json.loads(session_bytes)["items"]
        # their notes (rig, valid from) decide whether an item may be used at all
        items = [(store.calibration / f"{k}-{d[:SHORT]}" / "item.json").read_bytes() for k, d in bound.items()]
    except (OSError, ValueError, KeyError):
        return None
    return digest_value(
        {
            "session": digest_bytes(session_bytes),
            "pipeline": digest_bytes(pipeline_bytes),
            "items": [digest_bytes(item) for item in items],
            "overrides": list(overrides),
            "nodes": list(nodes),
            "frames": None if frames is None else list(frames),
            "sources": _sources(),
            "libraries": _libraries(),
        }
    )


def _sources() -> list[str]:
    """Digests of our source files."""
    root = Path(__file__).resolve().parent.parent
    found = []
    for package in PACKAGES:
        for entry in sorted(os.scandir(root / package), key=lambda item: item.name):
            if entry.name.endswith(".py"):
                with open(entry.path, "rb") as file:
                    found.append(f"{package}/{entry.name}:{digest_bytes(file.read())}")
    return found


def _libraries() -> list[str]:
    """The installed versions, from the names of their folders; `importlib.metadata` would take longer to load."""
    found = set()
    for folder in sys.path:
        try:
            names = os.listdir(folder or ".")
        except OSError:
            continue
        found |= {n for n in names if n.endswith(".dist-info") and n.split("-")[0].lower() in _LIBRARIES}
    return sorted(found)


def recall(store: Store, key: str) -> dict[str, Any] | None:
    """The answer to a request, if all of it is still there; lets `current` name its results."""
    answer = store.records.run(key)
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


def remember(store: Store, key: str | None, session: str, results: Mapping[str, Any]) -> dict[str, Any]:
    """The answer to a request, kept under its key if there is one.

    Args:
        results: node name -> `dag.run.NodeResult`.
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
    if key is not None:
        store.records.put_run(key, answer)
    return answer

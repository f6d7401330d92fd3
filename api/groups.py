"""Which zarr group a node's pictures lie in: its result, or the session's own where the node brings it in."""

from pathlib import Path
from typing import TYPE_CHECKING

from lightstage.api.requests import pipeline_path
from lightstage.dag.answer import Answer
from lightstage.store.errors import RequestError
from lightstage.store.results import current, current_path
from lightstage.store.root import Store

if TYPE_CHECKING:
    import xarray

    from lightstage.store.sessions import Session


def group_of(session: str, node: str, store: Store, pipeline: str | Path | None = None) -> Path:
    """The group that a user is shown.

    Raises:
        RequestError: there is no such session, or the node has no result.
    """
    folder = current(session, node, store)
    if folder is not None:
        return store.results / session / node / folder
    from lightstage.store.sessions import read_session

    opened = read_session(session, store)  # whether it is there, and whole
    if _nodes(pipeline).get(node, False):
        return store.sessions / session / "raw.zarr"
    refuse_stranger(opened, node, store, pipeline)
    return current_path(session, node, store)


def open_group(session: "Session", node: str, store: Store, pipeline: str | Path | None = None) -> "xarray.Dataset":
    """The same, opened and checked.

    Raises:
        RequestError: the node has no result.
        WorkError: a file of it is damaged; now, or when values are read.
    """
    from lightstage.store.grid import open_dataset
    from lightstage.store.sessions import raw_group

    if current(session.name, node, store) is None and _nodes(pipeline).get(node, False):
        group = raw_group(session, store)
    else:
        refuse_stranger(session, node, store, pipeline)
        group = current_path(session.name, node, store)
    dataset: xarray.Dataset = open_dataset(group)
    return dataset


def last_moving_normals(answer: Answer) -> str | None:
    """The last node of an answer that has a normal at every frame, or else the last at every tracking frame."""
    from lightstage.store.grid import open_dataset

    for dim in ("frame", "tracking"):
        for name in reversed(list(answer.nodes)):
            node = answer.nodes[name]
            if node.path is None:
                continue
            dataset = open_dataset(node.path)
            if "normal" in dataset and dataset["normal"].sizes.get(dim, 0) > 1:
                return name
    return None


def results_of(session: str, store: Store) -> list[str]:
    """The nodes that have a result."""
    folder = store.results / session
    names = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
    return [name for name in names if current(session, name, store) is not None]


def refuse_stranger(session: "Session", node: str, store: Store, pipeline: str | Path | None = None) -> None:
    """Raise RequestError where neither the session nor its pipeline knows a node of that name."""
    from lightstage.store.document import nearest

    known = {*results_of(session.name, store), *_nodes(pipeline)}
    if node not in known:
        raise RequestError(
            f"session '{session.name}' has no result of a node '{node}'{nearest(node, sorted(known))}"
        )


def _nodes(pipeline: str | Path | None) -> dict[str, bool]:
    """The nodes of a pipeline file, and of each whether it reads no other: such a node brings in the session."""
    from lightstage.store import document

    entries = document.load(pipeline_path(pipeline), what="a pipeline").value
    nodes = entries.get("stages") if isinstance(entries, dict) else None
    if not isinstance(nodes, dict):
        return {}
    return {name: isinstance(entry, dict) and not entry.get("from") for name, entry in nodes.items()}

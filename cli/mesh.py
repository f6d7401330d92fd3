"""Meshes of a session's depth: what the product is told of the session, and the set of files in a folder."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.cli.deliver import exported
from lightstage.cli.refusals import refusals
from lightstage.cli.show import Screen
from lightstage.products.names import mesh_files
from lightstage.store.errors import RequestError
from lightstage.store.root import Store

if TYPE_CHECKING:
    from lightstage.kernels.surface.pinhole import Pinhole
    from lightstage.products.mesh import Beside
    from lightstage.store.sessions import Session

_BESIDE = ("reflectance", "relief", "normals")
"""Nodes that a mesh is painted with, where they have a result."""


def camera_of(dataset: Any, node: str, session: "Session", store: Store) -> "Pinhole":
    """The camera that saw a node's depth; to be asked for before anything is written.

    Raises:
        RequestError: the node has no depth, or the session no camera item that fits it.
    """
    from lightstage.dag.plan import bound_items
    from lightstage.kernels.surface.pinhole import Pinhole

    if "depth_mm" not in dataset:
        raise RequestError(
            f"node '{node}' has no depth, so there is no mesh of it; `lightstage export shape` has one"
        )
    items = bound_items(session, store, {})
    if "camera" not in items:
        raise RequestError(f"session '{session.name}' has no camera item, which places points in millimetres")
    with refusals(f"session '{session.name}': "):
        return Pinhole.of(items["camera"].values, (dataset.sizes["y"], dataset.sizes["x"]))


def _beside(session: "Session", store: Store) -> "Beside":
    from lightstage.dag.plan import bound_items
    from lightstage.products.mesh import Beside
    from lightstage.store.grid import open_dataset
    from lightstage.store.results import current

    folders = {node: current(session.name, node, store) for node in _BESIDE}
    items = bound_items(session, store, {})
    bands = items["bands"].values["bands"] if "bands" in items else ()
    return Beside(
        {
            node: open_dataset(store.results / session.name / node / folder)
            for node, folder in folders.items()
            if folder is not None
        },
        list(session.facts["bands_nm"]),
        {entry["centre_nm"]: entry.get("width_nm") for entry in bands},
    )


def map_space(form: str, choice: str | None) -> str | None:
    """The space of a format's normal map; None: no map.

    Raises:
        RequestError: the format cannot carry it.
    """
    from lightstage.formats.meshes import normal_map_space

    with refusals("--normal-map: "):
        return normal_map_space(form, choice)


def deliver_meshes(
    dataset: Any,
    camera: "Pinhole",
    node: str,
    session: "Session",
    folder: Path,
    screen: Screen,
    store: Store,
    *,
    form: str,
    every: int,
    space: str | None,
) -> Mapping[str, Any]:
    """The meshes of a node's tracking frames, painted with what the session has; returns what is answered.

    Raises:
        RequestError: there is no surface, or something else is in their place.
    """
    from lightstage.products.mesh import write_meshes

    frames = [int(frame) for frame in dataset.tracking.values]
    names = [name for frame in frames for name in mesh_files(node, frame, form)]
    with refusals(), exported(folder, session.name, node, names) as export:
        export.add(
            write_meshes(
                export.work, node, dataset, camera, _beside(session, store),
                form=form, every=every, space=space, progress=screen.progress,
            )
        )  # fmt: skip
    unit = "metres" if form == "glb" else "millimetres"
    screen.say(f"{len(frames)} meshes of {node} ({session.name}) in {folder}, in {unit}")
    return {"files": export.files, "format": form, "unit": unit, "normal_map": space}

"""A node's result as files of other programs: pictures, films of its normals, meshes of its depth.

A file that is in the way is replaced only where `export.json` beside it says that an export of the same node and
session left it so.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.api.refusals import refusals
from lightstage.products.choices import PLANE_FORMATS
from lightstage.products.names import EXPORT_RECORD
from lightstage.products.progress import Progress, silent
from lightstage.store.errors import RequestError
from lightstage.store.root import Store

if TYPE_CHECKING:
    import xarray

    from lightstage.kernels.surface.pinhole import Pinhole
    from lightstage.products.film import Film as Film
    from lightstage.products.film import Series
    from lightstage.products.mesh import Beside
    from lightstage.store.sessions import Session

EXPORT_FORMAT = "lightstage-export/1"
_BESIDE = ("reflectance", "relief", "normals")
"""Nodes that a mesh is painted with, where they have a result."""


class Export:
    """Files on their way into a folder of the user's."""

    def __init__(self, work: Path, folder: Path) -> None:
        self.work = work
        """Where they are written first."""
        self._folder = folder
        self._names: list[str] = []

    def add(self, names: Iterable[str]) -> None:
        """Files that are in `work` now."""
        self._names += names

    @property
    def names(self) -> list[str]:
        """Of the files that were added."""
        return self._names

    @property
    def files(self) -> list[Path]:
        """Where they are, once the export has ended well."""
        return [self._folder / name for name in self._names]


@contextmanager
def exported(folder: Path, session: str, node: str, names: Iterable[str]) -> Iterator[Export]:
    """An export of a node into a folder of the user's: all of it when the block ends well, or nothing.

    Its record tells what is whose: a file is replaced only where it is of this node and session and is as an export
    left it.

    Args:
        folder: need not be there.
        session, node: what is exported.
        names: of files that may be written.

    Raises:
        RequestError: there can be no such folder, or a file of that name is not this export's.
        OSError: it cannot be written.
    """
    from lightstage.formats.whole_set import WholeSet

    subject = {"session": session, "node": node}
    delivery = WholeSet(folder, EXPORT_RECORD, subject=subject)
    with refusals():
        delivery.claim(names)
        with delivery.making() as work:
            export = Export(work, folder)
            yield export
            delivery.settle(work, {"format": EXPORT_FORMAT}, dict.fromkeys(export.names, subject))


def export_planes(
    dataset: "xarray.Dataset",
    node: str,
    session: str,
    folder: Path,
    *,
    form: str,
    convention: str = "opengl",
    progress: Progress = silent,
) -> list[Path]:
    """Write every array of a node's result as pictures; returns the files.

    Args:
        form: one of `products.choices.PLANE_FORMATS`.
        convention: one of `products.choices.CONVENTIONS`.

    Raises:
        RequestError: the format is not known, or something else is in the files' place.
    """
    from lightstage.products.planes import plane_names, planes, suffix, write_plane
    from lightstage.store.document import nearest

    if form not in PLANE_FORMATS:
        raise RequestError(
            f"--format {form}: it is not known{nearest(form, PLANE_FORMATS)}; there are {', '.join(PLANE_FORMATS)}"
        )
    names = [f"{name}.{suffix(form)}" for name in plane_names(dataset)]
    with exported(folder, session, node, names) as export:
        for plane in progress(planes(dataset), len(names), "pictures"):
            export.add([write_plane(export.work, plane, form=form, convention=convention, attrs=dataset.attrs)])
    return export.files


@dataclass(frozen=True)
class Films:
    """What was written of normals in time, a film a band."""

    films: "tuple[Film, ...]"
    files: tuple[Path, ...]


def export_films(
    dataset: "xarray.Dataset",
    node: str,
    session: "Session",
    folder: Path,
    *,
    form: str,
    convention: str = "opengl",
    fps: float | None = None,
    progress: Progress = silent,
) -> Films:
    """Write a film of a node's normals, or its pictures.

    Raises:
        RequestError: the node has no normals in time, or something else is in the files' place.
    """
    from lightstage.products.film import check, file_names, write_series

    every = series_of(dataset, node, session)
    with refusals():
        check(every, form, fps)
    films = []
    with exported(folder, session.name, node, file_names(every, form)) as export:
        for film in write_series(export.work, every, form=form, convention=convention, fps=fps, progress=progress):
            export.add(film.files)
            films.append(film)
    return Films(tuple(films), tuple(export.files))


def series_of(dataset: "xarray.Dataset", node: str, session: "Session") -> "list[Series]":
    """The normals of a node in time, one a band.

    Raises:
        RequestError: it holds none.
    """
    from lightstage.products.film import Subject, open_series

    subject = Subject(session.name, session.facts["illumination"], session.facts["frame_rate_hz"])
    with refusals():
        return open_series(dataset, node, subject)


def export_meshes(
    dataset: "xarray.Dataset",
    node: str,
    session: "Session",
    folder: Path,
    store: Store,
    *,
    form: str,
    every: int = 1,
    space: str | None = None,
    progress: Progress = silent,
) -> list[Path]:
    """Write the meshes of a node's tracking frames, painted with what the session has; returns the files.

    Args:
        every: vertices are every so manieth pixel.
        space: of the normal map (`map_space`); None: there is none.

    Raises:
        RequestError: the node has no depth, there is no surface, or something else is in the files' place.
    """
    from lightstage.products.mesh import write_meshes
    from lightstage.products.names import mesh_files

    camera = _camera_of(dataset, node, session, store)
    frames = [int(frame) for frame in dataset.tracking.values]
    names = [name for frame in frames for name in mesh_files(node, frame, form)]
    with exported(folder, session.name, node, names) as export:
        export.add(
            write_meshes(
                export.work, node, dataset, camera, _beside(session, store),
                form=form, every=every, space=space, progress=progress,
            )
        )  # fmt: skip
    return export.files


def map_space(form: str, choice: str | None) -> str | None:
    """The space of a format's normal map; None: no map.

    Raises:
        RequestError: the format cannot carry it.
    """
    from lightstage.formats.meshes import normal_map_space

    with refusals("--normal-map: "):
        return normal_map_space(form, choice)


def _camera_of(dataset: "xarray.Dataset", node: str, session: "Session", store: Store) -> "Pinhole":
    """The camera that saw a node's depth."""
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
    bands: Any = items["bands"].values["bands"] if "bands" in items else ()
    return Beside(
        {
            node: open_dataset(store.results / session.name / node / folder)
            for node, folder in folders.items()
            if folder is not None
        },
        list(session.facts["bands_nm"]),
        {entry["centre_nm"]: entry.get("width_nm") for entry in bands},
    )

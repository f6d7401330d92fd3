"""export: a node's pictures as PNG, EXR or NPY, for tools that do not read zarr; its normals as a film, its depth
as meshes.

A file that is in the way is replaced only where `export.json` beside it says that an export of the same node and
session left it so.
"""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.cli import film, mesh
from lightstage.cli.deliver import exported
from lightstage.cli.refusals import refusals
from lightstage.cli.show import Screen
from lightstage.cli.values import number, whole
from lightstage.products import choices
from lightstage.store.errors import RequestError
from lightstage.store.root import Store

if TYPE_CHECKING:
    from lightstage.store.sessions import Session


def configure(commands: Any) -> None:
    """Add the commands of this file."""
    export = commands.add_parser(
        "export", help="write a node's pictures as PNG, EXR or NPY, a film of its normals, or its shape as a mesh"
    )
    export.add_argument("node", metavar="NODE")
    export.add_argument("--session", required=True, metavar="S")
    export.add_argument("--to", required=True, type=Path, metavar="DIR")
    export.add_argument(
        "--format", required=True, choices=(*choices.PLANE_FORMATS, *choices.FILM_FORMATS, *choices.MESH_FORMATS)
    )
    export.add_argument(
        "--convention", choices=tuple(choices.CONVENTIONS), default="opengl", help="where green points"
    )
    export.add_argument(
        "--fps",
        type=number,
        metavar="N",
        help=f"frames a second of a film (default: the session's rate / {choices.FILM_SLOWER}, so that one sees "
        f"what happens, and at least {choices.FILM_SLOWEST_FPS:g})",
    )
    export.add_argument(
        "--pipeline", type=Path, metavar="FILE", help="default: ./pipeline.yaml, or the packaged one"
    )
    export.add_argument(
        "--every", type=whole, metavar="N", help="a mesh's vertices are every Nth pixel (default: 1)"
    )
    export.add_argument(
        "--normal-map",
        choices=choices.NORMAL_MAPS,
        help="of a mesh: tangent (the default for glb) or object space (obj)",
    )
    export.set_defaults(handler=handle_export)


def handle_export(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage export."""
    from lightstage.cli.look import brings_in
    from lightstage.store.grid import open_dataset
    from lightstage.store.results import current_path
    from lightstage.store.sessions import raw_group, read_session

    if options.fps is not None and options.format not in choices.FILMS:
        raise RequestError(
            f"--fps {options.fps:g}: only a film has it; choose --format {' or '.join(choices.FILMS)}"
        )
    meshes = options.format in choices.MESH_FORMATS
    if options.every is not None and (options.every < 1 or not meshes):
        raise RequestError(
            f"--every {options.every}: a step of 1 or more for a mesh (--format {', '.join(choices.MESH_FORMATS)})"
        )
    if options.normal_map is not None and not meshes:
        raise RequestError(f"--normal-map {options.normal_map}: only a mesh has it; choose --format obj or glb")
    space = mesh.map_space(options.format, options.normal_map) if meshes else None
    store = Store(options.store, create=False)
    session = read_session(options.session, store)
    if brings_in(session.name, options.node, store, options.pipeline):
        path = raw_group(session, store)
    else:
        path = current_path(session.name, options.node, store)
    dataset = open_dataset(path)
    if meshes:
        camera = mesh.camera_of(dataset, options.node, session, store)
        screen.document(
            mesh.deliver_meshes(
                dataset, camera, options.node, session, options.to, screen, store,
                form=options.format, every=options.every or 1, space=space,
            )
        )  # fmt: skip
    elif options.format in choices.FILM_FORMATS:
        screen.document(_export_films(dataset, session, options, screen))
    else:
        screen.document(_export_planes(dataset, session.name, options, screen))
    return 0


def _export_films(
    dataset: Any, session: "Session", options: argparse.Namespace, screen: Screen
) -> Mapping[str, Any]:
    """The normals in time; returns what is answered."""
    from lightstage.products.film import check, file_names, write_series

    every = film.series_of(dataset, options.node, session)
    with refusals():
        check(every, options.format, options.fps)
    names = file_names(every, options.format)
    films = []
    with refusals(), exported(options.to, session.name, options.node, names) as export:
        for one_film in write_series(
            export.work, every,
            form=options.format, convention=options.convention, fps=options.fps, progress=screen.progress,
        ):  # fmt: skip
            export.add(one_film.files)
            films.append(one_film)
            film.say_film(one_film, options.node, session.name, options.to, screen)
    if options.format in choices.FILMS:
        for file in export.files:
            screen.say(f"film: {file}")
    return {
        "files": export.files,
        "convention": options.convention,
        "format": options.format,
        "fps": films[-1].fps,
        "change_top_deg": [one_film.top_deg for one_film in films],
    }


def _export_planes(dataset: Any, session: str, options: argparse.Namespace, screen: Screen) -> Mapping[str, Any]:
    """Every array as pictures; returns what is answered."""
    from lightstage.products.planes import plane_names, planes, suffix, write_plane

    names = [f"{name}.{suffix(options.format)}" for name in plane_names(dataset)]
    with refusals(), exported(options.to, session, options.node, names) as export:
        for plane in screen.progress(planes(dataset), len(names), "pictures"):
            name = write_plane(
                export.work, plane, form=options.format, convention=options.convention, attrs=dataset.attrs
            )
            export.add([name])
    screen.say(f"{len(export.files)} pictures of {options.node} ({session}) in {options.to}")
    return {"files": export.files, "convention": options.convention, "format": options.format}

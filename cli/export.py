"""export: a node's pictures as PNG, EXR or NPY, for tools that do not read zarr; its normals as a film, its depth
as meshes."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.api.errors import RequestError
from lightstage.api.stores import OpenSession, open_store
from lightstage.cli.show import Screen
from lightstage.cli.values import number, whole
from lightstage.products import choices

if TYPE_CHECKING:
    from lightstage.api.exports import Film


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
    from lightstage.api.exports import map_space

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
    space = map_space(options.format, options.normal_map) if meshes else None
    session = open_store(options.store).session(options.session)
    if meshes:
        dataset = session.open(options.node, pipeline=options.pipeline)
        every = options.every or 1
        screen.document(
            deliver_meshes(
                session, options.node, dataset, options.to, screen, form=options.format, every=every, space=space
            )
        )
    elif options.format in choices.FILM_FORMATS:
        screen.document(_films(session, options, screen))
    else:
        screen.document(_planes(session, options, screen))
    return 0


def _planes(session: OpenSession, options: argparse.Namespace, screen: Screen) -> dict[str, Any]:
    """Every array as pictures; returns what is answered."""
    files = session.export(
        options.node,
        options.to,
        format=options.format,
        convention=options.convention,
        pipeline=options.pipeline,
        progress=screen.progress,
    )
    screen.say(f"{len(files)} pictures of {options.node} ({session.name}) in {options.to}")
    return {"files": _texts(files), "convention": options.convention, "format": options.format}


def _films(session: OpenSession, options: argparse.Namespace, screen: Screen) -> dict[str, Any]:
    """The normals in time; returns what is answered."""
    from lightstage.api.exports import export_films

    done = export_films(
        session.open(options.node, pipeline=options.pipeline),
        options.node,
        session.read(),
        options.to,
        form=options.format,
        convention=options.convention,
        fps=options.fps,
        progress=screen.progress,
    )
    for film in done.films:
        say_film(film, options.node, session.name, options.to, screen)
    if options.format in choices.FILMS:
        for file in done.files:
            screen.say(f"film: {file}")
    return {
        "files": _texts(done.files),
        "convention": options.convention,
        "format": options.format,
        "fps": done.films[-1].fps,
        "change_top_deg": [film.top_deg for film in done.films],
    }


def say_film(film: "Film", node: str, session: str, folder: Path, screen: Screen) -> None:
    """What was written."""
    scale = f"the scale of the change ends at {film.top_deg:g} degrees"
    if film.pace is not None:
        screen.say(f"{film.frames} frames at {film.pace}; {scale}")
    else:
        screen.say(f"{film.frames} pictures of {node} ({session}) in {folder}; {scale}")


def deliver_meshes(
    session: OpenSession,
    node: str,
    dataset: Any,
    folder: Path,
    screen: Screen,
    *,
    form: str,
    every: int,
    space: str | None,
) -> dict[str, Any]:
    """The meshes of a node's tracking frames; returns what is answered."""
    from lightstage.api.exports import export_meshes

    files = export_meshes(
        dataset,
        node,
        session.read(),
        folder,
        session.opened,
        form=form,
        every=every,
        space=space,
        progress=screen.progress,
    )
    unit = "metres" if form == "glb" else "millimetres"
    screen.say(f"{dataset.sizes['tracking']} meshes of {node} ({session.name}) in {folder}, in {unit}")
    return {"files": _texts(files), "format": form, "unit": unit, "normal_map": space}


def _texts(files: Sequence[Path]) -> list[str]:
    return [str(file) for file in files]

"""shape: from a capture to a mesh that other programs open."""

import argparse
from pathlib import Path
from typing import Any

from lightstage.api.errors import RequestError
from lightstage.api.stores import open_store
from lightstage.cli.export import deliver_meshes
from lightstage.cli.run import add_run_options, answered, request_of, say_answer, session_given
from lightstage.cli.show import Screen
from lightstage.cli.values import whole
from lightstage.products import choices, names

NODES = ("shape", "reflectance")
"""The surface, and what it is painted with."""


def configure(commands: Any) -> None:
    """Add the command of this file."""
    shape = commands.add_parser("shape", help="a mesh with texture: import if need be, run, and write it")
    shape.add_argument("session", nargs="?", metavar="SESSION|FOLDER", help="default: the virtual rig's demo")
    shape.add_argument("--to", type=Path, metavar="DIR", help="default: pictures/<session>_shape of the store")
    shape.add_argument("--format", choices=choices.MESH_FORMATS, default="glb", help="default: %(default)s")
    shape.add_argument(
        "--every", type=whole, default=1, metavar="N", help="vertices are every Nth pixel (default: 1)"
    )
    shape.add_argument(
        "--normal-map", choices=choices.NORMAL_MAPS, help="tangent (the default for glb) or object space (obj)"
    )
    add_run_options(shape)
    shape.set_defaults(handler=handle_shape, computes=True)


def handle_shape(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage shape."""
    from lightstage.api.exports import map_space
    from lightstage.api.subjects import opened

    if options.every < 1:
        raise RequestError(f"--every {options.every}: expected a step of 1 or more")
    space = map_space(options.format, options.normal_map)
    store = open_store(options.store)
    session = session_given(options.session, store, screen)
    answer = answered(store, request_of(options, session.name, NODES), options, screen)
    summary = say_answer(answer, screen)
    dataset = opened(answer, ("shape",))["shape"]
    folder = options.to or store.root / "pictures" / names.shape_folder(session.name)
    delivered = deliver_meshes(
        session, "shape", dataset, folder, screen, form=options.format, every=options.every, space=space
    )
    for file in delivered["files"]:
        if file.endswith(options.format):
            screen.say(f"mesh: {file}")
    screen.document({**summary, **delivered})
    return 0

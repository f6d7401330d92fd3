"""material: what a renderer needs of a subject, as EXR maps and as a GLB with a glTF PBR material."""

import argparse
from pathlib import Path
from typing import Any

from lightstage.api.errors import RequestError
from lightstage.api.stores import open_store
from lightstage.cli.run import add_run_options, answered, request_of, say_answer, session_given
from lightstage.cli.show import Screen
from lightstage.cli.values import whole
from lightstage.products import choices


def configure(commands: Any) -> None:
    """Add the command of this file."""
    material = commands.add_parser(
        "material", help="base colour, gloss, normals and depth for renderers, as EXR and GLB (glTF PBR)"
    )
    material.add_argument("session", nargs="?", metavar="SESSION|FOLDER", help="default: the virtual rig's demo")
    material.add_argument("--to", required=True, type=Path, metavar="DIR")
    material.add_argument(
        "--format", default="exr,glb", metavar="exr,glb", help="one or both, with a comma (default: both)"
    )
    material.add_argument("--tracking", type=whole, metavar="N", help="the tracking frame (default: the first)")
    add_run_options(material)
    material.set_defaults(handler=handle_material, computes=True)


def handle_material(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage material."""
    from lightstage.api.deliveries import MaterialDelivery

    formats = options.format.split(",")
    wrong = [form for form in formats if form not in choices.MATERIAL_FORMATS]
    if wrong:
        raise RequestError(f"--format {options.format}: '{wrong[0]}' is not known; expected exr, glb or exr,glb")
    store = open_store(options.store)
    session = session_given(options.session, store, screen)
    delivery = MaterialDelivery(session.read(), store.opened, options.to, formats)
    request = request_of(options, session.name, delivery.nodes)
    answer = answered(store, request, options, screen)
    summary = say_answer(answer, screen)
    delivered = delivery.deliver(request, answer, tracking=options.tracking)
    if not delivered.glossy:
        screen.warn("the capture lacks one of the polarisations, so there are no specular maps and no roughness")
    if not delivered.absolute:
        screen.warn(
            "the scale is relative, because a lights or bands item is missing or the parallel camera alone: 1 in "
            "the base colour is the brightest point"
        )
    screen.table(("file", "what"), [(name, entry["what"]) for name, entry in delivered.entries.items()])
    screen.say(f"{len(delivered.files)} files in {options.to}; {delivered.files[-1].name} says what each is")
    screen.document(
        {
            **summary,
            "files": [str(file) for file in delivered.files],
            "material": {**delivered.document, "files": delivered.entries},
        }
    )
    return 0

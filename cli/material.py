"""material: what a renderer needs of a subject, as EXR maps and as a GLB with a glTF PBR material."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.api.refusals import refusals
from lightstage.api.stores import open_store
from lightstage.cli.run import add_run_options, answered, request_of, say_answer, session_given
from lightstage.cli.show import Screen
from lightstage.cli.values import whole
from lightstage.products import choices, names
from lightstage.store.errors import RequestError

if TYPE_CHECKING:
    pass


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
    from lightstage.api.subjects import material_nodes, material_of
    from lightstage.formats.whole_set import WholeSet
    from lightstage.products.material import document, write_material

    formats = options.format.split(",")
    wrong = [form for form in formats if form not in choices.MATERIAL_FORMATS]
    if wrong:
        raise RequestError(f"--format {options.format}: '{wrong[0]}' is not known; expected exr, glb or exr,glb")
    store = open_store(options.store)
    session = session_given(options.session, store, screen)
    nodes = material_nodes(session.read())
    delivery = WholeSet(options.to, names.MATERIAL_RECORD, subject={"session": session.name})
    with refusals():
        delivery.claim(names.material(formats, glossy="gloss" in nodes))
    request = request_of(options, session.name, nodes)
    answer = answered(store, request, options, screen)
    summary = say_answer(answer, screen)
    material = material_of(answer, request, session.read(), store.opened, tracking=options.tracking)
    with refusals(), delivery.making() as work:
        files = write_material(work, material, formats)
        entries = {name: {**entry, "results": dict(material.recipes)} for name, entry in files.items()}
        made = [*delivery.settle(work, document(material), entries), options.to / names.MATERIAL_RECORD]
    if material.gloss is None:
        screen.warn("the capture lacks one of the polarisations, so there are no specular maps and no roughness")
    if not material.absolute:
        screen.warn(
            "the scale is relative, because a lights or bands item is missing or the parallel camera alone: 1 in "
            "the base colour is the brightest point"
        )
    screen.table(("file", "what"), [(name, entry["what"]) for name, entry in files.items()])
    screen.say(f"{len(made)} files in {options.to}; {names.MATERIAL_RECORD} says what each is")
    screen.document(
        {**summary, "files": [str(file) for file in made], "material": {**document(material), "files": files}}
    )
    return 0

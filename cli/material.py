"""material: what a renderer needs of a subject, as EXR maps and as a GLB with a glTF PBR material."""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.cli.refusals import refusals
from lightstage.cli.run import add_run_options, override_items, paths_of, run_session, session_of
from lightstage.cli.show import Screen
from lightstage.cli.values import whole
from lightstage.products import choices, names
from lightstage.store.errors import RequestError
from lightstage.store.root import Store

if TYPE_CHECKING:
    from lightstage.products.material import Material


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
    from lightstage.cli.demo import demo_session
    from lightstage.formats.whole_set import WholeSet
    from lightstage.products.material import document, write_material

    formats = options.format.split(",")
    wrong = [form for form in formats if form not in choices.MATERIAL_FORMATS]
    if wrong:
        raise RequestError(f"--format {options.format}: '{wrong[0]}' is not known; expected exr, glb or exr,glb")
    store = Store(options.store)
    options.session = session_of(options.session, store, screen) if options.session else demo_session(store, screen)
    nodes = nodes_of(options.session, store)
    delivery = WholeSet(options.to, names.MATERIAL_RECORD, of={"session": options.session})
    with refusals():
        delivery.claim(names.material(formats, glossy="gloss" in nodes))
    summary = run_session(options, store, screen, nodes)
    material = material_of(options, store, paths_of(summary, nodes, options.session))
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


def nodes_of(session: str, store: Store) -> tuple[str, ...]:
    """What has to be run: gloss needs both polarisations."""
    from lightstage.products.material import GLOSS_NODES, NODES
    from lightstage.store.sessions import read_session

    polarised = {"parallel", "cross"} <= set(read_session(session, store).polarisations)
    return (*NODES, *GLOSS_NODES) if polarised else NODES


def material_of(options: argparse.Namespace, store: Store, paths: Mapping[str, Path]) -> "Material":
    """The subject, by the results at `paths`.

    Raises:
        RequestError: there is no such tracking frame, or nothing is known of the subject.
    """
    from lightstage.dag.plan import bound_items
    from lightstage.products.material import read_material
    from lightstage.store.grid import open_dataset
    from lightstage.store.sessions import read_session

    session = read_session(options.session, store)
    items = bound_items(session, store, override_items(options.calibration, store))
    with refusals():
        return read_material(
            {node: open_dataset(path) for node, path in paths.items()},
            {node: path.name for node, path in paths.items()},
            items["camera"].values,
            items["bands"].values["bands"] if "bands" in items else (),
            session=session.name,
            tracking=options.tracking,
        )

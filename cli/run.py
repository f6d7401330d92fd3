"""run, normals: compute what a session needs."""

import argparse
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from lightstage.api.errors import RequestError
from lightstage.api.requests import Request, make_request, pipeline_path
from lightstage.api.stores import Answer, OpenSession, OpenStore, open_store
from lightstage.cli.show import RunWatcher, Screen
from lightstage.cli.values import whole
from lightstage.sizes import human_size


def configure(commands: Any) -> None:
    """Add the commands of this file."""
    run = commands.add_parser("run", help="compute nodes of the pipeline for a session")
    run.add_argument(
        "nodes",
        nargs="*",
        metavar="NODE",
        help="which nodes (default: all but those that pipeline.yaml computes when: asked)",
    )
    add_session_options(run)
    add_run_options(run)
    run.add_argument("--dry-run", action="store_true", help="say what would be computed, and compute nothing")
    run.set_defaults(handler=handle_run, computes=True)

    normals = commands.add_parser(
        "normals", help="the main job: import if need be, run everything, and draw the contact sheet"
    )
    normals.add_argument("session", nargs="?", metavar="SESSION|FOLDER", help="default: the virtual rig's demo")
    add_run_options(normals)
    normals.set_defaults(handler=handle_normals, computes=True)

    performance = commands.add_parser(
        "performance", help="a moving subject: import if need be, run everything, and write the film"
    )
    performance.add_argument(
        "session", nargs="?", metavar="SESSION|FOLDER", help="default: the virtual rig's moving head"
    )
    add_run_options(performance)
    performance.set_defaults(handler=handle_performance, computes=True)


def add_session_options(parser: argparse.ArgumentParser) -> None:
    """What every command that looks at a pipeline laid over a session takes."""
    parser.add_argument("--session", required=True, metavar="S", help="the session")


def add_run_options(parser: argparse.ArgumentParser) -> None:
    """What decides a run."""
    parser.add_argument("--set", action="append", default=[], metavar="NODE.PARAM=VALUE", dest="overrides")
    parser.add_argument("--frames", metavar="A:B", help="only these frames (half-open)")
    parser.add_argument(
        "--pipeline", type=Path, metavar="FILE", help="default: ./pipeline.yaml, or the packaged one"
    )
    parser.add_argument(
        "--calibration", action="append", default=[], metavar="KIND=FILE", help="use this item for this run"
    )
    parser.add_argument("--workers", type=whole, metavar="N", help="local processes instead of threads")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="a running Dask cluster that shares the store")


def request_of(options: argparse.Namespace, session: str, nodes: Sequence[str] = ()) -> Request:
    """What the options ask for."""
    return make_request(
        session,
        nodes,
        changes=options.overrides,
        frames=options.frames,
        pipeline=options.pipeline,
        items=options.calibration,
    )


def handle_run(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage run."""
    store = open_store(options.store)
    request = request_of(options, options.session, options.nodes)
    if options.dry_run:
        return _dry_run(store, request, screen)
    screen.document(say_answer(answered(store, request, options, screen), screen))
    return 0


def answered(store: OpenStore, request: Request, options: argparse.Namespace, screen: Screen) -> Answer:
    """The answer to a request, computed where the options say, and shown while it is."""
    with RunWatcher(screen) as watcher:
        return store.answer(request, workers=options.workers, scheduler=options.scheduler, progress=watcher)


_MOST_WARNINGS = 12


def say_answer(answer: Answer, screen: Screen) -> dict[str, Any]:
    """Say what a run came to; returns the same as plain data."""
    for note in answer.notes:
        screen.warn(note)
    say_nodes(answer, screen)
    for name, node in answer.nodes.items():
        for key, value in node.remarks.items():
            shown = f"{value:.1f}" if isinstance(value, float) else value
            screen.say(f"{name}: {key.replace('_', ' ')}: {shown}")
        for sentence in node.warnings[:_MOST_WARNINGS]:
            screen.warn(f"{name}: {sentence}")
        if len(node.warnings) > _MOST_WARNINGS:
            more = len(node.warnings) - _MOST_WARNINGS
            screen.warn(f"{name}: and {more} more; they stand in the result's attributes")
    shown = [(name, node.path) for name, node in answer.nodes.items() if node.path is not None]
    if shown:
        screen.say(f"{answer.seconds:.2f} s; {shown[-1][0]} is in {shown[-1][1]}")
    return {"session": answer.session, "seconds": round(answer.seconds, 3), "nodes": plain_nodes(answer)}


def say_nodes(answer: Answer, screen: Screen) -> None:
    """A line a node."""
    rows = [
        (name, node.computed, node.reused, f"{node.seconds:.2f}", human_size(node.bytes))
        for name, node in answer.nodes.items()
    ]
    screen.table(("node", "computed", "reused", "seconds", "size"), rows, right=(1, 2, 3, 4))


def plain_nodes(answer: Answer) -> dict[str, Any]:
    """What --json says of the nodes."""
    return {
        name: {
            "computed": node.computed,
            "reused": node.reused,
            "seconds": round(node.seconds, 3),
            "bytes": node.bytes,
            "path": None if node.path is None else str(node.path),
        }
        for name, node in answer.nodes.items()
    }


def _dry_run(store: OpenStore, request: Request, screen: Screen) -> int:
    nodes = store.outlook(request)
    rows = [(name, node.compute, node.check, node.reuse) for name, node in nodes.items()]
    screen.table(("node", "compute", "check", "reuse"), rows, right=(1, 2, 3))
    if any(node.check for node in nodes.values()):
        screen.say("check: computed only if what is above comes out different")
    screen.document({"session": request.session, "nodes": {name: asdict(node) for name, node in nodes.items()}})
    return 0


def handle_normals(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage normals."""
    from lightstage.api.pictures import contact_sheet

    store = open_store(options.store)
    session = session_given(options.session, store, screen)
    summary = say_answer(answered(store, request_of(options, session.name), options, screen), screen)
    sheet = contact_sheet(session.read(), store.opened)
    screen.say(f"picture: {sheet}")
    screen.document({**summary, "picture": str(sheet)})
    return 0


def handle_performance(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage performance."""
    from lightstage.api.groups import last_moving_normals
    from lightstage.api.pictures import session_film
    from lightstage.cli.export import say_film

    store = open_store(options.store)
    session = session_given(options.session, store, screen, moving=True)
    if session.facts["frame_rate_hz"] is None:
        raise RequestError(
            f"session '{session.name}' is static (its capture.yaml has no frame_rate_hz), so there is no film; "
            f"`lightstage normals {session.name}` draws its picture"
        )
    answer = answered(store, request_of(options, session.name), options, screen)
    summary = say_answer(answer, screen)
    node = last_moving_normals(answer)
    if node is None:
        raise RequestError(
            f"no node of {pipeline_path(options.pipeline)} has normals of several frames of session "
            f"'{session.name}', so there is no film of it"
        )
    film = session_film(
        session.read(),
        node,
        store.opened,
        written=lambda film: say_film(film, node, session.name, store.root / "pictures", screen),
        progress=screen.progress,
    )
    screen.say(f"film: {film}")
    screen.document({**summary, "film": str(film)})
    return 0


def session_given(given: str | None, store: OpenStore, screen: Screen, *, moving: bool = False) -> OpenSession:
    """The session of that name, or the one that a capture folder becomes; the demo's where none is given.

    Args:
        moving: the demo is a performance.
    """
    from lightstage.api.virtual_rig import PERFORMANCE, Head
    from lightstage.cli.demo import head_session
    from lightstage.cli.sessions import import_folder

    if given is None:
        return head_session(store, screen, PERFORMANCE if moving else Head())
    if given in store.sessions:
        return store.session(given)
    folder = Path(os.path.expanduser(given))
    if not folder.is_dir():
        known = ", ".join(store.sessions) or "none yet"
        raise RequestError(f"'{given}' is neither a session of {store.root} ({known}) nor a capture folder")
    return import_folder(folder, store, screen).session

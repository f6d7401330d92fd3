"""run, normals: compute what a session needs."""

import argparse
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.cli.show import RunWatcher, Screen
from lightstage.cli.values import whole
from lightstage.dag.sources import ROOT
from lightstage.store.errors import RequestError, WorkError
from lightstage.store.files import human_size
from lightstage.store.root import Store

if TYPE_CHECKING:
    from lightstage.dag.plan import Plan, State
    from lightstage.store.calibration import Item


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


_NOT_IN_KEY = ("workers", "scheduler", "pipeline")
"""Options of a run that do not decide what comes out, or, the pipeline, do so by what the file holds."""


def deciding_options(options: argparse.Namespace) -> dict[str, Any]:
    """All that `add_run_options` offers and that decides what comes out: what is added there is in the key."""
    offered = argparse.ArgumentParser(add_help=False)
    add_run_options(offered)
    names = {action.dest for action in offered._actions} - set(_NOT_IN_KEY)
    return {name: getattr(options, name) for name in sorted(names)}


def pipeline_path(given: Path | None, name: str = "pipeline.yaml") -> Path:
    """The pipeline file: the one given, the current folder's, or the packaged one."""
    here = Path(name)
    return given if given is not None else here if here.is_file() else ROOT / name


def parse_frames(text: str | None) -> tuple[int, int] | None:
    """`A:B`, half-open."""
    if text is None:
        return None
    first, colon, last = text.partition(":")
    digits = all(re.fullmatch(r"[0-9]{1,9}", part) for part in (first, last))
    if not (colon and digits and int(first) < int(last)):
        raise RequestError(f"--frames {text}: expected A:B with A < B, half-open, such as 0:10")
    return int(first), int(last)


def override_items(given: Sequence[str], store: Store) -> "dict[str, Item]":
    """The items of --calibration KIND=FILE."""
    from lightstage.store import document
    from lightstage.store.calibration import KINDS, put_item, read_item

    items = {}
    for text in given:
        kind, equals, path = text.partition("=")
        if not (equals and path):
            raise RequestError(f"--calibration {text}: expected KIND=FILE, such as homography=homography.yaml")
        if kind not in KINDS:
            raise RequestError(f"--calibration {text}: '{kind}' is no kind of item{document.nearest(kind, KINDS)}")
        item, original = read_item(Path(path), store.chunks, kind=kind)
        put_item(item, original, store)
        items[kind] = item
    return items


def plan_for(options: argparse.Namespace, store: Store, nodes: Sequence[str] = (), *, made: bool = False) -> "Plan":
    """The pipeline that the options name, laid over their session.

    Args:
        nodes: which; none for all that a run computes unasked.
        made: also those that were asked for once and have a result.
    """
    from lightstage.dag.graph import load_graph
    from lightstage.dag.plan import bound_items, check_frames, make_plan
    from lightstage.stages import TABLE
    from lightstage.store.results import current
    from lightstage.store.sessions import read_session

    graph = load_graph(pipeline_path(options.pipeline), TABLE, overrides=getattr(options, "overrides", ()))
    session = read_session(options.session, store)
    check_frames(parse_frames(getattr(options, "frames", None)), session)
    items = bound_items(session, store, override_items(getattr(options, "calibration", ()), store))
    if made:
        have = {name for name in graph.nodes if current(session.name, name, store) is not None}
        nodes = [name for name, node in graph.nodes.items() if not node.asked or name in have]
    return make_plan(graph, session, store, items, nodes)


def handle_run(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage run."""
    store = Store(options.store)
    if options.dry_run:
        return _dry_run(options, store, screen)
    summary = run_session(options, store, screen, options.nodes)
    screen.document(summary)
    return 0


def run_session(options: argparse.Namespace, store: Store, screen: Screen, nodes: Sequence[str]) -> dict[str, Any]:
    """Run nodes for a session and say what was done; answers from one record when nothing has changed."""
    from lightstage.dag.recall import lasting, recall, remember, request_now

    if options.workers is not None and options.workers < 1:
        raise RequestError(f"--workers {options.workers}: at least one process is needed")
    if options.scheduler is not None and not options.scheduler.strip():
        raise RequestError("--scheduler is empty; name an address, such as tcp://host:8786, or leave it out")
    if options.workers and options.scheduler:
        raise RequestError("--workers and --scheduler: choose one")
    frames = parse_frames(options.frames)
    request = None
    if not options.calibration:  # an item names pictures, whose bytes are not looked at here
        request = request_now(
            store,
            session=options.session,
            pipeline=pipeline_path(options.pipeline),
            options={**deciding_options(options), "nodes": list(nodes)},
        )
    answer = recall(store, request) if request is not None else None
    if answer is not None:
        return _tell(answer, store, screen, {}, 0.0)

    from lightstage.dag.places import Where
    from lightstage.dag.run import run
    from lightstage.store.sessions import show_raw

    store.scratch.sweep()
    plan = plan_for(options, store, nodes)
    where = Where(workers=options.workers, scheduler=options.scheduler)
    with RunWatcher(screen) as watcher:
        import time

        state, results = run(plan, store, watcher, frames=frames, where=where, versions=versions())
        elapsed = time.perf_counter() - watcher.began
    # read anew: the session may have been imported again in the meantime
    try:
        show_raw(options.session, store)
    except WorkError as error:
        screen.warn(str(error))
    _say_skipped(state, screen)
    answer = remember(store, plan.request(request) if lasting(request) else None, options.session, results)
    store.scratch.leave()
    done = {name: (result.computed, result.seconds) for name, result in results.items()}
    return _tell(answer, store, screen, done, elapsed)


def versions() -> dict[str, str]:
    """What the provenance names."""
    import platform
    from importlib.metadata import version

    names = ("numpy", "numba", "opencv-contrib-python-headless", "dask", "zarr", "numcodecs")
    return {"python": platform.python_version(), **{name: version(name) for name in names}}


def _say_skipped(state: "State", screen: Screen) -> None:
    for name, node in state.nodes.items():
        if node.plan.blocks and not any(node.selected) and state.frames is not None:
            first, last = state.frames
            screen.warn(f"{name} was not computed: each of its blocks needs frames outside {first}:{last}")


_MOST_WARNINGS = 12


def _tell(
    answer: Mapping[str, Any],
    store: Store,
    screen: Screen,
    done: Mapping[str, tuple[int, float]],
    elapsed: float,
) -> dict[str, Any]:
    nodes, rows = {}, []
    last = None
    for name, node in answer["nodes"].items():
        computed, seconds = done.get(name, (0, 0.0))
        path = None
        if node["folder"] is not None:
            path = os.path.join(store.results, answer["session"], name, node["folder"])
            last = (name, path, node)
        reused = node["blocks"] - computed
        nodes[name] = {
            "computed": computed,
            "reused": reused,
            "seconds": round(seconds, 3),
            "bytes": node["bytes"],
            "path": path,
        }
        rows.append((name, computed, reused, f"{seconds:.2f}", human_size(node["bytes"])))
    screen.table(("node", "computed", "reused", "seconds", "size"), rows, right=(1, 2, 3, 4))
    for node in answer["nodes"].values():
        for key, value in node["attrs"].items():
            if key == "warnings":
                for sentence in value[:_MOST_WARNINGS]:
                    screen.warn(f"{node['name']}: {sentence}")
                if len(value) > _MOST_WARNINGS:
                    more = len(value) - _MOST_WARNINGS
                    screen.warn(f"{node['name']}: and {more} more; they stand in the result's attributes")
                continue
            shown = f"{value:.1f}" if isinstance(value, float) else value
            screen.say(f"{node['name']}: {key.replace('_', ' ')}: {shown}")
    if last is not None:
        screen.say(f"{elapsed:.2f} s; {last[0]} is in {last[1]}")
    return {"session": answer["session"], "seconds": round(elapsed, 3), "nodes": nodes}


def _dry_run(options: argparse.Namespace, store: Store, screen: Screen) -> int:
    from lightstage.dag.plan import look_up

    state = look_up(plan_for(options, store, options.nodes), store, frames=parse_frames(options.frames))
    nodes, rows = {}, []
    for name, node in state.nodes.items():
        if node.plan.node.stage.is_source:
            continue
        missing = node.missing()
        sure = sum(node.keys[i] is not None for i in missing)
        chosen = sum(node.selected)
        nodes[name] = {"compute": sure, "check": len(missing) - sure, "reuse": chosen - len(missing)}
        rows.append((name, sure, len(missing) - sure, chosen - len(missing)))
    screen.table(("node", "compute", "check", "reuse"), rows, right=(1, 2, 3))
    if any(row[2] for row in rows):
        screen.say("check: computed only if what is above comes out different")
    screen.document({"session": options.session, "nodes": nodes})
    return 0


def handle_normals(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage normals."""
    from lightstage.cli.demo import demo_session
    from lightstage.cli.sheet import contact_sheet

    store = Store(options.store)
    options.session = session_of(options.session, store, screen) if options.session else demo_session(store, screen)
    summary = run_session(options, store, screen, ())
    sheet = contact_sheet(options.session, store)
    screen.say(f"picture: {sheet}")
    screen.document({**summary, "picture": str(sheet)})
    return 0


def handle_performance(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage performance."""
    from lightstage.cli.demo import moving_session
    from lightstage.cli.film import session_film
    from lightstage.store.sessions import read_session

    store = Store(options.store)
    options.session = (
        session_of(options.session, store, screen) if options.session else moving_session(store, screen)
    )
    session = read_session(options.session, store)
    if session.facts["frame_rate_hz"] is None:
        raise RequestError(
            f"session '{session.name}' is static (its capture.yaml has no frame_rate_hz), so there is no film; "
            f"`lightstage normals {session.name}` draws its picture"
        )
    summary = run_session(options, store, screen, ())
    film = session_film(session, _filmed(summary, options), store, screen)
    screen.say(f"film: {film}")
    screen.document({**summary, "film": str(film)})
    return 0


def _filmed(summary: Mapping[str, Any], options: argparse.Namespace) -> str:
    """The last node of a run that has a normal at every frame, or else the last at every tracking frame."""
    from lightstage.store.grid import open_dataset

    for dim in ("frame", "tracking"):
        for name, node in reversed(summary["nodes"].items()):
            if node["path"] is None:
                continue
            dataset = open_dataset(Path(node["path"]))
            if "normal" in dataset and dataset["normal"].sizes.get(dim, 0) > 1:
                return str(name)
    raise RequestError(
        f"no node of {pipeline_path(options.pipeline)} has normals of several frames of session "
        f"'{options.session}', so there is no film of it"
    )


def paths_of(summary: Mapping[str, Any], nodes: Sequence[str], session: str) -> dict[str, Path]:
    """Where the results of a run are, by node: those of this run, and no others.

    Raises:
        RequestError: --frames has left a node nothing.
    """
    paths = {node: summary["nodes"][node]["path"] for node in nodes}
    if None in paths.values():
        raise RequestError(f"session '{session}': --frames leaves no tracking frame to work on")
    return {node: Path(path) for node, path in paths.items()}


def session_of(given: str, store: Store, screen: Screen) -> str:
    """The session of that name, or the one that a capture folder becomes."""
    from lightstage.cli.sessions import import_folder
    from lightstage.store.sessions import session_names

    if given in session_names(store):
        return given
    folder = Path(os.path.expanduser(given))
    if not folder.is_dir():
        known = ", ".join(session_names(store)) or "none yet"
        raise RequestError(f"'{given}' is neither a session of {store.root} ({known}) nor a capture folder")
    return import_folder(folder, store, screen).session.name

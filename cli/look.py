"""status, why, graph, path: what there is, and why."""

import argparse
from pathlib import Path
from typing import Any

from lightstage.api.errors import RequestError
from lightstage.api.stores import open_store
from lightstage.cli.run import add_run_options, add_session_options, request_of
from lightstage.cli.show import Screen, say_where_none_is
from lightstage.sizes import human_size


def configure(commands: Any) -> None:
    """Add the commands of this file."""
    status = commands.add_parser("status", help="fresh, stale, partial or missing, node by node")
    status.add_argument("--session", metavar="S", help="default: every session")
    add_run_options(status)
    status.set_defaults(handler=handle_status)

    why = commands.add_parser("why", help="which input of a node's key changed")
    why.add_argument("node", metavar="NODE")
    add_session_options(why)
    add_run_options(why)
    why.set_defaults(handler=handle_why)

    graph = commands.add_parser("graph", help="draw the pipeline")
    graph.add_argument("--pipeline", type=Path, metavar="FILE")
    graph.set_defaults(handler=handle_graph)

    path = commands.add_parser("path", help="print where a node's result is, and nothing else")
    path.add_argument("node", metavar="NODE")
    add_session_options(path)
    path.add_argument("--pipeline", type=Path, metavar="FILE", help="default: ./pipeline.yaml, or the packaged one")
    path.set_defaults(handler=handle_path)


def handle_status(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage status."""
    store = open_store(options.store)
    say_where_none_is(store, screen)
    document: dict[str, Any] = {}
    rows = []
    for name in [options.session] if options.session is not None else store.sessions:
        try:
            nodes = store.status(request_of(options, name)).values()
        except RequestError as error:
            if options.session is not None:
                raise
            document[name] = {"error": str(error)}
            rows.append((name, "", "cannot run", "", ""))
            screen.warn(str(error))
            continue
        document[name] = {
            s.name: {
                "status": s.condition,
                "known": s.known,
                "blocks": s.blocks,
                "bytes": s.size,
                "folder": s.folder,
            }
            for s in nodes
        }
        rows += [(name, s.name, s.condition, f"{s.known}/{s.blocks}", human_size(s.size)) for s in nodes]
    screen.table(("session", "node", "status", "blocks", "size"), rows, right=(3, 4))
    screen.document({"sessions": document})
    return 0


def handle_why(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage why."""
    why = open_store(options.store).why(request_of(options, options.session, [options.node]))
    reasons = [{"node": r.node, "what": r.what, "old": r.old, "new": r.new} for r in why.reasons]
    screen.say(why.summary)
    if reasons:
        screen.table(("node", "what", "old", "new"), [tuple(reason.values()) for reason in reasons])
    screen.document({"session": options.session, "node": options.node, "summary": why.summary, "reasons": reasons})
    return 0


def handle_graph(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage graph."""
    from lightstage.api.pipelines import drawing, read_pipeline

    pipeline = read_pipeline(options.pipeline)
    for line in drawing(pipeline):
        screen.say(line)
    screen.document(
        {
            "pipeline": pipeline.source,
            "nodes": {
                name: {
                    "stage": node.stage,
                    "from": list(node.above),
                    "when": "asked" if node.asked else "always",
                    "parameters": dict(node.parameters),
                    "outputs": {array: list(dims) for array, dims in node.outputs.items()},
                }
                for name, node in pipeline.nodes.items()
            },
        }
    )
    return 0


def handle_path(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage path."""
    path = open_store(options.store).session(options.session).path(options.node, pipeline=options.pipeline)
    screen.say(str(path))
    screen.document({"path": str(path)})
    return 0

"""status, why, graph, path: what there is, and why."""

import argparse
from pathlib import Path
from typing import Any

from lightstage.cli.run import add_run_options, add_session_options, parse_frames, pipeline_path, plan_for
from lightstage.cli.show import Screen
from lightstage.store.files import human_size
from lightstage.store.root import Store


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
    from lightstage.dag.explain import status
    from lightstage.dag.plan import look_up
    from lightstage.store.errors import RequestError
    from lightstage.store.sessions import session_names

    store = Store(options.store, create=False)
    answer: dict[str, Any] = {}
    rows = []
    one = options.session is not None
    for name in [options.session] if one else session_names(store):
        options.session = name
        try:
            state = look_up(plan_for(options, store, made=True), store, frames=parse_frames(options.frames))
        except RequestError as error:
            if one:
                raise
            answer[name] = {"error": str(error)}
            rows.append((name, "", "cannot run", "", ""))
            screen.warn(str(error))
            continue
        found = status(state, store)
        answer[name] = {
            s.name: {
                "status": s.condition,
                "known": s.known,
                "blocks": s.blocks,
                "bytes": s.size,
                "folder": s.folder,
            }
            for s in found
        }
        rows += [(name, s.name, s.condition, f"{s.known}/{s.blocks}", human_size(s.size)) for s in found]
    screen.table(("session", "node", "status", "blocks", "size"), rows, right=(3, 4))
    screen.document({"sessions": answer})
    return 0


def handle_why(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage why."""
    from lightstage.dag.explain import why
    from lightstage.dag.plan import look_up
    from lightstage.store.document import nearest
    from lightstage.store.errors import RequestError

    store = Store(options.store, create=False)
    state = look_up(plan_for(options, store, [options.node]), store, frames=parse_frames(options.frames))
    known = [name for name, node in state.nodes.items() if not node.plan.node.stage.is_source]
    if options.node not in known:
        raise RequestError(f"there is no result of a node '{options.node}'{nearest(options.node, known)}")
    sentence, reasons = why(state, options.node, store)
    screen.say(sentence)
    if reasons:
        screen.table(("node", "what", "old", "new"), [(r.node, r.what, r.old, r.new) for r in reasons])
    screen.document(
        {
            "session": options.session,
            "node": options.node,
            "summary": sentence,
            "reasons": [{"node": r.node, "what": r.what, "old": r.old, "new": r.new} for r in reasons],
        }
    )
    return 0


def handle_graph(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage graph."""
    from lightstage.dag.graph import load_graph
    from lightstage.stages import TABLE

    graph = load_graph(pipeline_path(options.pipeline), TABLE)
    below: dict[str, list[str]] = {name: [] for name in graph.nodes}
    for name, node in graph.nodes.items():
        for upper in node.above:
            below[upper].append(name)

    # a stack, not a recursion: a chain may be of any length
    waiting = [(name, "", True, True) for name, node in reversed(list(graph.nodes.items())) if not node.above]
    while waiting:
        name, prefix, last, root = waiting.pop()
        node = graph.nodes[name]
        branch = "" if root else ("└─ " if last else "├─ ")
        different = {k: v for k, v in node.params if v != type(node.params).model_fields[k].default}
        shown = "".join(f", {k}: {v}" for k, v in different.items())
        also = node.above[1:]
        more = f" (and from {', '.join(also)})" if also else ""
        when = " (when asked)" if node.asked else ""
        screen.say(f"{prefix}{branch}{name}: {node.stage.summary}{shown}{more}{when}")
        children = [child for child in below[name] if graph.nodes[child].above[0] == name]
        deeper = prefix + ("" if root else "   " if last else "│  ")
        waiting += reversed([(child, deeper, child == children[-1], False) for child in children])
    screen.document(
        {
            "pipeline": graph.source,
            "nodes": {
                name: {
                    "stage": node.stage.name,
                    "from": list(node.above),
                    "when": "asked" if node.asked else "always",
                    "parameters": node.params.model_dump(mode="json"),
                    "outputs": {array: list(output.dims) for array, output in node.stage.outputs.items()},
                }
                for name, node in graph.nodes.items()
            },
        }
    )
    return 0


def handle_path(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage path."""
    from lightstage.store.results import current_path
    from lightstage.store.sessions import read_session

    store = Store(options.store, create=False)
    read_session(options.session, store)
    if brings_in(options.session, options.node, store, options.pipeline):
        path = store.sessions / options.session / "raw.zarr"
    else:
        path = current_path(options.session, options.node, store)
    screen.say(str(path))
    screen.document({"path": str(path)})
    return 0


def brings_in(session: str, node: str, store: Store, pipeline: Path | None) -> bool:
    """Whether a node without a result is one that brings in the session, whatever it is called."""
    from lightstage.store.results import current

    return current(session, node, store) is None and node in _source_nodes(pipeline)


def _source_nodes(pipeline: Path | None) -> list[str]:
    """The nodes of a pipeline that read no other."""
    from lightstage.store import document

    entries = document.load(pipeline_path(pipeline), what="a pipeline").value
    nodes = entries.get("stages") if isinstance(entries, dict) else None
    if not isinstance(nodes, dict):
        return []
    return [name for name, entry in nodes.items() if isinstance(entry, dict) and not entry.get("from")]

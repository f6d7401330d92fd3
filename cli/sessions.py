"""import, sessions, calibration: what comes into the store, and what is bound to what."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lightstage.api.stores import Imported, OpenSession, OpenStore, open_store
from lightstage.cli.show import Screen, say_where_none_is
from lightstage.sizes import human_size

_MOST_CHANGES, _MOST_ROWS = 30, 60
"""That are told of."""


def configure(commands: Any) -> None:
    """Add the commands of this file."""
    bring = commands.add_parser("import", help="bring a capture folder into the store")
    bring.add_argument("folder", type=Path, metavar="FOLDER")
    bring.add_argument("--session", metavar="NAME", help="another name than the one in capture.yaml")
    bring.set_defaults(handler=handle_import)

    sessions = commands.add_parser("sessions", help="list, show or remove sessions")
    actions = sessions.add_subparsers(dest="action", required=True, metavar="list|show|remove")
    actions.add_parser("list").set_defaults(handler=handle_list)
    show = actions.add_parser("show")
    show.add_argument("session", metavar="SESSION")
    show.set_defaults(handler=handle_show)
    remove = actions.add_parser("remove")
    remove.add_argument("session", metavar="SESSION")
    remove.set_defaults(handler=handle_remove)

    calibration = commands.add_parser("calibration", help="list, show or bind calibration items")
    actions = calibration.add_subparsers(dest="action", required=True, metavar="list|show|use")
    listing = actions.add_parser("list")
    listing.add_argument("--session", metavar="S", help="only what is bound to this session")
    listing.set_defaults(handler=handle_items)
    show = actions.add_parser("show")
    show.add_argument("item", metavar="ITEM", help="name or its beginning, such as homography-3f")
    show.set_defaults(handler=handle_item)
    use = actions.add_parser("use")
    use.add_argument("item", metavar="FILE|ITEM")
    use.add_argument("--session", required=True, metavar="S")
    use.set_defaults(handler=handle_use)


def import_folder(
    folder: Path | Sequence[Path], store: OpenStore, screen: Screen, name: str | None = None
) -> Imported:
    """Import, and say what came of it."""
    done = store.import_capture(folder, name, progress=screen.progress)
    say_imported(done, screen)
    return done


def say_imported(done: Imported, screen: Screen) -> None:
    """What came of an import."""
    for warning in done.warnings:
        screen.warn(warning)
    if not done.changes:
        screen.say(f"session '{done.session.name}': nothing has changed")
    for change in done.changes[:_MOST_CHANGES]:
        screen.say(change)
    if len(done.changes) > _MOST_CHANGES:
        screen.say(f"... and {len(done.changes) - _MOST_CHANGES} more changes")
    say_verdict(done.session, screen)


def handle_import(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage import."""
    done = import_folder(options.folder, open_store(options.store), screen, options.session)
    session = done.session.read()
    screen.document(
        {
            "session": session.name,
            "new": done.new,
            "changed": bool(done.changes),
            "changes": list(done.changes),
            "warnings": list(done.warnings),
            "pictures": len(session.source["files"]),
            "bytes": session.size,
            "items": dict(session.items),
            "verdict": [dict(row) for row in session.verdict],
        }
    )
    return 0


def say_verdict(session: OpenSession, screen: Screen) -> None:
    """A line an illumination and band: is the capture any good?"""
    rows = []
    for row in session.read().verdict:
        marks = []
        if row["saturated"] > 0.001:
            marks.append("saturated")
        if row["underexposed"] > 0.95 and row["illumination"] != "O":
            marks.append("dark")
        residual = row["complement_residual"]
        if residual is not None and residual > 0.1:
            marks.append("moved, or the lights disagree")
        rows.append(
            (
                row["illumination"],
                f"{row['band_nm']:g}",
                row["polarisation"],
                f"{row['saturated']:.2%}",
                f"{row['underexposed']:.1%}",
                "" if residual is None else f"{residual:.1%}",
                ", ".join(marks) or "good",
            )
        )
    worst = [row for row in rows if row[-1] != "good"]
    if len(rows) > _MOST_ROWS:
        screen.say(
            f"{len(rows) - len(worst)} of {len(rows)} pictures are good" + (", the others:" if worst else "")
        )
        rows = worst[:_MOST_ROWS]
    head = ("light", "nm", "camera", "saturated", "underexposed", "a + a' - c", "verdict")
    if rows:
        screen.table(head, rows, right=(1, 3, 4, 5))


def handle_list(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage sessions list."""
    store = open_store(options.store)
    say_where_none_is(store, screen)
    sessions = [store.session(name).read() for name in store.sessions]
    rows = [
        (
            s.name,
            s.sizes["frame"],
            s.sizes["band"],
            "+".join(s.polarisations),
            f"{s.shape[1]} x {s.shape[0]}",
            human_size(s.size),
        )
        for s in sessions
    ]
    screen.table(("session", "frames", "bands", "cameras", "size", "stored"), rows, right=(1, 2, 5))
    screen.document({"sessions": [{"session": s.name, "sizes": s.sizes, "bytes": s.size} for s in sessions]})
    return 0


def handle_show(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage sessions show."""
    opened = open_store(options.store).session(options.session)
    session = opened.read()
    raw = opened.folder / "raw.zarr"
    facts = session.facts
    lights = " ".join(facts["illumination"])
    rate = facts["frame_rate_hz"]
    screen.say(f"session {session.name}, from {session.source['folder']}")
    screen.say(f"  {session.sizes['frame']} frames: {lights if len(lights) < 90 else lights[:87] + '...'}")
    screen.say(
        f"  bands {', '.join(f'{b:g}' for b in facts['bands_nm'])} nm; {facts['bits']} bits, {facts['encoding']}"
    )
    screen.say(f"  cameras {', '.join(f'{p}: {c}' for p, c in facts['cameras'].items())}")
    screen.say(f"  {'static' if rate is None else f'{rate:g} frames/s'}; {session.shape[1]} x {session.shape[0]}")
    screen.say(f"  stored {human_size(session.size)} in {raw}")
    for kind, name in opened.items.items():
        screen.say(f"  {kind}: {name}")
    say_verdict(opened, screen)
    screen.document(
        {
            "session": session.name,
            "facts": dict(session.facts),
            "sizes": session.sizes,
            "bytes": session.size,
            "folder": session.source["folder"],
            "raw": str(raw),
            "items": dict(session.items),
            "verdict": [dict(row) for row in session.verdict],
        }
    )
    return 0


def handle_remove(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage sessions remove."""
    size = open_store(options.store).remove(options.session)
    screen.say(
        f"session '{options.session}' and its results are gone ({human_size(size)} of links); "
        "`lightstage gc` frees the chunks that nothing else uses"
    )
    screen.document({"removed": options.session, "bytes": size})
    return 0


def handle_items(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage calibration list."""
    items = open_store(options.store).items(options.session)
    rows = [(i.name, i.notes.get("rig", ""), i.notes.get("valid_from", ""), ", ".join(i.sessions)) for i in items]
    screen.table(("item", "rig", "valid from", "bound to"), rows)
    screen.document(
        {
            "items": [
                {
                    "item": i.name,
                    "kind": i.kind,
                    "digest": i.digest,
                    "notes": dict(i.notes),
                    "sessions": list(i.sessions),
                }
                for i in items
            ]
        }
    )
    return 0


def handle_item(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage calibration show."""
    from lightstage.api.items import item_text

    item, text = item_text(open_store(options.store).opened, options.item)
    screen.say(f"# {item.path}")
    screen.say(text.rstrip())
    for camera, picture in item.pictures.items():
        screen.say(f"# {camera}: {picture}")
    screen.document(
        {
            "item": item.name,
            "digest": item.digest,
            "values": item.values,
            "notes": dict(item.notes),
            "pictures": dict(item.pictures),
        }
    )
    return 0


def handle_use(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage calibration use."""
    from lightstage.api.items import bind

    session = open_store(options.store).session(options.session)
    bound = bind(session.read(), options.item, session.opened)
    if bound.changed:
        was = f" instead of {bound.kind}-{bound.before[:12]}" if bound.before else ""
        screen.say(f"session '{session.name}' now uses {bound.item}{was}")
    else:
        screen.say(f"session '{session.name}' uses {bound.item} already (the same numbers); nothing has changed")
    screen.document({"session": session.name, "item": bound.item, "changed": bound.changed, "before": bound.before})
    return 0

"""import, sessions, calibration: what comes into the store, and what is bound to what."""

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.cli.show import Screen
from lightstage.store.errors import RequestError
from lightstage.store.files import human_size
from lightstage.store.root import Store

if TYPE_CHECKING:
    from lightstage.store.importer import Imported
    from lightstage.store.sessions import Session


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
    folder: Path | Sequence[Path], store: Store, screen: Screen, name: str | None = None
) -> "Imported":
    """Import, and say what came of it."""
    from lightstage.store.importer import import_capture

    done = import_capture(folder, store, name=name, progress=screen.progress)
    session = done.session
    for warning in done.warnings:
        screen.warn(warning)
    if not done.changes:
        screen.say(f"session '{session.name}': nothing has changed")
    else:
        for change in done.changes[:30]:
            screen.say(change)
        if len(done.changes) > 30:
            screen.say(f"... and {len(done.changes) - 30} more changes")
    say_verdict(session, screen)
    return done


def handle_import(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage import."""
    from lightstage.store.capture import read_capture

    read_capture(options.folder)  # a typo in it must not even make a store
    store = Store(options.store)
    store.scratch.sweep()
    done = import_folder(options.folder, store, screen, options.session)
    store.scratch.leave()
    screen.document(
        {
            "session": done.session.name,
            "new": done.new,
            "changed": bool(done.changes),
            "changes": list(done.changes),
            "warnings": list(done.warnings),
            "pictures": len(done.session.source["files"]),
            "bytes": done.session.size,
            "items": dict(done.session.items),
            "verdict": [dict(row) for row in done.session.verdict],
        }
    )
    return 0


def say_verdict(session: "Session", screen: Screen) -> None:
    """A line an illumination and band: is the capture any good?"""
    rows = []
    for row in session.verdict:
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
    if len(rows) > 60:
        screen.say(
            f"{len(rows) - len(worst)} of {len(rows)} pictures are good" + (", the others:" if worst else "")
        )
        rows = worst[:60]
    head = ("light", "nm", "camera", "saturated", "underexposed", "a + a' - c", "verdict")
    if rows:
        screen.table(head, rows, right=(1, 3, 4, 5))


def handle_list(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage sessions list."""
    from lightstage.store.sessions import read_session, session_names

    store = Store(options.store, create=False)
    sessions = [read_session(name, store) for name in session_names(store)]
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
    from lightstage.store.sessions import read_session

    store = Store(options.store, create=False)
    session = read_session(options.session, store)
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
    screen.say(f"  stored {human_size(session.size)} in {store.sessions / session.name / 'raw.zarr'}")
    for kind, digest in session.items.items():
        screen.say(f"  {kind}: {kind}-{digest[:12]}")
    say_verdict(session, screen)
    screen.document(
        {
            "session": session.name,
            "facts": dict(session.facts),
            "sizes": session.sizes,
            "bytes": session.size,
            "folder": session.source["folder"],
            "raw": str(store.sessions / session.name / "raw.zarr"),
            "items": dict(session.items),
            "verdict": [dict(row) for row in session.verdict],
        }
    )
    return 0


def handle_remove(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage sessions remove."""
    from lightstage.store.sessions import remove_session

    store = Store(options.store, create=False)
    size = remove_session(options.session, store)
    screen.say(
        f"session '{options.session}' and its results are gone ({human_size(size)} of links); "
        "`lightstage gc` frees the chunks that nothing else uses"
    )
    screen.document({"removed": options.session, "bytes": size})
    return 0


def handle_items(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage calibration list."""
    from lightstage.store.calibration import all_items
    from lightstage.store.sessions import read_session, session_names

    store = Store(options.store, create=False)
    names = [options.session] if options.session else session_names(store)
    bound: dict[str, list[str]] = {}
    for name in names:
        for kind, digest in read_session(name, store).items.items():
            bound.setdefault(f"{kind}-{digest[:12]}", []).append(name)
    items = [item for item in all_items(store) if not options.session or item.name in bound]
    rows = [
        (
            item.name,
            item.notes.get("rig", ""),
            item.notes.get("valid_from", ""),
            ", ".join(bound.get(item.name, [])),
        )
        for item in items
    ]
    screen.table(("item", "rig", "valid from", "bound to"), rows)
    screen.document(
        {
            "items": [
                {
                    "item": i.name,
                    "kind": i.kind,
                    "digest": i.digest,
                    "notes": dict(i.notes),
                    "sessions": bound.get(i.name, []),
                }
                for i in items
            ]
        }
    )
    return 0


def handle_item(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage calibration show."""
    from lightstage.store.calibration import find_item, original_of

    store = Store(options.store, create=False)
    item = find_item(options.item, store)
    path = store.calibration / item.name / "item.yaml"
    screen.say(f"# {path}")
    screen.say(original_of(item, store).decode().rstrip())
    pictures = {camera: f"{p.shape[1]} x {p.shape[0]}, {p.dtype}" for camera, p in item.pictures.items()}
    for camera, text in pictures.items():
        screen.say(f"# {camera}: {text}")
    screen.document(
        {
            "item": item.name,
            "digest": item.digest,
            "values": item.values,
            "notes": dict(item.notes),
            "pictures": pictures,
        }
    )
    return 0


def handle_use(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage calibration use."""
    from lightstage.store.calibration import find_item, put_item, read_item
    from lightstage.store.sessions import bind_item, read_session

    store = Store(options.store, create=False)
    session = read_session(options.session, store).name
    path = Path(os.path.expanduser(options.item))
    if path.is_file():
        item, original = read_item(path, store.chunks)
        put_item(item, original, store)
    elif path.suffix in (".yaml", ".yml"):
        raise RequestError(f"{path} is missing: expected a calibration item")
    else:
        item = find_item(options.item, store)
    before = bind_item(session, item, store)
    changed = before != item.digest
    if changed:
        was = f" instead of {item.kind}-{before[:12]}" if before else ""
        screen.say(f"session '{session}' now uses {item.name}{was}")
    else:
        screen.say(f"session '{session}' uses {item.name} already (the same numbers); nothing has changed")
    screen.document({"session": session, "item": item.name, "changed": changed, "before": before})
    return 0

"""verify, gc, upgrade: look after the store."""

import argparse
import re
from typing import Any

from lightstage.api.errors import DamagedChunkError, DamagedGroupError, RequestError, WorkError
from lightstage.api.stores import FORMAT, open_store, upgrade
from lightstage.cli.show import Screen
from lightstage.sizes import human_size

_GRACE = re.compile(r"([0-9]{1,6})([smhd]?)")
_SECONDS = {"s": 1, "m": 60, "h": 3600, "d": 86400, "": 1}


def configure(commands: Any) -> None:
    """Add the commands of this file."""
    verify = commands.add_parser("verify", help="read every stored byte, and quarantine what is damaged")
    verify.set_defaults(handler=handle_verify)
    gc = commands.add_parser("gc", help="free what no session and no result in use refers to")
    gc.add_argument("--dry-run", action="store_true", help="only say what would be freed")
    gc.add_argument(
        "--grace", default="7d", metavar="TIME", help="keep what is younger: 90s, 30m, 12h, 7d (default)"
    )
    gc.set_defaults(handler=handle_gc)
    upgrade = commands.add_parser("upgrade", help="carry a store of an older lightstage over to this one")
    upgrade.set_defaults(handler=handle_upgrade)


def handle_verify(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage verify."""
    report = open_store(options.store).verify(progress=screen.progress)
    for damage in report.damaged:
        screen.say(f"damaged: {damage.path}: belongs to {damage.belongs_to}; {damage.remedy}")
    for path in report.strange:
        screen.say(f"not of the store: {path}; it was left alone")
    screen.say(
        f"{report.chunks} chunks, {human_size(report.size)}: "
        + (f"{len(report.damaged)} were damaged or gone" if report.damaged else "all intact")
    )
    screen.document(
        {
            "chunks": report.chunks,
            "bytes": report.size,
            "damaged": [
                {"path": str(d.path), "belongs_to": d.belongs_to, "remedy": d.remedy} for d in report.damaged
            ],
            "strange": [str(path) for path in report.strange],
        }
    )
    return 1 if report.damaged else 0


def set_aside(damage: DamagedChunkError | DamagedGroupError, options: argparse.Namespace, screen: Screen) -> None:
    """Mend what a command has met damaged, or set it aside, so that the command can begin again.

    A command that computes (its parser says `computes`) makes what was set aside again.

    Raises:
        WorkError: the command cannot do that; says which one can.
    """
    screen.warn(f"{damage}; looking through the store")
    try:
        damages = open_store(options.store).verify().damaged
    except WorkError as error:
        raise WorkError(f"{damage}, and cannot be mended: {error}") from None
    for item in damages:
        screen.warn(f"{item.path} was damaged: {item.belongs_to}; {item.remedy}")
    lasting = [item for item in damages if not item.recomputable]
    if isinstance(damage, DamagedChunkError) or damage.group.suffix == ".zarr":  # not made by a stage
        if lasting:
            raise WorkError(f"{damage}; {lasting[0].remedy}")
    elif not (damage.group.is_dir() or getattr(options, "computes", False)):
        session, node = damage.group.parts[-3:-1]
        raise WorkError(f"{damage}. It was set aside; `lightstage run {node} --session {session}` makes it again")


def handle_gc(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage gc."""
    match = _GRACE.fullmatch(options.grace)
    if not match:
        raise RequestError(f"--grace {options.grace}: expected a time such as 90s, 30m, 12h or 7d")
    grace = int(match[1]) * _SECONDS[match[2]]
    freed = open_store(options.store).gc(grace_s=grace, dry_run=options.dry_run)
    verb = "would free" if options.dry_run else "freed"
    screen.say(
        f"{verb} {human_size(freed.size)}: {freed.chunks} chunks, {freed.records} records, "
        f"{freed.results} results, {freed.items} calibration items (nothing younger than {options.grace})"
    )
    screen.document(
        {
            "dry_run": options.dry_run,
            "bytes": freed.size,
            "chunks": freed.chunks,
            "records": freed.records,
            "results": freed.results,
            "items": freed.items,
        }
    )
    return 0


def handle_upgrade(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage upgrade."""
    done = upgrade(options.store, progress=screen.progress)
    for line in done.left:
        screen.say(f"not carried over: {line}")
    if done.began == FORMAT and not done.carried:
        screen.say(f"the store is of format {FORMAT}, which this program reads; nothing to do")
    else:
        what = ", ".join(f"{count} {kind}" for kind, count in done.carried.items()) or "nothing was left to do"
        screen.say(f"format {done.began} -> {FORMAT}: {what}")
    screen.document({"from": done.began, "to": FORMAT, "carried": dict(done.carried), "left": done.left})
    return 1 if done.left else 0

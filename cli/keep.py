"""verify, gc: look after the store."""

import argparse
import re
from typing import Any

from cli.show import Screen
from store.errors import RequestError
from store.files import human_size
from store.root import Store

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


def handle_verify(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage verify."""
    from store.verify import verify

    store = Store(options.store, create=False)
    report = verify(store, progress=screen.progress)
    for damage in report.damaged:
        screen.say(f"damaged: {damage.path}: belongs to {damage.belongs_to}; {damage.remedy}")
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
        }
    )
    return 1 if report.damaged else 0


def handle_gc(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage gc."""
    from store.gc import gc

    match = _GRACE.fullmatch(options.grace)
    if not match:
        raise RequestError(f"--grace {options.grace}: expected a time such as 90s, 30m, 12h or 7d")
    grace = int(match[1]) * _SECONDS[match[2]]
    freed = gc(Store(options.store, create=False), grace_s=grace, dry_run=options.dry_run)
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

"""alignment: what `align` did to the pictures of one tracking frame, on one page."""

import argparse
from pathlib import Path
from typing import Any

from lightstage.api.errors import RequestError
from lightstage.api.stores import open_store
from lightstage.cli.show import Screen
from lightstage.cli.values import pixel, whole
from lightstage.products import choices


def configure(commands: Any) -> None:
    """Add the command of this file."""
    alignment = commands.add_parser("alignment", help="draw how well the pictures of a tracking frame are aligned")
    alignment.add_argument("--session", required=True, metavar="S", help="the session")
    alignment.add_argument("--tracking", type=whole, metavar="N", help="the tracking frame (default: the first)")
    alignment.add_argument(
        "--at",
        action="append",
        default=[],
        metavar="X,Y",
        help=f"mark this pixel, up to {choices.ALIGNMENT_POINTS} times (default: textured places that move most)",
    )
    alignment.add_argument(
        "--to", type=Path, metavar="FILE.png", help="default: pictures/<session>_alignment_<tracking>.png"
    )
    alignment.set_defaults(handler=handle_alignment)


def handle_alignment(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage alignment."""
    from lightstage.api.pages import alignment_page

    store = open_store(options.store)
    session = store.session(options.session).read()
    if options.to is not None and options.to.suffix.lower() != ".png":
        raise RequestError(f"--to {options.to}: the picture is a PNG; name a file that ends in .png")
    if len(options.at) > choices.ALIGNMENT_POINTS:
        raise RequestError(
            f"--at is given {len(options.at)} times; at most {choices.ALIGNMENT_POINTS} points are marked"
        )
    page = alignment_page(
        session,
        store.opened,
        tracking=options.tracking,
        points=[pixel(text) for text in options.at],
        file=options.to,
    )
    screen.say(str(page.path))
    screen.document(
        {
            "path": str(page.path),
            "session": session.name,
            "tracking": page.tracking,
            "points": [list(point) for point in page.points],
            "residual_before": page.residual_before,
            "residual_after": page.residual_after,
        }
    )
    return 0

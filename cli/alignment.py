"""alignment: what `align` did to the pictures of one tracking frame, on one page."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lightstage.api.refusals import refusals
from lightstage.api.stores import open_store
from lightstage.cli.show import Screen
from lightstage.cli.values import whole
from lightstage.products import choices, names
from lightstage.store.errors import RequestError


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
    from lightstage.formats.png import encode_png
    from lightstage.formats.whole_file import write_whole
    from lightstage.products.alignment import chosen_points, read_set, residual_of
    from lightstage.products.alignment_page import box, draw

    store = open_store(options.store)
    opened = store.session(options.session)
    session = opened.name
    if options.to is not None and options.to.suffix.lower() != ".png":
        raise RequestError(f"--to {options.to}: the picture is a PNG; name a file that ends in .png")
    result, stack = (opened.open(node) for node in ("align", "stack"))
    with refusals():
        aligned = read_set(session, result, stack, options.tracking)
    height, width = aligned.middle.captured.shape
    points = given_points(options.at, (height, width)) if options.at else chosen_points(aligned, box(width)[0])
    residual = residual_of(aligned)
    path = options.to or store.root / "pictures" / names.alignment(session, aligned.tracking)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, encode_png(draw(aligned, points, residual)))
    screen.say(str(path))
    screen.document(
        {
            "path": str(path),
            "session": session,
            "tracking": aligned.tracking,
            "points": [list(point) for point in points],
            "residual_before": None if residual is None else residual.mean_before,
            "residual_after": None if residual is None else residual.mean_after,
        }
    )
    return 0


def given_points(texts: Sequence[str], shape: tuple[int, int]) -> list[tuple[int, int]]:
    """(x, y) of every --at.

    Raises:
        RequestError: too many, not X,Y, or outside the picture of `shape` (y, x).
    """
    height, width = shape
    if len(texts) > choices.ALIGNMENT_POINTS:
        raise RequestError(
            f"--at is given {len(texts)} times; at most {choices.ALIGNMENT_POINTS} points are marked"
        )
    points = []
    for text in texts:
        try:
            x, y = (int(part) for part in text.split(","))
        except ValueError:
            raise RequestError(f"--at {text}: expected X,Y in whole pixels, such as 120,200") from None
        if not (0 <= x < width and 0 <= y < height):
            raise RequestError(
                f"--at {text} is outside the picture; X is 0 to {width - 1} and Y is 0 to {height - 1}"
            )
        points.append((x, y))
    return points

"""skin: melanin and haemoglobin of a session on one page, and the spectra of picked points."""

import argparse
from typing import Any

from lightstage.api.errors import RequestError
from lightstage.api.stores import open_store
from lightstage.cli.run import add_run_options, answered, request_of, say_answer, session_given
from lightstage.cli.show import Screen
from lightstage.cli.values import pixel, whole
from lightstage.products import choices


def configure(commands: Any) -> None:
    """Add the command of this file."""
    skin = commands.add_parser(
        "skin", help="pigment maps: import if need be, run, draw the maps and spectra of points"
    )
    skin.add_argument("session", nargs="?", metavar="SESSION|FOLDER", help="default: the virtual rig's demo")
    skin.add_argument(
        "--at",
        action="append",
        default=[],
        metavar="X,Y",
        help=f"the spectrum of this pixel, up to {choices.SKIN_POINTS} times (default: little and much pigment)",
    )
    skin.add_argument("--tracking", type=whole, metavar="N", help="the tracking frame (default: the first)")
    add_run_options(skin)
    skin.set_defaults(handler=handle_skin, computes=True)


def handle_skin(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage skin."""
    from lightstage.api.pages import skin_pages, skin_spectra
    from lightstage.api.subjects import SKIN_NODES, skin_of

    points = [pixel(text) for text in options.at]
    if len(points) > choices.SKIN_POINTS:
        raise RequestError(f"--at is given {len(points)} times; at most {choices.SKIN_POINTS} spectra are drawn")
    store = open_store(options.store)
    session = session_given(options.session, store, screen)
    request = request_of(options, session.name, SKIN_NODES)
    answer = answered(store, request, options, screen)
    summary = say_answer(answer, screen)
    skin = skin_of(answer, request, store.opened, tracking=options.tracking)
    picked = skin_spectra(skin, points)
    files = skin_pages(skin, picked, store.opened)
    screen.table(
        ("point", "x, y", "melanin", "haemoglobin", "baseline", "residual", "angle to skin"),
        [
            (
                point.name,
                "" if point.at is None else f"{point.at[0]}, {point.at[1]}",
                *(f"{value:.3f}" for value in point.pigments.values()),
                f"{point.angle_deg:.1f}°",
            )
            for point in picked
        ],
        right=(2, 3, 4, 5, 6),
    )
    for what, file in files.items():
        screen.say(f"{what}: {file}")
    screen.document(
        {
            **summary,
            **{what: str(file) for what, file in files.items()},
            "tracking": skin.tracking,
            "units": {name: skin.attrs[f"{name}_unit"] for name in ("melanin", "haemoglobin")},
            "points": [
                {
                    "name": point.name,
                    "at": None if point.at is None else list(point.at),
                    "reflectance": [round(float(v), 5) for v in point.reflectance],
                    "fit": [round(float(v), 5) for v in point.fit],
                    **{name: round(value, 5) for name, value in point.pigments.items()},
                    "angle_deg": round(point.angle_deg, 2),
                }
                for point in picked
            ],
        }
    )
    return 0

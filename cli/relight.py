"""relight: a captured subject under other lights, as pictures.

All --light and the --environment light one picture together; each --led is a picture of its own, under the light of
that name where the lights item has it.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lightstage.api.errors import RequestError
from lightstage.api.stores import open_store
from lightstage.cli.run import add_run_options, answered, request_of, say_answer, session_given
from lightstage.cli.show import Screen
from lightstage.cli.values import number, whole
from lightstage.products import choices, names


def configure(commands: Any) -> None:
    """Add the command of this file."""
    relight = commands.add_parser("relight", help="a captured subject under other lights: PNG and EXR")
    relight.add_argument("session", nargs="?", metavar="SESSION|FOLDER", help="default: the virtual rig's demo")
    relight.add_argument("--to", required=True, type=Path, metavar="DIR")
    relight.add_argument(
        "--light",
        action="append",
        default=[],
        metavar="AZIMUTH,ELEVATION,STRENGTH",
        help="a distant light, in degrees: 0,0 is at the camera, 90,0 at the picture's right (a negative azimuth "
        "needs --light=-30,20,1); several add up",
    )
    relight.add_argument(
        "--led",
        action="append",
        default=[],
        metavar="ID|all",
        help="a picture under one of the rig's lights, such as L07; L07+L12 for both; all for one of each",
    )
    relight.add_argument("--environment", type=Path, metavar="MAP", help="a latitude-longitude map, .hdr or .exr")
    relight.add_argument(
        "--rotate",
        type=number,
        metavar="DEG",
        help="turn the environment: at 90 what was towards the camera is at the picture's right",
    )
    relight.add_argument(
        "--turn",
        type=whole,
        metavar="N",
        help=f"a film, {names.RELIGHT_FILM}: the environment turned in N steps",
    )
    relight.add_argument(
        "--samples",
        type=whole,
        metavar="N",
        help=f"lights that stand for an environment (default: {choices.ENVIRONMENT_LIGHTS})",
    )
    relight.add_argument(
        "--exposure",
        type=number,
        metavar="FACTOR",
        help="of the PNG: linear values times this (default: one for all pictures, by the brightest)",
    )
    relight.add_argument("--tracking", type=whole, metavar="N", help="the tracking frame (default: the first)")
    add_run_options(relight)
    relight.set_defaults(handler=handle_relight, computes=True)


def handle_relight(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage relight."""
    from lightstage.api.deliveries import RelightDelivery, one_setup
    from lightstage.api.subjects import material_nodes

    _check(options)
    together = one_setup(
        [_distant(text) for text in options.light],
        options.environment,
        count=options.samples,
        rotate_deg=options.rotate,
    )
    store = open_store(options.store)
    session = session_given(options.session, store, screen)
    request = request_of(options, session.name, material_nodes(session.read()))
    delivery = RelightDelivery(
        session.read(), store.opened, options.to, request, together, leds=options.led, turns=options.turn
    )
    answer = answered(store, request, options, screen)
    summary = say_answer(answer, screen)
    delivered = delivery.deliver(
        answer, exposure=options.exposure, tracking=options.tracking, progress=screen.progress
    )
    _say_rows(delivered.rows, screen)
    if not delivered.glossy:
        screen.warn("the capture lacks one of the polarisations, so the pictures have no gloss")
    screen.say(
        f"{len(delivered.files)} files in {options.to}; {options.to / names.RELIGHT_SHEET} shows the pictures"
    )
    screen.document(
        {
            **summary,
            "files": [str(file) for file in delivered.files],
            "pictures": [row._asdict() for row in delivered.rows],
            **delivered.document,
        }
    )
    return 0


def _say_rows(rows: Sequence[Any], screen: Screen) -> None:
    compared = any(row.psnr_db is not None for row in rows)
    cells = [
        [*row[:2], f"{row.exposure:.4g}", f"{row.median:.4f}", f"{row.bright:.4f}", f"{row.clipped:.2%}"]
        for row in rows
    ]
    if compared:
        for row, line in zip(rows, cells, strict=True):
            line += ["", ""] if row.psnr_db is None else [f"{row.psnr_db:.1f} dB", f"{row.ssim:.3f}"]
    head = ["picture", "lights", "exposure", "median", "99.5 %", "clipped", *(["PSNR", "SSIM"] if compared else [])]
    screen.table(head, cells, right=range(2, len(head)))
    if compared:
        screen.say("PSNR and SSIM: luminance, against the session's own pictures under these lights, noise and all")


def _check(options: argparse.Namespace) -> None:
    """What can be refused without looking at anything."""
    if not (options.light or options.led or options.environment):
        raise RequestError("relight: no light is named; give --light, --led or --environment")
    for option, value in (("--rotate", options.rotate), ("--turn", options.turn), ("--samples", options.samples)):
        if value is not None and options.environment is None:
            raise RequestError(f"{option} {value:g}: only an environment has it; add --environment MAP")
    if options.turn is not None and not 2 <= options.turn <= 1000:
        raise RequestError(f"--turn {options.turn}: a film has 2 to 1000 steps")
    if options.samples is not None and not 1 <= options.samples <= 10000:
        raise RequestError(f"--samples {options.samples}: 1 to 10000 lights stand for an environment")
    if options.exposure is not None and not 0 < options.exposure <= choices.STRONGEST:
        raise RequestError(
            f"--exposure {options.exposure:g}: expected a factor above 0 and up to {choices.STRONGEST:g}, "
            "such as 1.5"
        )


def _distant(text: str) -> tuple[float, float, float]:
    """Azimuth and elevation in degrees, and strength."""
    try:
        azimuth, elevation, strength = (float(part) for part in text.split(","))
    except ValueError:
        raise RequestError(f"--light {text}: expected AZIMUTH,ELEVATION,STRENGTH, such as 45,30,1") from None
    if not (abs(azimuth) <= 360 and abs(elevation) <= 90 and 0 < strength <= choices.STRONGEST):
        raise RequestError(
            f"--light {text}: expected an azimuth of at most 360 degrees, an elevation of at most 90 and "
            f"a strength above 0 and up to {choices.STRONGEST:g}"
        )
    return azimuth, elevation, strength

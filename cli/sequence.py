"""sequence: which illumination comes when, what it can be used for, how fast it plays, and whether it flashes."""

import argparse
import re
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.api.errors import RequestError
from lightstage.cli.show import Screen
from lightstage.cli.times import add_timing, timing_of
from lightstage.cli.values import number, whole

if TYPE_CHECKING:
    from lightstage.api.sequences import Plan, TrackingFrame

_SHOWN = 3
"""Views of flicker that a person is told of; --json has all."""
_LINE = 110
_MINIMAL_SETS = 12
"""That there are."""


def configure(commands: Any) -> None:
    """Add the commands of this file."""
    family = commands.add_parser("sequence", help="plan, check or count capture sequences")
    actions = family.add_subparsers(
        dest="action", required=True, metavar="static|multispectral|wilson|minimal|check|count"
    )
    for kind, text in (
        ("static", "C X Y Z Xc Yc Zc"),
        ("multispectral", "the static set under each filter, the wheel turned least"),
        ("wilson", "X Y Z C Xc Yc Zc C ...: 4n + 3 images"),
        ("minimal", "X Z C Y Xc C ...: 3n + 2 images, by Dutta's three rules"),
    ):
        make = actions.add_parser(kind, help=text)
        if kind in ("wilson", "minimal"):
            make.add_argument(
                "--tracking", type=whole, default=12, metavar="N", help="tracking frames (default: 12)"
            )
        if kind == "minimal":
            make.add_argument(
                "--sets", choices=("pure", "mixed"), default="pure", help="cycle of 36 images, or of 9"
            )
        if kind == "multispectral":
            make.add_argument(
                "--bands",
                default="407,434,445,497,576,655",
                metavar="NM,...",
                help="wavelengths in the order of the wheel",
            )
            make.add_argument("--wheel-ms", type=number, metavar="MS", help="one turn of the filter wheel")
        add_timing(make)
        make.add_argument(
            "--accept-flashing",
            metavar="TEXT",
            help="play it although it flashes at 3 to 30 Hz: who decided, and why; recorded in the plan",
        )
        make.add_argument(
            "--to", type=Path, metavar="FILE.yaml", help="write the frames of a capture.yaml, and the plan"
        )
        make.set_defaults(handler=handle_make, kind=kind)
    check = actions.add_parser("check", help="what every tracking frame of a sequence supports")
    check.add_argument(
        "sequence", nargs="+", metavar="SEQUENCE|FILE|FOLDER", help='"X Z C Y Xc", or a capture.yaml'
    )
    add_timing(check)
    check.set_defaults(handler=handle_check)
    count = actions.add_parser("count", help="images needed against tracking frames")
    count.add_argument("--upto", type=whole, default=12, metavar="N", help="tracking frames (default: 12)")
    count.add_argument("--plot", type=Path, metavar="FILE.png", help="draw it as well")
    count.set_defaults(handler=handle_count)


def handle_make(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage sequence static|multispectral|wilson|minimal."""
    from lightstage.api.sequences import PERFORMANCES, plan, write_plan

    choice: dict[str, Any] = {
        name: getattr(options, name) for name in ("tracking", "sets") if hasattr(options, name)
    }
    if options.kind == "multispectral":
        choice["bands_nm"] = _bands(options.bands)
    planned = plan(options.kind, timing=timing_of(options), **choice)
    if planned.timing is None and options.kind in PERFORMANCES and options.to:
        raise RequestError(
            "--to: a performance needs its times; give --exposure-ms, and the rig's --setup-ms and --readout-ms"
        )
    accepted = _accepted(options.accept_flashing, planned, screen)
    if options.to:
        write_plan(options.to, planned, accepted)
    _say_sequence(screen, planned)
    _say_counts(screen, planned)
    if accepted:
        screen.say(f"flashing accepted: {accepted}")
    if options.to:
        screen.say(f"written: {options.to}")
    exposures = [exposure._asdict() for exposure in planned.exposures]
    screen.document(
        {
            "kind": options.kind,
            "sequence": list(planned.names),
            "images": planned.images,
            "tracking": len(planned.tracking),
            **({"exposures": exposures} if exposures else {}),
            **planned.rates(),
            "accepted": accepted,
            "written": str(options.to) if options.to else None,
        }
    )
    return 0


def handle_check(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage sequence check."""
    from lightstage.api.sequences import flash_sentence, judge, read_sequence

    names, rate = read_sequence(options.sequence)
    planned, unjudged = judge(names, timing_of(options, rate))
    if unjudged is not None:
        screen.warn(f"whether it flashes was not judged: {unjudged}")
    records = planned.tracking
    if not records:
        screen.say("no tracking frame: there is no C in it, so no normals can be made at a time of its own")
    else:
        rows = [(r.frame, " ".join((*r.before, "C", *r.after)), _sets(r) or "nothing", _lacks(r)) for r in records]
        screen.table(("frame", "window", "supports", "missing"), rows, right=(0,))
    _say_counts(screen, planned)
    if planned.flashes:
        screen.warn(f"{flash_sentence(planned.flicker)}; a plan of it is refused without --accept-flashing")
    screen.document(
        {
            "sequence": list(names),
            "images": planned.images,
            "tracking": [asdict(record) for record in records],
            **planned.rates(),
        }
    )
    return 0 if records and all(record.sets for record in records) else 1


def handle_count(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage sequence count."""
    from lightstage.api.sequences import counts, draw_counts

    rows = counts(options.upto)
    screen.table(("tracking frames", "wilson", "minimal", "minimal, thesis"), rows, right=(0, 1, 2, 3))
    screen.say(
        "wilson 4n + 3, minimal 3n + 2; the thesis prints 3n + 3 for even n, which its own rules do not need"
    )
    if options.plot:
        draw_counts(rows, options.plot)
        screen.say(f"plot: {options.plot}")
    head = ("tracking", "wilson", "minimal", "minimal_thesis")
    screen.document(
        {
            "rows": [dict(zip(head, row, strict=True)) for row in rows],
            "plot": str(options.plot) if options.plot else None,
        }
    )
    return 0


def _bands(text: str) -> tuple[int, ...]:
    if not re.fullmatch(r"[0-9]{1,5}(,[0-9]{1,5})*", text):
        raise RequestError(f"--bands {text}: expected wavelengths in nm, such as 434,576")
    return tuple(int(band) for band in text.split(","))


def _accepted(text: str | None, planned: "Plan", screen: Screen) -> str | None:
    """The reason to be recorded; None when nothing flashes.

    Raises:
        RequestError: the sequence flashes and nobody took it upon themselves, or the text says nothing.
    """
    from lightstage.api.sequences import flash_sentence

    reason = None if text is None else " ".join(text.split())
    if reason is not None and (not reason or not reason.isprintable()):
        raise RequestError("--accept-flashing: say in plain text who decided, and why")
    if planned.flashes is None:
        screen.warn("without --exposure-ms there are no times, and whether it flashes was not judged")
        return reason
    if not planned.flashes:
        if reason:
            screen.warn("--accept-flashing was not needed: nothing changes between 3 and 30 Hz")
        return None
    if reason is None:
        raise RequestError(
            f"{flash_sentence(planned.flicker)}; change the timing, or say who decided to play it and why with "
            '--accept-flashing "..."'
        )
    return reason


def _say_sequence(screen: Screen, planned: "Plan") -> None:
    import textwrap

    for band in dict.fromkeys(exposure.band_nm for exposure in planned.exposures):
        lights = [exposure.illumination for exposure in planned.exposures if exposure.band_nm == band]
        screen.say(f"{band:g} nm: {' '.join(lights)}")
    if not planned.exposures:
        for line in textwrap.wrap(" ".join(planned.names), _LINE):
            screen.say(line)


def _say_counts(screen: Screen, planned: "Plan") -> None:
    from lightstage.api.sequences import seen

    families = ", ".join(
        f"{family} at {sum(any(name.startswith(family) for name in r.sets) for r in planned.tracking)}"
        for family in ("difference", "ratio", "minimal")
    )
    screen.say(f"{planned.images} images, {len(planned.tracking)} tracking frame(s); {families}")
    if planned.frame_rate_hz is None:
        return
    rate = planned.tracking_rate_hz
    frames = f", {rate:.2f} tracking frames a second" if rate else ""
    screen.say(f"{planned.frame_rate_hz:.2f} images a second{frames}")
    if planned.flashes is False:
        screen.say("no brightness changes between 3 and 30 Hz (a few people react to 1 to 65 Hz)")
    for view in [view for view in planned.flicker if view.flashes][:_SHOWN]:
        screen.say(
            f"flashes {seen(view.view)}: {100 * view.swing:.0f} % of the brightest, "
            f"strongest at {view.strongest_hz:.2f} Hz"
        )


def _sets(record: "TrackingFrame") -> str:
    minimal = [name.removeprefix("minimal ") for name in record.sets if name.startswith("minimal")]
    parts = [name for name in record.sets if not name.startswith("minimal")]
    if len(minimal) == _MINIMAL_SETS:
        parts.append("minimal (all twelve)")
    elif minimal:
        parts.append(f"minimal {'; '.join(minimal)}")
    return ", ".join(parts)


def _lacks(record: "TrackingFrame") -> str:
    parts = [
        f"{name}: {' '.join(record.missing[name])}" for name in ("difference", "ratio") if name in record.missing
    ]
    minimal = {name: images for name, images in record.missing.items() if name.startswith("minimal")}
    if len(minimal) == _MINIMAL_SETS:
        least = min(map(len, minimal.values()))
        nearest = dict.fromkeys(" ".join(images) for images in minimal.values() if len(images) == least)
        parts.append(f"minimal: {' or '.join(nearest)}")
    return ", ".join(parts)

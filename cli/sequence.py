"""sequence: which illumination comes when, what it can be used for, how fast it plays, and whether it flashes."""

import argparse
import contextlib
import json
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.cli.show import Screen
from lightstage.cli.values import number, whole
from lightstage.formats.whole_file import whole_file, write_whole
from lightstage.products.figures import pyplot
from lightstage.store.errors import RequestError

if TYPE_CHECKING:
    from lightstage.hw.pacing import Flicker, Timing
    from lightstage.hw.sequence import Exposure, TrackingFrame

_SHOWN = 3
"""Views of flicker that a person is told of; --json has all."""
_MOST = 1000
_PICTURES = (".png", ".svg", ".pdf")


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
        _add_timing(make)
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
    _add_timing(check)
    check.set_defaults(handler=handle_check)
    count = actions.add_parser("count", help="images needed against tracking frames")
    count.add_argument("--upto", type=whole, default=12, metavar="N", help="tracking frames (default: 12)")
    count.add_argument("--plot", type=Path, metavar="FILE.png", help="draw it as well")
    count.set_defaults(handler=handle_count)


def _add_timing(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--exposure-ms", type=number, metavar="MS", help="of one picture")
    parser.add_argument("--setup-ms", type=number, metavar="MS", help="to set up the lights (default: 0)")
    parser.add_argument("--readout-ms", type=number, metavar="MS", help="to read out the camera (default: 0)")
    parser.add_argument(
        "--overlap", action="store_true", help="the camera reads out while the next lights are set up"
    )
    parser.add_argument("--dark-pauses", action="store_true", help="the lights go off between exposures")


def handle_make(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage sequence static|multispectral|wilson|minimal."""
    from lightstage.hw import pacing, sequence

    with _rig_errors():
        names: Sequence[str] = sequence.static()
        exposures: Sequence[str | Exposure] = names
        cycle: Sequence[str | Exposure] = names
        if options.kind == "multispectral":
            exposures = cycle = sequence.multispectral(_bands(options.bands))
        elif options.kind == "wilson":
            names = exposures = sequence.wilson(options.tracking)
            cycle = sequence.cycle("wilson")
        elif options.kind == "minimal":
            names = exposures = sequence.minimal(options.tracking, sets=options.sets)
            cycle = sequence.cycle("minimal", sets=options.sets)
        timing = _timing(options)
        records = sequence.supported(names)
        found = () if timing is None else pacing.flicker(cycle, timing)
        starts = None if timing is None else pacing.starts_s(exposures, timing)
    if timing is None and options.kind in ("wilson", "minimal") and options.to:
        raise RequestError(
            "--to: a performance needs its times; give --exposure-ms, and the rig's --setup-ms and --readout-ms"
        )
    bands = [one for one in exposures if not isinstance(one, str)]
    document: dict[str, Any] = {
        "kind": options.kind,
        "sequence": list(names),
        "images": len(exposures),
        "tracking": len(records),
        **({"exposures": [one._asdict() for one in bands]} if bands else {}),
        **_rates(cycle, timing, found),
        "accepted": _accepted(options.accept_flashing, found, screen),
        "written": str(options.to) if options.to else None,
    }
    if options.to:
        _write(options.to, _plan_file(document, starts))
    _say_sequence(screen, names, bands)
    screen.say(f"{len(exposures)} images, {len(records)} tracking frame(s); {_families(records)}")
    _say_rates(screen, document, found)
    if document["accepted"]:
        screen.say(f"flashing accepted: {document['accepted']}")
    if options.to:
        screen.say(f"written: {options.to}")
    screen.document(document)
    return 0


def handle_check(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage sequence check."""
    from lightstage.hw import sequence

    with _rig_errors():
        names, rate = _read(options.sequence)
        timing = _timing(options, rate)
        records = sequence.supported(names)
        cycle = names[: sequence.period(names)]
    found = _flicker_or_note(cycle, timing, screen)
    document = {
        "sequence": list(names),
        "images": len(names),
        "tracking": [asdict(record) for record in records],
        **_rates(cycle, timing, found),
    }
    if not records:
        screen.say("no tracking frame: there is no C in it, so no normals can be made at a time of its own")
    else:
        rows = [
            (
                record.frame,
                " ".join((*record.before, "C", *record.after)),
                _sets(record) or "nothing",
                _lacks(record),
            )
            for record in records
        ]
        screen.table(("frame", "window", "supports", "missing"), rows, right=(0,))
    screen.say(f"{len(names)} images, {len(records)} tracking frame(s); {_families(records)}")
    _say_rates(screen, document, found)
    if any(one.flashes for one in found):
        screen.warn(f"{_flash_sentence(found)}; a plan of it is refused without --accept-flashing")
    screen.document(document)
    return 0 if records and all(record.sets for record in records) else 1


def handle_count(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage sequence count."""
    from lightstage.hw.sequence import minimal, wilson

    if not 1 <= options.upto <= _MOST:
        raise RequestError(f"--upto {options.upto}: a number of tracking frames from 1 to {_MOST} is needed")
    rows = [(n, len(wilson(n)), len(minimal(n)), _thesis_count(n)) for n in range(1, options.upto + 1)]
    screen.table(("tracking frames", "wilson", "minimal", "minimal, thesis"), rows, right=(0, 1, 2, 3))
    screen.say(
        "wilson 4n + 3, minimal 3n + 2; the thesis prints 3n + 3 for even n, which its own rules do not need"
    )
    if options.plot:
        _draw_counts(rows, options.plot)
        screen.say(f"plot: {options.plot}")
    head = ("tracking", "wilson", "minimal", "minimal_thesis")
    screen.document(
        {
            "rows": [dict(zip(head, row, strict=True)) for row in rows],
            "plot": str(options.plot) if options.plot else None,
        }
    )
    return 0


@contextlib.contextmanager
def _rig_errors() -> Iterator[None]:
    from lightstage.hw.errors import RigError

    try:
        yield
    except RigError as error:
        raise RequestError(str(error)) from None


def _bands(text: str) -> tuple[int, ...]:
    if not re.fullmatch(r"[0-9]{1,5}(,[0-9]{1,5})*", text):
        raise RequestError(f"--bands {text}: expected wavelengths in nm, such as 434,576")
    return tuple(int(band) for band in text.split(","))


def _timing(options: argparse.Namespace, rate_hz: float | None = None) -> "Timing | None":
    """From the options; else, when a capture says its frame rate, from that; else none."""
    from lightstage.hw.pacing import Timing

    wheel = getattr(options, "wheel_ms", None)
    given = {"--setup-ms": options.setup_ms, "--readout-ms": options.readout_ms, "--wheel-ms": wheel}
    if options.exposure_ms is None:
        stray = [name for name, value in given.items() if value is not None]
        stray += [name for name in ("overlap", "dark_pauses") if getattr(options, name)]
        if stray:
            name = stray[0] if stray[0].startswith("--") else f"--{stray[0].replace('_', '-')}"
            raise RequestError(f"{name} stands alone; --exposure-ms is needed for times")
        return None if rate_hz is None else Timing(exposure_ms=1000 / rate_hz)
    return Timing(
        exposure_ms=options.exposure_ms,
        setup_ms=options.setup_ms or 0.0,
        readout_ms=options.readout_ms or 0.0,
        wheel_ms=wheel or 0.0,
        overlap=options.overlap,
        dark_pauses=options.dark_pauses,
    )


def _flicker_or_note(cycle: Sequence[str], timing: "Timing | None", screen: Screen) -> "tuple[Flicker, ...]":
    """A capture of another rig may name lights that this one has not."""
    from lightstage.hw.errors import RigError
    from lightstage.hw.pacing import flicker

    try:
        return () if timing is None else flicker(cycle, timing)
    except RigError as error:
        screen.warn(f"whether it flashes was not judged: {error}")
        return ()


def _rates(
    cycle: "Sequence[str | Exposure]", timing: "Timing | None", found: "Sequence[Flicker]"
) -> dict[str, Any]:
    from lightstage.hw.pacing import tracking_rate_hz

    frame_rate = tracking_rate = None
    if timing is not None:
        frame_rate = round(timing.frame_rate_hz, 6)
        illuminations = [one for one in cycle if isinstance(one, str)]
        # while the wheel turns no picture is taken, so a multispectral set has no one rate
        tracking_rate = round(tracking_rate_hz(illuminations, timing), 6) if illuminations else None
    return {
        "timing": None if timing is None else asdict(timing),
        "frame_rate_hz": frame_rate,
        "tracking_rate_hz": tracking_rate,
        "flicker": [asdict(one) for one in found] or None,
        "flashes": any(one.flashes for one in found) if found else None,
    }


def _accepted(text: str | None, found: "Sequence[Flicker]", screen: Screen) -> str | None:
    """The reason to be recorded; None when nothing flashes.

    Raises:
        RequestError: the sequence flashes and nobody took it upon themselves, or the text says nothing.
    """
    reason = None if text is None else " ".join(text.split())
    if reason is not None and (not reason or not reason.isprintable()):
        raise RequestError("--accept-flashing: say in plain text who decided, and why")
    if not found:
        screen.warn("without --exposure-ms there are no times, and whether it flashes was not judged")
        return reason
    if not any(one.flashes for one in found):
        if reason:
            screen.warn("--accept-flashing was not needed: nothing changes between 3 and 30 Hz")
        return None
    if reason is None:
        raise RequestError(
            f"{_flash_sentence(found)}; change the timing, or say who decided to play it and why with "
            '--accept-flashing "..."'
        )
    return reason


def _flash_sentence(found: "Sequence[Flicker]") -> str:
    worst = found[0]
    return (
        "the light of this sequence flashes within 3 to 30 Hz, which can trigger seizures in people with "
        f"photosensitive epilepsy: most at {worst.strongest_hz:.2f} Hz, {100 * worst.swing:.0f} % of the brightest "
        f"picture seen {_seen(worst.view)}"
    )


def _seen(view: str) -> str:
    return {
        "total": "as total light",
        "front": "facing the camera",
        "back": "facing away from the camera",
    }.get(view, f"facing {view}")


def _say_sequence(screen: Screen, names: Sequence[str], bands: "Sequence[Exposure]") -> None:
    import textwrap

    for band in dict.fromkeys(one.band_nm for one in bands):
        screen.say(f"{band:g} nm: {' '.join(one.illumination for one in bands if one.band_nm == band)}")
    if not bands:
        for line in textwrap.wrap(" ".join(names), 110):
            screen.say(line)


def _say_rates(screen: Screen, document: dict[str, Any], found: "Sequence[Flicker]") -> None:
    if document["frame_rate_hz"] is None:
        return
    line = f"{document['frame_rate_hz']:.2f} images a second"
    if document["tracking_rate_hz"]:
        line += f", {document['tracking_rate_hz']:.2f} tracking frames a second"
    screen.say(line)
    if document["flashes"] is False:
        screen.say("no brightness changes between 3 and 30 Hz (a few people react to 1 to 65 Hz)")
    for one in [one for one in found if one.flashes][:_SHOWN]:
        screen.say(
            f"flashes {_seen(one.view)}: {100 * one.swing:.0f} % of the brightest, "
            f"strongest at {one.strongest_hz:.2f} Hz"
        )


def _families(records: "Sequence[TrackingFrame]") -> str:
    """How many tracking frames each method works at."""
    return ", ".join(
        f"{family} at {sum(any(name.startswith(family) for name in r.sets) for r in records)}"
        for family in ("difference", "ratio", "minimal")
    )


def _sets(record: "TrackingFrame") -> str:
    minimal = [name.removeprefix("minimal ") for name in record.sets if name.startswith("minimal")]
    parts = [name for name in record.sets if not name.startswith("minimal")]
    if len(minimal) == 12:
        parts.append("minimal (all twelve)")
    elif minimal:
        parts.append(f"minimal {'; '.join(minimal)}")
    return ", ".join(parts)


def _lacks(record: "TrackingFrame") -> str:
    parts = [
        f"{name}: {' '.join(record.missing[name])}" for name in ("difference", "ratio") if name in record.missing
    ]
    minimal = {name: images for name, images in record.missing.items() if name.startswith("minimal")}
    if len(minimal) == 12:
        least = min(map(len, minimal.values()))
        nearest = dict.fromkeys(" ".join(images) for images in minimal.values() if len(images) == least)
        parts.append(f"minimal: {' or '.join(nearest)}")
    return ", ".join(parts)


def _read(words: Sequence[str]) -> tuple[tuple[str, ...], float | None]:
    """The illuminations in words or in a file, and the file's frame rate."""
    from lightstage.hw.sequence import parse
    from lightstage.store import document
    from lightstage.store.capture import Frame

    path = Path(os.path.expanduser(words[0]))
    if len(words) > 1 or not os.path.exists(path) or re.fullmatch(r"C|[XYZ]c?|L[0-9]{1,6}|T[0-3]|O", words[0]):
        if len(words) == 1 and ("/" in words[0] or words[0].endswith((".yaml", ".yml"))):
            raise RequestError(f"{path} is missing: expected a sequence, a capture.yaml or a capture folder")
        return parse(" ".join(words)), None
    file = path / "capture.yaml" if path.is_dir() else path
    source = document.load(file, what="the description of a capture")
    frames = source.value.get("frames") if isinstance(source.value, dict) else None
    if not isinstance(frames, tuple) or not frames:
        raise RequestError(f"{source.at(('frames',))}: expected a list of frames, such as [{{illumination: C}}]")
    checked = [document.check(source, Frame, where=("frames", i)) for i in range(len(frames))]
    rate = source.value.get("frame_rate_hz")
    if rate is not None and (isinstance(rate, bool) or not isinstance(rate, int | float) or not rate > 0):
        raise RequestError(f"{source.at(('frame_rate_hz',))}: frame_rate_hz: expected a number above 0, or null")
    return tuple(frame.illumination for frame in checked), rate


def _plan_file(document: dict[str, Any], starts: Sequence[float] | None) -> str:
    """A part of capture.yaml, with the plan in comments above it, because a capture has no key for a plan."""
    from lightstage.store.document import text_of

    exposures = document.get("exposures", [])
    names = document["sequence"]
    # a frame is all bands under one illumination, so with a filter wheel it has no single time
    times = [None] * len(names) if starts is None or exposures else starts
    part: dict[str, Any] = {"frame_rate_hz": None if exposures else document["frame_rate_hz"]}
    if exposures:
        part["bands_nm"] = list(dict.fromkeys(one["band_nm"] for one in exposures))
    part["frames"] = [
        {"illumination": name, **({} if time is None else {"time_s": round(time, 6)})}
        for name, time in zip(names, times, strict=True)
    ]
    comments = [
        f"planned by `lightstage sequence {document['kind']}`: a part of capture.yaml",
        f"images: {document['images']}",
        f"tracking frames: {document['tracking']}",
    ]
    if document["timing"] is None:
        comments.append("times: not planned; whether it flashes was not judged")
    else:
        comments += [f"{name}: {value}" for name, value in document["timing"].items()]
        comments.append(f"tracking_rate_hz: {document['tracking_rate_hz']}")
        worst = document["flicker"][0]
        comments.append(
            f"flashes within 3 to 30 Hz: most {_seen(worst['view'])}, {100 * worst['swing']:.1f} % of the "
            f"brightest picture, strongest at {worst['strongest_hz']:.3f} Hz"
            if document["flashes"]
            else "flashes within 3 to 30 Hz: no"
        )
    if document["accepted"]:
        comments.append(f"flashing accepted: {json.dumps(document['accepted'], ensure_ascii=False)}")
    if exposures:
        comments.append("order of the exposures, all of one filter before the wheel turns:")
    for i, one in enumerate(exposures):
        when = "" if starts is None else f" at {starts[i]:.6f} s"
        comments.append(f"  {one['band_nm']:g} nm {one['illumination']}{when}")
    return "".join(f"# {line}\n" for line in comments) + text_of(part)


def _write(path: Path, text: str) -> None:
    if path.exists():
        if path.is_file() and path.read_bytes() == text.encode():
            return
        raise RequestError(f"{path} is there already and holds something else; remove it, or name another file")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, text.encode())


def _thesis_count(n: int) -> int:
    """Table "Image capture requirements" of Dutta (2010)."""
    return 6 * (n // 2 + 1) - 1 if n % 2 else 3 * n + 3


def _draw_counts(rows: Sequence[tuple[int, int, int, int]], path: Path) -> None:
    if path.suffix.lower() not in _PICTURES:
        raise RequestError(f"--plot {path}: expected a file that ends in {', '.join(_PICTURES)}")
    plt = pyplot()

    n, wilson, minimal, thesis = zip(*rows, strict=True)
    figure, axis = plt.subplots(figsize=(6.4, 4), layout="constrained")
    axis.plot(n, wilson, "o-", markersize=3, label="Wilson, 4n + 3")
    axis.plot(n, minimal, "o-", markersize=3, label="minimal, 3n + 2")
    odd = [(a, c) for a, b, c in zip(n, minimal, thesis, strict=True) if b != c]
    if odd:
        axis.plot(*zip(*odd, strict=True), "x", color="0.4", label="the thesis where it differs, 3n + 3")
    axis.set_xlabel("tracking frames n")
    axis.set_ylabel("images")
    axis.set_xlim(0)
    axis.set_ylim(0)
    axis.grid(alpha=0.3)
    axis.legend(frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with whole_file(path) as beside:
            figure.savefig(beside, dpi=110)
    finally:
        plt.close(figure)

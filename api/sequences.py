"""Capture sequences: planned, read, judged, and written as the part of a capture.yaml."""

import contextlib
import json
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from lightstage.api.refusals import refusals
from lightstage.formats.whole_file import write_new
from lightstage.hw import pacing, planning, sequence
from lightstage.hw.errors import RigError
from lightstage.hw.pacing import Flicker as Flicker
from lightstage.hw.pacing import Timing as Timing
from lightstage.hw.planning import PERFORMANCES as PERFORMANCES
from lightstage.hw.planning import Plan as Plan
from lightstage.hw.planning import thesis_count
from lightstage.hw.sequence import TrackingFrame as TrackingFrame
from lightstage.store.errors import RequestError

MOST_TRACKING = 1000


def plan(kind: str, **options: Any) -> Plan:
    """A plan; see `hw.planning.plan`.

    Raises:
        RequestError: the rig cannot show it.
    """
    with _rig_errors():
        return planning.plan(kind, **options)


def judge(names: Sequence[str], timing: Timing | None) -> tuple[Plan, str | None]:
    """A sequence that somebody else made, and why it was not judged whether it flashes, if it was not.

    Raises:
        RequestError: it holds what is no illumination.
    """
    with _rig_errors():
        tracking = sequence.supported(names)
        cycle = tuple(names[: sequence.period(names)])
    views: tuple[Flicker, ...] = ()
    why = None
    if timing is not None:
        try:
            views = pacing.flicker(cycle, timing)
        except RigError as error:  # a capture of another rig may name lights that this one has not
            why = str(error)
    return Plan("", tuple(names), (), cycle, tracking, timing, views, None), why


def read_sequence(words: Sequence[str]) -> tuple[tuple[str, ...], float | None]:
    """The illuminations in words, or in a capture.yaml or the folder of one, and the file's frame rate.

    Raises:
        RequestError: there are none.
    """
    from lightstage.store import document
    from lightstage.store.capture import Frame

    path = Path(os.path.expanduser(words[0]))
    if len(words) > 1 or not os.path.exists(path) or re.fullmatch(r"C|[XYZ]c?|L[0-9]{1,6}|T[0-3]|O", words[0]):
        if len(words) == 1 and ("/" in words[0] or words[0].endswith((".yaml", ".yml"))):
            raise RequestError(f"{path} is missing: expected a sequence, a capture.yaml or a capture folder")
        with _rig_errors():
            return sequence.parse(" ".join(words)), None
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


def counts(upto: int) -> list[tuple[int, int, int, int]]:
    """Images against tracking frames: these, and those of Wilson's, of the minimal sequence, of the thesis' table.

    Raises:
        RequestError: the number of tracking frames is none.
    """
    if not 1 <= upto <= MOST_TRACKING:
        raise RequestError(f"--upto {upto}: a number of tracking frames from 1 to {MOST_TRACKING} is needed")
    return [(n, len(sequence.wilson(n)), len(sequence.minimal(n)), thesis_count(n)) for n in range(1, upto + 1)]


def draw_counts(rows: Sequence[tuple[int, int, int, int]], path: Path) -> None:
    """Draw what `counts` gave."""
    from lightstage.products.sequence_counts import PICTURES, draw

    if path.suffix.lower() not in PICTURES:
        raise RequestError(f"--plot {path}: expected a file that ends in {', '.join(PICTURES)}")
    draw(rows, path)


def timing(**milliseconds: Any) -> Timing:
    """The times of a rig; see `hw.pacing.Timing`.

    Raises:
        RequestError: they cannot be.
    """
    with _rig_errors():
        return Timing(**milliseconds)


def flash_sentence(views: Sequence[Flicker]) -> str:
    """How dangerous the strongest of these is."""
    worst = views[0]
    return (
        "the light of this sequence flashes within 3 to 30 Hz, which can trigger seizures in people with "
        f"photosensitive epilepsy: most at {worst.strongest_hz:.2f} Hz, {100 * worst.swing:.0f} % of the brightest "
        f"picture seen {seen(worst.view)}"
    )


def seen(view: str) -> str:
    """In which direction."""
    return {
        "total": "as total light",
        "front": "facing the camera",
        "back": "facing away from the camera",
    }.get(view, f"facing {view}")


def write_plan(path: Path, planned: Plan, accepted: str | None) -> None:
    """Write a part of a capture.yaml, with the plan in comments above it: a capture has no key for a plan.

    Args:
        accepted: who decided to play it although it flashes, and why.

    Raises:
        RequestError: another file is there.
    """
    with refusals():
        write_new(path, _plan_text(planned, accepted).encode())


def _plan_text(planned: Plan, accepted: str | None) -> str:
    from lightstage.store.document import text_of

    exposures, starts = planned.exposures, planned.starts_s
    # a frame is all bands under one illumination, so with a filter wheel it has no single time
    times = [None] * len(planned.names) if starts is None or exposures else list(starts)
    part: dict[str, Any] = {"frame_rate_hz": None if exposures else planned.frame_rate_hz}
    if exposures:
        part["bands_nm"] = list(dict.fromkeys(exposure.band_nm for exposure in exposures))
    part["frames"] = [
        {"illumination": name, **({} if time is None else {"time_s": round(time, 6)})}
        for name, time in zip(planned.names, times, strict=True)
    ]
    comments = [
        f"planned by `lightstage sequence {planned.kind}`: a part of capture.yaml",
        f"images: {planned.images}",
        f"tracking frames: {len(planned.tracking)}",
        *_times(planned),
    ]
    if accepted:
        comments.append(f"flashing accepted: {json.dumps(accepted, ensure_ascii=False)}")
    if exposures:
        comments.append("order of the exposures, all of one filter before the wheel turns:")
    for i, exposure in enumerate(exposures):
        when = "" if starts is None else f" at {starts[i]:.6f} s"
        comments.append(f"  {exposure.band_nm:g} nm {exposure.illumination}{when}")
    return "".join(f"# {line}\n" for line in comments) + text_of(part)


def _times(planned: Plan) -> list[str]:
    rates = planned.rates()
    if rates["timing"] is None:
        return ["times: not planned; whether it flashes was not judged"]
    worst = planned.flicker[0]
    return [
        *(f"{name}: {value}" for name, value in rates["timing"].items()),
        f"tracking_rate_hz: {planned.tracking_rate_hz}",
        f"flashes within 3 to 30 Hz: most {seen(worst.view)}, {100 * worst.swing:.1f} % of the "
        f"brightest picture, strongest at {worst.strongest_hz:.3f} Hz"
        if planned.flashes
        else "flashes within 3 to 30 Hz: no",
    ]


@contextlib.contextmanager
def _rig_errors() -> Iterator[None]:
    try:
        yield
    except RigError as error:
        raise RequestError(str(error)) from None

"""A plan: what is shown and when, what its tracking frames support, and whether it flashes."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from lightstage.hw import pacing, sequence
from lightstage.hw.pacing import Flicker, Timing
from lightstage.hw.sequence import Exposure, Sets, TrackingFrame

KINDS = ("static", "multispectral", "wilson", "minimal")
PERFORMANCES = ("wilson", "minimal")


@dataclass(frozen=True)
class Plan:
    """A sequence with its times, if they are known."""

    kind: str
    """One of KINDS; empty for a sequence that somebody else made."""
    names: tuple[str, ...]
    """The illuminations in order."""
    exposures: tuple[Exposure, ...]
    """With a filter wheel, the exposures in order; empty without."""
    cycle: tuple[str | Exposure, ...]
    """What repeats."""
    tracking: tuple[TrackingFrame, ...]
    timing: Timing | None
    flicker: tuple[Flicker, ...]
    """The strongest first; empty where it was not judged."""
    starts_s: tuple[float, ...] | None
    """Of the exposures, or of the illuminations where there is no wheel."""

    @property
    def images(self) -> int:
        """How many pictures it takes."""
        return len(self.exposures or self.names)

    @property
    def frame_rate_hz(self) -> float | None:
        """Pictures a second."""
        return None if self.timing is None else round(self.timing.frame_rate_hz, 6)

    @property
    def tracking_rate_hz(self) -> float | None:
        """Tracking frames a second; while a wheel turns no picture is taken, so a multispectral set has none."""
        illuminations = [step for step in self.cycle if isinstance(step, str)]
        if self.timing is None or not illuminations:
            return None
        return round(pacing.tracking_rate_hz(illuminations, self.timing), 6)

    @property
    def flashes(self) -> bool | None:
        """Whether its light flashes within 3 to 30 Hz; None: not judged."""
        return any(view.flashes for view in self.flicker) if self.flicker else None

    def rates(self) -> dict[str, Any]:
        """Its times as plain data."""
        return {
            "timing": None if self.timing is None else asdict(self.timing),
            "frame_rate_hz": self.frame_rate_hz,
            "tracking_rate_hz": self.tracking_rate_hz,
            "flicker": [asdict(view) for view in self.flicker] or None,
            "flashes": self.flashes,
        }


def plan(
    kind: str,
    *,
    tracking: int = 12,
    sets: Sets = "pure",
    bands_nm: Sequence[float] = (),
    timing: Timing | None = None,
) -> Plan:
    """A plan of one of KINDS.

    Args:
        tracking: tracking frames of a performance.
        sets: of the minimal sequence.
        bands_nm: of the multispectral set, in the order of the wheel.

    Raises:
        RigError: the rig cannot show it, or not at these times.
    """
    names: tuple[str, ...] = sequence.static()
    exposures: tuple[Exposure, ...] = ()
    cycle: tuple[str | Exposure, ...] = names
    if kind == "multispectral":
        cycle = exposures = sequence.multispectral(bands_nm)
    elif kind == "wilson":
        names, cycle = sequence.wilson(tracking), sequence.cycle("wilson")
    elif kind == "minimal":
        names, cycle = sequence.minimal(tracking, sets=sets), sequence.cycle("minimal", sets=sets)
    return Plan(
        kind,
        names,
        exposures,
        cycle,
        sequence.supported(names),
        timing,
        () if timing is None else pacing.flicker(cycle, timing),
        None if timing is None else pacing.starts_s(exposures or names, timing),
    )


def thesis_count(tracking: int) -> int:
    """Images of the minimal sequence by the table "Image capture requirements" of Dutta (2010)."""
    return 6 * (tracking // 2 + 1) - 1 if tracking % 2 else 3 * tracking + 3

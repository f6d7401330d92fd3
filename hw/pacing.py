"""How fast a sequence can be played, and whether people in the stage see it flash.

One picture takes set-up of the lights + exposure + read-out of the camera; with a camera that reads out while the
next lights are set up, exposure + the longer of the two.

    frame rate = 1 / period,      tracking rate = frame rate * (C in the cycle) / (pictures in the cycle)

**Flashing light of 3 to 30 Hz can trigger seizures in people with photosensitive epilepsy** (Harding & Jeavons
1994, "Photosensitive Epilepsy"; Fisher et al. 2005, Epilepsia 46(9), 1426-1441, who call 15 to 25 Hz the worst and
say that reactions to anything from 1 to 65 Hz are known; Harding et al. 2005, Epilepsia 46(9), 1423-1425: a hazard
from 3 Hz up). Many do not know that they have it. What flashes in a light stage is not only a lamp that goes out:

- constant light is twice as bright as a gradient, so every tracking frame is a flash in *total* light;
- somebody who looks into the camera sees the front lights: of Z about 5/6, of Zc 1/6, however equal their totals
  are (the integral of (1 + z) / 2 * z over the half sphere against that of z);
- X and Xc have the same total, but light each side in turn.

So brightness is computed as total light, and as irradiance of a plane that faces each of six ways; f(t) is constant
from picture to picture (or dark between them, when the lights go off), repeats with the cycle T, and

    c_k = 1/T * integral f(t) exp(-2 pi i k t / T) dt

is exact. Lines above half the frame rate (above the frame rate when the lights go off) are only the sharpness of
the steps and do not count. What is left between 3 and 30 Hz is added up again in time, and its swing, highest less
lowest, is held against the brightest picture. From MIN_SWING up the sequence flashes. WCAG 2.2 counts opposing
changes of 10 % in a screen's luminance; a stage fills the field of view, so the limit here is a tenth of that.

This is arithmetic, not a medical device: no result of it makes a sequence safe for a certain person. The drive
levels' own pulse width modulation is not in it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lightstage.hw.errors import RigError
from lightstage.hw.geodesic import light_positions
from lightstage.hw.gradients import weights
from lightstage.hw.sequence import Exposure

LOWEST_HZ = 3.0
HIGHEST_HZ = 30.0
MIN_SWING = 0.01
SHORTEST_MS, LONGEST_MS = 0.001, 1e6
VIEWS = ("total", "front", "back", "left", "right", "up", "down")
"""Total light, and the irradiance of a plane that faces the camera (front), away from it, and so on; left and right
as in the camera's picture."""
_FACING = {
    "front": (0, 0, 1),
    "back": (0, 0, -1),
    "left": (-1, 0, 0),
    "right": (1, 0, 0),
    "up": (0, 1, 0),
    "down": (0, -1, 0),
}
_FINEST = 1 << 13
"""Lines of one cycle: 30 Hz over four and a half minutes."""
Array = NDArray[np.float64]
Segment = tuple[str, float]
"""An illumination, and for how many seconds it is shown."""


@dataclass(frozen=True)
class Timing:
    """What one picture needs, in milliseconds."""

    exposure_ms: float
    setup_ms: float = 0.0
    readout_ms: float = 0.0
    wheel_ms: float = 0.0
    """For one turn of the filter wheel."""
    overlap: bool = False
    """The camera reads out while the next lights are set up."""
    dark_pauses: bool = False
    """The lights are off but for the exposure; otherwise each illumination stays until the next one is set up."""

    def __post_init__(self) -> None:
        for name in ("exposure_ms", "setup_ms", "readout_ms", "wheel_ms"):
            value = getattr(self, name)
            least = SHORTEST_MS if name == "exposure_ms" else 0.0
            if not least <= value <= LONGEST_MS:  # also for NaN
                raise RigError(
                    f"{name} {value:g}: a number of milliseconds, {least:g} or more and up to {LONGEST_MS:g}, "
                    "is needed"
                )

    @property
    def period_s(self) -> float:
        """From one picture to the next."""
        pause = max(self.setup_ms, self.readout_ms) if self.overlap else self.setup_ms + self.readout_ms
        return (self.exposure_ms + pause) / 1000

    @property
    def frame_rate_hz(self) -> float:
        """Pictures a second while the wheel stands still."""
        return 1 / self.period_s


@dataclass(frozen=True)
class Flicker:
    """How brightness changes between 3 and 30 Hz, seen one way."""

    view: str
    """One of VIEWS."""
    swing: float
    """Highest less lowest of the part between 3 and 30 Hz, of the brightest picture; more than 1 is possible."""
    strongest_hz: float
    """The frequency of its strongest line."""
    lines: tuple[tuple[float, float], ...]
    """(Hz, swing) of every line from MIN_SWING up, rising."""

    @property
    def flashes(self) -> bool:
        """Whether it counts."""
        return self.swing >= MIN_SWING


def tracking_rate_hz(cycle: Sequence[str], timing: Timing) -> float:
    """Tracking frames a second of a sequence that repeats."""
    return timing.frame_rate_hz * list(cycle).count("C") / len(cycle)


def starts_s(exposures: Sequence[str | Exposure], timing: Timing) -> tuple[float, ...]:
    """When each picture begins, in seconds from the first; the wheel turns between pictures of two bands."""
    out = [0.0]
    for before, after in pairwise(exposures):
        out.append(out[-1] + timing.period_s + (timing.wheel_ms / 1000 if _turns(before, after) else 0))
    return tuple(out)


def flicker(cycle: Sequence[str | Exposure], timing: Timing, *, lights: Array | None = None) -> tuple[Flicker, ...]:
    """How the light of a cycle that repeats changes between 3 and 30 Hz, one record per view, the strongest first.

    Args:
        cycle: illuminations, or exposures of a multispectral set (the wheel also turns back to the first).
        timing: of one picture.
        lights: (light, xyz), unit; None for the 41 of the thesis' stage.

    Raises:
        RigError: an illumination is not known, or the cycle is too long to be analysed.
    """
    places = light_positions(2) if lights is None else lights
    segments = _segments(cycle, timing)
    rate = timing.frame_rate_hz
    limit = min(HIGHEST_HZ, rate if timing.dark_pauses else rate / 2)
    views = [_band(view, _seen(segments, view, places), segments, limit) for view in VIEWS]
    return tuple(sorted(views, key=lambda seen: -seen.swing))


def _segments(cycle: Sequence[str | Exposure], timing: Timing) -> list[Segment]:
    """What is shown for how long, once round."""
    out: list[Segment] = []
    pause = timing.period_s - timing.exposure_ms / 1000
    for current, following in zip(cycle, [*cycle[1:], cycle[0]], strict=True):
        name = current.illumination if isinstance(current, Exposure) else current
        wheel = timing.wheel_ms / 1000 if _turns(current, following) else 0.0
        if timing.dark_pauses:
            out += [(name, timing.exposure_ms / 1000), ("O", pause + wheel)]
        else:
            out.append((name, timing.period_s + wheel))
    return [segment for segment in out if segment[1] > 0]


def _turns(before: str | Exposure, after: str | Exposure) -> bool:
    return isinstance(before, Exposure) and isinstance(after, Exposure) and before.band_nm != after.band_nm


def _seen(segments: Sequence[Segment], view: str, lights: Array) -> Array:
    """Brightness (segment,), 1 for the brightest."""
    gain = np.ones(len(lights)) if view == "total" else np.maximum(0, lights @ np.array(_FACING[view], float))
    brightness = {name: float(weights(name, lights) @ gain) for name in {name for name, _ in segments}}
    values = np.array([brightness[name] for name, _ in segments])
    return np.asarray(values / max(values.max(), 1e-30))


def _band(view: str, values: Array, segments: Sequence[Segment], limit: float) -> Flicker:
    edges = np.concatenate([[0.0], np.cumsum([seconds for _, seconds in segments])])
    whole = edges[-1]
    # a hair wider, so that 60 / 2 or 1 / 0.333 is not lost to rounding
    first, last = math.ceil(LOWEST_HZ * whole * (1 - 1e-9)), math.floor(limit * whole * (1 + 1e-9))
    if last > _FINEST:
        raise RigError(f"a cycle of {whole:.0f} s is too long to be analysed; give the part that repeats")
    k = np.arange(max(first, 1), last + 1)
    if not k.size:
        return Flicker(view, 0.0, 0.0, ())
    # the integral of a step function, by parts: only its steps count
    steps = values - np.roll(values, 1)
    turns = edges[:-1] / whole
    c = np.array([np.sum(steps * np.exp(-2j * np.pi * n * turns)) / (2j * np.pi * n) for n in k])
    samples = 16 * int(k[-1])
    spectrum = np.zeros(samples // 2 + 1, complex)
    spectrum[k] = c
    wave = np.fft.irfft(spectrum, samples) * samples
    swings = 4 * np.abs(c)
    lines = tuple(
        (float(n / whole), float(swing)) for n, swing in zip(k, swings, strict=True) if swing >= MIN_SWING
    )
    return Flicker(view, float(np.ptp(wave)), float(k[np.argmax(swings)] / whole), lines)

"""How a camera answers to even light: the kernel of `stages/calibration/flat.py`.

Means, hot and dead pixels are in `defects.py`, gain and linearity in `sensor_response.py`.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.defects import Moments, find_dead, find_hot, interpolate, moments
from lightstage.kernels.targets.item_pictures import SCALE, counts_of, listed, stored
from lightstage.kernels.targets.labels import FLAT_NUMBERS
from lightstage.kernels.targets.sensor_response import fit_linearity, photon_transfer
from lightstage.kernels.targets.verdicts import Verdict

_FULL = 0.95
"""A flat reaches at most this part of the range at its brightest 99.9 %."""
_LINE = 3
"""Exposures that tell a line from a curve."""


def flat(
    lit: Mapping[tuple[float, int], NDArray[np.uint16]],
    unlit: Mapping[int, NDArray[np.uint16]],
    *,
    white_level: int,
    dark_picture: NDArray[np.float64] | None,
) -> Mapping[str, Any]:
    """The flat of one camera.

    Args:
        lit: (y, x) counts by exposure (seconds; 0 where the capture does not say) and frame.
        unlit: the same without light, by frame.
        white_level: the count at which the sensor saturates.
        dark_picture: (y, x), counts; None: from the frames without light, if there are.

    Returns:
        `mean` (y, x) counts, dark included, dead pixels filled in; `dead` (y, x); `numbers` in the order of
        FLAT_NUMBERS, NaN where not told.

    Raises:
        KernelError: saturated, or no light.
    """
    times = list(dict.fromkeys(time for time, _ in lit))
    levels = {
        time: moments((lit[name] for name in lit if name[0] == time), white_level=white_level) for time in times
    }
    usable = {t: level for t, level in levels.items() if np.quantile(level.mean, 0.999) < _FULL * white_level}
    if not usable:
        raise KernelError("the flat is saturated; expose it to about two thirds of the range")
    chosen = usable[max(usable, key=lambda t: float(np.median(usable[t].mean)))]
    frames = moments(unlit.values(), white_level=white_level) if unlit else None
    ground = dark_picture if dark_picture is not None else None if frames is None else frames.mean
    mean = chosen.mean
    dead = np.zeros(mean.shape, np.bool_)
    gain = gain_sd = read = np.nan
    if ground is not None:
        hot, _ = find_hot(ground, white_level=white_level)
        dead, _ = find_dead(mean, ground, bad=hot)
        mean = ground + interpolate(mean - ground, dead)
        if frames is not None and frames.frames > 1 and chosen.frames > 1:
            transfer = photon_transfer(frames, [m for m in usable.values() if m.frames > 1], bad=hot | dead)
            gain, gain_sd = transfer.electrons_per_count, transfer.electrons_per_count_sd
            read = transfer.read_noise_electrons
    worst, offset = _linearity(levels, white_level)
    return {
        "mean": mean.astype(np.float32),
        "dead": dead,
        "numbers": np.array([gain, gain_sd, read, worst, offset, chosen.frames, ground is not None], np.float64),
    }


def _linearity(levels: Mapping[float, Moments], white_level: int) -> tuple[float, float]:
    """Worst deviation in percent, and offset in counts; NaN where too few exposures are known."""
    times = sorted(time for time in levels if time)
    if len(times) < _LINE:
        return np.nan, np.nan
    line = fit_linearity(np.array(times), np.stack([levels[t].mean for t in times]), white_level=white_level)
    return line.deviation_percent, line.offset_counts


def prepare(*, white_level: int, dark: Mapping[str, Any] | None) -> Mapping[str, Any]:
    """The context in numbers."""
    return {"white_level": white_level, "dark_picture": counts_of(dark)}


def item(*, arrays: Mapping[str, Any], labels: Mapping[str, Any], facts: Mapping[str, Any]) -> Mapping[str, Any]:
    """The flat item."""
    names = [facts["cameras"][polarisation] for polarisation in labels["polarisation"]]
    return {
        "item": "flat",
        "images": {name: stored(mean) for name, mean in zip(names, arrays["mean"], strict=True)},
        "scale": SCALE,
        "dark_included": True,
        "dead_px": {name: listed(dead) for name, dead in zip(names, arrays["dead"], strict=True)},
    }


def verdict(*, arrays: Mapping[str, Any], labels: Mapping[str, Any], facts: Mapping[str, Any]) -> Verdict:
    """What the flat tells of each camera."""
    findings: Verdict = []
    for i, polarisation in enumerate(labels["polarisation"]):
        figure = dict(zip(FLAT_NUMBERS, arrays["numbers"][i], strict=True))
        words = [f"flat {float(np.median(arrays['mean'][i])):.0f} counts from {figure['frames']:.0f} frames"]
        if figure["dark_known"]:
            words.append(f"{int(arrays['dead'][i].sum())} dead pixels, filled in")
        else:
            words.append("no dark is known, so dead pixels cannot be told: bind a dark item, or add frames under O")
        if np.isfinite(figure["electrons_per_count"]):
            words.append(
                f"{figure['electrons_per_count']:.2f} +- {figure['its_deviation']:.2f} electrons a count, "
                f"read noise {figure['read_noise_electrons']:.1f} electrons"
            )
        if np.isfinite(figure["linearity_percent"]):
            words.append(f"linear to {figure['linearity_percent']:.2f} % of full scale")
        sentence = f"{facts['cameras'][polarisation]}: " + "; ".join(words)
        findings.append(("good" if figure["dark_known"] else "doubtful", sentence))
    return findings

"""flat: how each camera answers to even light; its gain, linearity and dead pixels.

The kernels are in `defects.py` and `sensor_response.py`. Of several exposures the brightest below saturation makes
the flat, and all of them tell the linearity.

Must have run before: capture. The dark comes from the bound item, or from frames without light (O) in the same
capture; without either it stays in the flat, and no response is told. Source: EMVA 1288 (2021).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.dag.stage import (
    Arrangement,
    Finding,
    Grid,
    Group,
    Input,
    Items,
    Needs,
    Output,
    Params,
    Result,
    Stage,
    StageError,
)
from lightstage.kernels.targets.defects import find_dead, find_hot, interpolate, moments
from lightstage.kernels.targets.sensor_response import fit_linearity, photon_transfer
from lightstage.stages.calibration.session import SCALE, frames_of, listed, stored

_FULL = 0.95
"""A flat reaches at most this part of the range at its brightest 99.9 %."""


class FlatParams(Params):
    """`flat` has no parameters."""


def flat(
    raw: Sequence[NDArray[np.uint16]],
    *,
    white_level: int,
    lit: int,
    exposures: Sequence[float | None],
    dark_picture: NDArray[np.float64] | None,
) -> Mapping[str, Any]:
    """The flat of one camera.

    Args:
        raw: frames (y, x), counts: `lit` of them with light, the others without.
        white_level: the count at which the sensor saturates.
        lit: how many are lit.
        exposures: (lit,), seconds or None.
        dark_picture: (y, x), counts; None: from the frames without light, if there are.

    Returns:
        `mean` (y, x) counts, dark included, dead pixels filled in; `dead` (y, x); numbers, NaN where not told.

    Raises:
        StageError: saturated, or no light.
    """
    times = list(dict.fromkeys(exposures))
    levels = {t: moments((raw[i] for i in range(lit) if exposures[i] == t), white_level=white_level) for t in times}
    usable = {t: m for t, m in levels.items() if np.quantile(m.mean, 0.999) < _FULL * white_level}
    if not usable:
        raise StageError("the flat is saturated; expose it to about two thirds of the range")
    best = max(usable, key=lambda t: float(np.median(usable[t].mean)))
    chosen = usable[best]
    unlit = moments((raw[i] for i in range(lit, len(raw))), white_level=white_level) if len(raw) > lit else None
    ground = dark_picture if dark_picture is not None else None if unlit is None else unlit.mean
    mean = chosen.mean
    dead = np.zeros(mean.shape, np.bool_)
    gain = gain_sd = read = worst = offset = np.nan
    if ground is not None:
        hot, _ = find_hot(ground, white_level=white_level)
        dead, _ = find_dead(mean, ground, bad=hot)
        mean = ground + interpolate(mean - ground, dead)
        if unlit is not None and unlit.frames > 1 and chosen.frames > 1:
            transfer = photon_transfer(unlit, [m for m in usable.values() if m.frames > 1], bad=hot | dead)
            gain, gain_sd, read = (
                transfer.electrons_per_count, transfer.electrons_per_count_sd, transfer.read_noise_electrons
            )  # fmt: skip
    told = sorted(t for t in times if t is not None)
    if len(told) >= 3:
        line = fit_linearity(np.array(told), np.stack([levels[t].mean for t in told]), white_level=white_level)
        worst, offset = line.deviation_percent, line.offset_counts
    return {
        "mean": mean.astype(np.float32),
        "dead": dead,
        "numbers": np.array([gain, gain_sd, read, worst, offset, chosen.frames, ground is not None], np.float64),
    }


NUMBERS = ("electrons_per_count", "its_deviation", "read_noise_electrons", "linearity_percent", "offset", "frames",
           "dark_known")  # fmt: skip


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: FlatParams) -> Arrangement:
    (raw,) = grids
    target = (facts["target"] or {}).get("kind")
    lit = frames_of(raw, "C")
    if target not in ("flat", "white") or not lit:
        raise StageError("measuring the flat needs frames of an even target under C, and target: {kind: flat}")
    unlit = frames_of(raw, "O")
    times = facts.get("exposure_s", [None] * raw.sizes["frame"])
    groups = tuple(
        Group(
            {"raw": [{"frame": i, "band": 0, "polarisation": p} for i in (*lit, *unlit)]},
            {"lit": len(lit), "exposures": [times[i] for i in lit]},
        )
        for p in range(raw.sizes["polarisation"])
    )
    sizes = {**{name: raw.sizes[name] for name in ("polarisation", "y", "x")}, "number": len(NUMBERS)}
    labels = {"polarisation": raw.labels["polarisation"], "number": (("number",), list(NUMBERS))}
    return Arrangement(Grid(sizes, labels), groups)


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: FlatParams
) -> dict[str, Any]:
    camera = facts["cameras"][labels["polarisation"]]
    known = "dark" in items and camera in items["dark"]["pictures"]
    return {
        "white_level": facts["white_level"],
        "lit": labels["lit"],
        "exposures": labels["exposures"],
        "dark": items["dark"]["pictures"][camera] if known else None,
        "dark_scale": items["dark"]["scale"] if known else 1.0,
    }


def _prepare(*, white_level: int, lit: int, exposures: Any, dark: Any, dark_scale: float) -> Mapping[str, Any]:
    picture = None if dark is None else np.asarray(dark.load(), np.float64) / dark_scale
    return {"white_level": white_level, "lit": lit, "exposures": exposures, "dark_picture": picture}


def _item(result: Result) -> Mapping[str, Any]:
    """The flat item."""
    names = [result.facts["cameras"][p] for p in result.labels["polarisation"]]
    return {
        "item": "flat",
        "images": {name: stored(mean) for name, mean in zip(names, result.arrays["mean"], strict=True)},
        "scale": SCALE,
        "dark_included": True,
        "dead_px": {name: listed(dead) for name, dead in zip(names, result.arrays["dead"], strict=True)},
    }


def _verdict(result: Result) -> list[Finding]:
    findings = []
    for i, polarisation in enumerate(result.labels["polarisation"]):
        n = dict(zip(NUMBERS, result.arrays["numbers"][i], strict=True))
        words = [f"flat {float(np.median(result.arrays['mean'][i])):.0f} counts from {n['frames']:.0f} frames"]
        if n["dark_known"]:
            words.append(f"{int(result.arrays['dead'][i].sum())} dead pixels, filled in")
        else:
            words.append("no dark is known, so dead pixels cannot be told: bind a dark item, or add frames under O")
        if np.isfinite(n["electrons_per_count"]):
            words.append(
                f"{n['electrons_per_count']:.2f} +- {n['its_deviation']:.2f} electrons a count, read noise "
                f"{n['read_noise_electrons']:.1f} electrons"
            )
        if np.isfinite(n["linearity_percent"]):
            words.append(f"linear to {n['linearity_percent']:.2f} % of full scale")
        sentence = f"{result.facts['cameras'][polarisation]}: " + "; ".join(words)
        findings.append(Finding("good" if n["dark_known"] else "doubtful", sentence))
    return findings


STAGE = Stage(
    name="flat",
    version=1,
    summary="how a camera answers to even light",
    params=FlatParams,
    inputs={"raw": Input("raw", ("frame", "band", "polarisation", "y", "x"), "group")},
    calibration={"dark": Needs(why="dead pixels and gain are told only from frames without light in the capture")},
    outputs={
        "mean": Output(("polarisation", "y", "x"), "float32", attrs={"units": "counts"}),
        "dead": Output(("polarisation", "y", "x"), "bool"),
        "numbers": Output(("polarisation", "number"), "float64", ("number",)),
    },
    blocks=("polarisation",),
    arrange=_arrange,
    context=_context,
    prepare=_prepare,
    prepared=("white_level", "lit", "exposures", "dark_picture"),
    kernel=flat,
    item=_item,
    verdict=_verdict,
)

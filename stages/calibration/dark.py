"""dark: what each camera records without light, and its hot pixels, from repeated frames.

The kernels are in `defects.py`. Frames of one exposure count; the most frequent one unless `exposure_s` says.
The dark keeps hot pixels as they are, because subtracting them is right.

Must have run before: capture. Source: EMVA 1288 (2021), and those of the kernels.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lightstage.dag.stage import (
    Arrangement,
    Finding,
    Grid,
    Group,
    Input,
    Items,
    Output,
    Params,
    Result,
    Stage,
    StageError,
)
from lightstage.kernels.targets.defects import find_hot, moments
from lightstage.stages.calibration.session import SCALE, frames_of, listed, stored


class DarkParams(Params):
    """Parameters of `dark`."""

    exposure_s: float = Field(0.0, ge=0, description="which exposure; 0: the most frequent")


def dark(raw: Sequence[NDArray[np.uint16]], *, white_level: int) -> Mapping[str, Any]:
    """Mean, noise and hot pixels of one camera.

    Args:
        raw: frames (y, x), counts.
        white_level: the count at which the sensor saturates.

    Returns:
        `mean` (y, x) and `noise` (y, x) in counts, `hot` (y, x), `threshold` () in counts.

    Raises:
        StageError: the frames are not dark.
    """
    found = moments(raw, white_level=white_level)
    level = float(np.median(found.mean))
    if level > 0.25 * white_level:
        raise StageError(
            f"the dark frames have {level:.0f} of {white_level} counts: they show light; cover the lens"
        )
    hot, threshold = find_hot(found.mean, white_level=white_level)
    return {
        "mean": found.mean.astype(np.float32),
        "noise": np.sqrt(found.variance).astype(np.float32),
        "hot": hot,
        "threshold": np.array(threshold),
    }


def dark_frames(facts: Mapping[str, Any], raw: Grid, exposure_s: float) -> list[int]:
    """The frames without light of one exposure.

    Raises:
        StageError: there is none.
    """
    target = (facts["target"] or {}).get("kind")
    frames = list(range(raw.sizes["frame"])) if target == "dark" else frames_of(raw, "O")
    if not frames:
        raise StageError("measuring the dark needs frames without light: illumination O, or target: {kind: dark}")
    times = facts.get("exposure_s", [None] * raw.sizes["frame"])
    usual = exposure_s or Counter(times[i] for i in frames).most_common(1)[0][0]
    chosen = [i for i in frames if times[i] == usual]
    if not chosen:
        known = ", ".join(f"{t:g}" for t in sorted({times[i] for i in frames if times[i]}))
        raise StageError(
            f"exposure_s: no dark frame has {exposure_s:g} s (there are {known or 'none with a time'})"
        )
    return chosen


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: DarkParams) -> Arrangement:
    (raw,) = grids
    frames = dark_frames(facts, raw, params.exposure_s)
    groups = tuple(
        Group(
            {"raw": [{"frame": i, "band": b, "polarisation": p} for i in frames for b in range(raw.sizes["band"])]}
        )
        for p in range(raw.sizes["polarisation"])
    )
    sizes = {name: raw.sizes[name] for name in ("polarisation", "y", "x")}
    time = facts.get("exposure_s", [None] * raw.sizes["frame"])[frames[0]]
    attrs = {"frames": len(frames), **({"exposure_s": time} if time else {})}
    return Arrangement(Grid(sizes, {"polarisation": raw.labels["polarisation"]}, attrs), groups)


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: DarkParams
) -> dict[str, Any]:
    return {"white_level": facts["white_level"]}


def _item(result: Result) -> Mapping[str, Any]:
    """The dark item."""
    names = [result.facts["cameras"][p] for p in result.labels["polarisation"]]
    item: dict[str, Any] = {
        "item": "dark",
        "images": {name: stored(mean) for name, mean in zip(names, result.arrays["mean"], strict=True)},
        "scale": SCALE,
        "hot_px": {name: listed(hot) for name, hot in zip(names, result.arrays["hot"], strict=True)},
    }
    if "exposure_s" in result.attrs:
        item["exposure_s"] = result.attrs["exposure_s"]
    return item


def _verdict(result: Result) -> list[Finding]:
    findings = []
    for i, polarisation in enumerate(result.labels["polarisation"]):
        noise = result.arrays["noise"][i]
        sentence = (
            f"{result.facts['cameras'][polarisation]}: "
            f"dark {float(np.median(result.arrays['mean'][i])):.2f} counts, "
            + (f"noise {float(np.sqrt(np.mean(noise**2))):.2f} counts, " if np.isfinite(noise).all() else "")
            + f"{int(result.arrays['hot'][i].sum())} hot pixels "
            f"(more than {float(result.arrays['threshold'][i]):.1f} counts above others), "
            f"from {result.attrs['frames']} frames"
        )
        findings.append(Finding("good", sentence))
    return findings


STAGE = Stage(
    name="dark",
    version=1,
    summary="what a camera records without light",
    params=DarkParams,
    inputs={"raw": Input("raw", ("frame", "band", "polarisation", "y", "x"), "group")},
    outputs={
        "mean": Output(("polarisation", "y", "x"), "float32", attrs={"units": "counts"}),
        "noise": Output(("polarisation", "y", "x"), "float32", attrs={"units": "counts"}),
        "hot": Output(("polarisation", "y", "x"), "bool"),
        "threshold": Output(("polarisation",), "float64", (), {"units": "counts"}),
    },
    blocks=("polarisation",),
    arrange=_arrange,
    context=_context,
    prepared=("white_level",),
    kernel=dark,
    item=_item,
    verdict=_verdict,
)

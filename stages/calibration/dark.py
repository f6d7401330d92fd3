"""dark: what each camera records without light, and its hot pixels, from repeated frames.

Frames of one exposure count; the most frequent one unless `exposure_s` says. The dark keeps hot pixels as they are,
because subtracting them is right.

Must have run before: capture. Source: EMVA 1288 (2021), and those of `kernels/targets/defects.py`.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import Field

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Output, Params, Stage, StageError
from lightstage.hw.illuminations import DARK
from lightstage.stages.calibration.session import exposures_s, frames_of


class DarkParams(Params):
    """Parameters of `dark`."""

    exposure_s: float = Field(0.0, ge=0, description="which exposure; 0: the most frequent")


def dark_frames(facts: Mapping[str, Any], raw: Grid, exposure_s: float) -> list[int]:
    """The frames without light of one exposure.

    Raises:
        StageError: there is none.
    """
    target = (facts["target"] or {}).get("kind")
    frames = list(range(raw.sizes["frame"])) if target == "dark" else frames_of(raw, DARK)
    if not frames:
        raise StageError("measuring the dark needs frames without light: illumination O, or target: {kind: dark}")
    times = exposures_s(facts, raw.sizes["frame"])
    unlit = [times[i] for i in frames]
    usual = exposure_s or Counter(unlit).most_common(1)[0][0]
    chosen = [i for i in frames if times[i] == usual]
    if not chosen:
        known = ", ".join(f"{t:g}" for t in sorted({time for time in unlit if time}))
        raise StageError(
            f"exposure_s: no dark frame has {exposure_s:g} s (there are {known or 'none with a time'})"
        )
    return chosen


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: DarkParams) -> Arrangement:
    (raw,) = grids
    frames = dark_frames(facts, raw, params.exposure_s)
    groups = tuple(
        Group(
            {
                "raw": {
                    (i, nm): {"frame": i, "band": b, "polarisation": p}
                    for i in frames
                    for b, nm in enumerate(raw.along("band"))
                }
            }
        )
        for p in range(raw.sizes["polarisation"])
    )
    sizes = {name: raw.sizes[name] for name in ("polarisation", "y", "x")}
    time = exposures_s(facts, raw.sizes["frame"])[frames[0]]
    attrs = {"frames": len(frames), **({"exposure_s": time} if time else {})}
    return Arrangement(Grid(sizes, {"polarisation": raw.labels["polarisation"]}, attrs), groups)


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: DarkParams
) -> dict[str, Any]:
    return {"white_level": facts["white_level"]}


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
    kernel="lightstage.kernels.targets.dark:dark",
    item="lightstage.kernels.targets.dark:item",
    verdict="lightstage.kernels.targets.dark:verdict",
)

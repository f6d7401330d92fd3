"""flat: how each camera answers to even light; its gain, linearity and dead pixels.

Of several exposures the brightest below saturation makes the flat, and all of them tell the linearity.

Must have run before: capture. The dark comes from the bound item, or from frames without light (O) in the same
capture; without either it stays in the flat, and no response is told. Source: EMVA 1288 (2021).
"""

from collections.abc import Mapping, Sequence
from typing import Any

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Needs, Output, Params, Stage, StageError
from lightstage.hw.illuminations import CONSTANT, DARK
from lightstage.kernels.targets.labels import FLAT_NUMBERS
from lightstage.stages.calibration.session import exposures_s, frames_of, stored_picture


class FlatParams(Params):
    """`flat` has no parameters."""


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: FlatParams) -> Arrangement:
    (raw,) = grids
    target = (facts["target"] or {}).get("kind")
    lit, unlit = frames_of(raw, CONSTANT), frames_of(raw, DARK)
    if target not in ("flat", "white") or not lit:
        raise StageError("measuring the flat needs frames of an even target under C, and target: {kind: flat}")
    times = exposures_s(facts, raw.sizes["frame"])
    groups = tuple(
        Group(
            {
                "lit": {(times[i] or 0.0, i): {"frame": i, "band": 0, "polarisation": p} for i in lit},
                "unlit": {i: {"frame": i, "band": 0, "polarisation": p} for i in unlit},
            }
        )
        for p in range(raw.sizes["polarisation"])
    )
    sizes = {**{name: raw.sizes[name] for name in ("polarisation", "y", "x")}, "number": len(FLAT_NUMBERS)}
    labels = {"polarisation": raw.labels["polarisation"], "number": (("number",), list(FLAT_NUMBERS))}
    return Arrangement(Grid(sizes, labels), groups)


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: FlatParams
) -> dict[str, Any]:
    camera = facts["cameras"][labels["polarisation"]]
    return {"white_level": facts["white_level"], "dark": stored_picture(items, "dark", camera)}


_RAW = Input("raw", ("frame", "band", "polarisation", "y", "x"), "group")
STAGE = Stage(
    name="flat",
    version=1,
    summary="how a camera answers to even light",
    params=FlatParams,
    inputs={"lit": _RAW, "unlit": _RAW},
    calibration={"dark": Needs(why="dead pixels and gain are told only from frames without light in the capture")},
    outputs={
        "mean": Output(("polarisation", "y", "x"), "float32", attrs={"units": "counts"}),
        "dead": Output(("polarisation", "y", "x"), "bool"),
        "numbers": Output(("polarisation", "number"), "float64", ("number",)),
    },
    blocks=("polarisation",),
    arrange=_arrange,
    context=_context,
    prepare="lightstage.kernels.targets.flat:prepare",
    prepared=("white_level", "dark_picture"),
    kernel="lightstage.kernels.targets.flat:flat",
    item="lightstage.kernels.targets.flat:item",
    verdict="lightstage.kernels.targets.flat:verdict",
)

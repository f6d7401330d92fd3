"""highlights: where on a mirror ball a light is reflected, a picture at a time.

A ball is convex: one light makes one highlight. The two strongest spots are told; which of them count is for
`lights` to say, which knows how bright the others are. How a spot is placed: `kernels/targets/highlights.py`.

Must have run before: outline. Limits: pictures without a light (O) and with all on (C) are measured as well, and
mean nothing. Source: Dutta (2010) 3.1.2.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Output, Params, Stage
from lightstage.kernels.targets.labels import SPOTS
from lightstage.stages.calibration.session import parts, reference


class HighlightsParams(Params):
    """`highlights` has no parameters."""


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: HighlightsParams) -> Arrangement:
    raw, outline = grids
    frames = raw.sizes["frame"]
    camera = reference(raw)
    places = list(outline.along("part"))
    groups = tuple(
        Group(
            {
                "raw": {
                    nm: {"frame": i, "band": b, "polarisation": camera} for b, nm in enumerate(raw.along("band"))
                },
                "ring": {place: {"part": places.index(place)}},
            }
        )
        for i, place in enumerate(parts(facts, frames))
    )
    labels = {"illumination": raw.labels["illumination"], "frame": (("frame",), list(range(frames)))}
    return Arrangement(Grid({"frame": frames, "spot": SPOTS, "xy": 2}, labels), groups)


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: HighlightsParams
) -> Mapping[str, Any]:
    return {"white_level": facts["white_level"]}


STAGE = Stage(
    name="highlights",
    version=1,
    summary="the reflection of each light on a mirror ball",
    params=HighlightsParams,
    inputs={
        "raw": Input("raw", ("frame", "band", "polarisation", "y", "x"), "group", 0),
        "ring": Input("ring", ("part", "point", "xy"), "group", 1),
    },
    outputs={
        "at_px": Output(("frame", "spot", "xy"), "float64", ("spot", "xy"), {"units": "pixel"}),
        "flux": Output(("frame", "spot"), "float64", ("spot",), {"units": "counts"}),
        "peak": Output(("frame", "spot"), "float64", ("spot",), {"units": "counts"}),
        "width_px": Output(("frame", "spot"), "float64", ("spot",), {"units": "pixel"}),
        "saturated_px": Output(("frame", "spot"), "float64", ("spot",), {"units": "pixels"}),
        "noise": Output(("frame",), "float64", (), {"units": "counts"}),
    },
    blocks=("frame",),
    arrange=_arrange,
    context=_context,
    prepared=("white_level",),
    kernel="lightstage.kernels.targets.highlights:highlights",
)

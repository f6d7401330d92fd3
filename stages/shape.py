"""shape: the surface as a height map, in millimetres.

Where the node above found depth together with the normals (`normals` with `correct: near` and beyond) that is the
shape. Otherwise normals are integrated: a plane through the point z r with normal n gives for the ray r' beside it

    (n . r) (L' - L) = -n . (r' - r),    L = log z ,

masked, perspective-correct, and aware of discontinuities (`integration.py`). Normals tell depth up to one factor;
it is set so that the subject's median lies at the stage's centre, which is where the rig wants it.

`edge` says between which neighbours the surface is broken, for whoever puts triangles on it. With a = (L' - L) /
|r' - r|, about the tangent of the slant, and a1, a2 what the normals on its two sides predict, a break is where

    |a| > 8    or    |a| > 2 and a lies more than 1/2 outside the range from a1 to a2 :

on a smooth surface a step lies between the slopes at its ends (the mean value theorem).
docs/methods/shape.md measures how many of a head's true breaks that finds.

Must have run before: normals. Limits: without a model of the rig's lights the height map has the bend that near
lights put into normals; parts of the subject that do not touch have no common distance.

Sources: Cao et al. (2022), doi:10.1007/978-3-031-19769-7_32; Dutta (2010) chapter 3 for the normals.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Needs, Output, Params, Stage
from lightstage.kernels.encodings import EDGE_BELOW, EDGE_RIGHT
from lightstage.kernels.items import lens_of


class ShapeParams(Params):
    """Nothing to choose."""


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: ShapeParams
) -> Mapping[str, Any]:
    return {
        "camera": lens_of(items["camera"]),
        "mask": facts["mask"] if labels["integrated"] else None,
        "shape": labels["shape"],
    }


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: ShapeParams) -> Arrangement:
    (relief,) = grids
    height, width = relief.sizes["y"], relief.sizes["x"]
    has_depth = "depth_mm" in relief.arrays
    groups = []
    for t, frame in enumerate(relief.along("tracking")):
        bands = {band: {"tracking": t, "band": b} for b, band in enumerate(relief.along("band"))}
        groups.append(
            Group(
                {"depth_mm": {frame: {"tracking": t}}, "normal": bands, "albedo": bands},
                {"shape": [height, width], "integrated": not has_depth},
            )
        )
    labels = {name: relief.labels[name] for name in ("tracking", "time_s") if name in relief.labels}
    attrs = {
        "from": "depth found with the normals" if has_depth else "integrated normals; distance: the stage's centre"
    }
    return Arrangement(Grid({"tracking": len(groups), "y": height, "x": width}, labels, attrs), tuple(groups))


STAGE = Stage(
    name="shape",
    version=1,
    summary="height map in millimetres",
    params=ShapeParams,
    inputs={
        "depth_mm": Input("depth_mm", ("tracking", "y", "x"), "group", optional=True),
        "normal": Input("normal", ("tracking", "band", "xyz", "y", "x"), "group"),
        "albedo": Input("albedo", ("tracking", "band", "y", "x"), "group"),
    },
    calibration={"camera": Needs(required=True, why="millimetres and perspective come from it")},
    outputs={
        "depth_mm": Output(
            ("tracking", "y", "x"), "float32", attrs={"units": "mm", "long_name": "camera z of the surface"}
        ),
        "edge": Output(
            ("tracking", "y", "x"),
            "uint8",
            attrs={
                "flag_masks": [EDGE_RIGHT, EDGE_BELOW],
                "flag_meanings": "right below",
                "long_name": "the surface is broken towards this neighbour",
            },
        ),
    },
    blocks=("tracking",),
    arrange=_arrange,
    context=_context,
    prepare="lightstage.kernels.surface.shape:prepare",
    prepared=("camera", "mask"),
    kernel="lightstage.kernels.surface.shape:shape",
)

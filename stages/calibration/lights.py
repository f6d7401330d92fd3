"""lights: where every light of the stage is, from its highlight on a mirror ball.

Each highlight gives a ray; all together are fitted to the geodesic layout that the stage was built to, which also
names lights that disagree and places those that the stand hides. Without a layout of that many lights, or without a
camera item, directions are what there is.

Must have run before: outline, highlights. Limits: the stage's radius is not measured by one ball; a swap of two
files and one of two channels cannot be told apart. Sources: Dutta (2010) 3.1.2, and those of
`kernels/targets/light_rays.py` and `light_positions.py`.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from pydantic import Field

from lightstage.dag.stage import (
    Arrangement,
    Grid,
    Group,
    Input,
    Items,
    Name,
    Needs,
    Output,
    Params,
    Stage,
    StageError,
)
from lightstage.hw.illuminations import light_name, light_number
from lightstage.kernels.targets.labels import LIGHT_STATUS, OUTLINE_POINTS
from lightstage.stages.calibration.session import (
    intrinsics,
    light_numbers,
    need_target,
    parts,
    reference,
    single_lights,
)

_FREQUENCIES = range(1, 17)
"""Of the geodesic spheres that are tried: up to 2,562 lights."""
_FEW_LIGHTS = 12
"""So many may be anything; more are a geodesic stage with a picture missing, unless somebody says otherwise."""


class LightsParams(Params):
    """Parameters of `lights`."""

    stage_radius_mm: float = Field(790.0, gt=0, description="radius of the sphere that the lights are mounted on")
    stage_sigma_mm: float = Field(3.0, gt=0, description="how well that radius is known")
    placement_sigma_mm: float = Field(5.0, gt=0, description="how far a light may be off its place")
    layout: str = Field("auto", pattern="auto|none|[1-9][0-9]*", description="frequency of the geodesic sphere")
    driven_from: Literal["ideal", "measured"] = Field(
        "ideal", description="where the rig's gradient weights were made from: the layout, or measured positions"
    )


def _vertices(frequency: int) -> int:
    """Of a geodesic sphere."""
    return 10 * frequency**2 + 2


def geodesic(count: int, layout: str) -> dict[str, Any] | None:
    """The geodesic sphere of so many lights, on all its vertices (`whole`) or all but the lowest; None without one.

    Raises:
        StageError: the frequency asked for has another number of lights.
    """
    if layout == "none":
        return None
    for frequency in _FREQUENCIES if layout == "auto" else [int(layout)]:
        if count in (_vertices(frequency) - 1, _vertices(frequency)):
            return {"frequency": frequency, "whole": count == _vertices(frequency)}
    if layout == "auto":
        return None
    most = _vertices(int(layout))
    raise StageError(
        f"layout: {layout} has {most - 1} or {most} lights, the capture names {count}; a missing picture "
        "must be named as a frame, too"
    )


def _check_complete(numbers: Sequence[int], layout: str) -> None:
    """Raise StageError unless every light is named."""
    gaps = sorted(set(range(numbers[-1] + 1)) - set(numbers))
    near = "direction" if len(numbers) < 4 else "position"
    if gaps:
        raise StageError(
            f"the picture of {light_name(gaps[0])} is missing" + (f" and {len(gaps) - 1} more" if gaps[1:] else "")
            + f" (L00 to {light_name(numbers[-1])} are named); capture it, or its {near} stays unknown"
        )  # fmt: skip
    if geodesic(len(numbers), layout) is None and layout == "auto" and len(numbers) > _FEW_LIGHTS:
        short = min((_vertices(f) - 1 for f in _FREQUENCIES), key=lambda lights: abs(lights - len(numbers)))
        raise StageError(
            f"{len(numbers)} lights are named; a geodesic stage has {short} (or {short + 1}): a picture is "
            "missing, or set layout: none for directions alone"
        )


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: LightsParams) -> Arrangement:
    raw, _, outline = grids
    need_target(facts, "mirror_ball", "measuring lights")
    camera = reference(raw)
    names = list(raw.along("illumination"))
    numbers = light_numbers(names)
    if not numbers:
        raise StageError("measuring lights needs pictures under one light each (L00, L01, ...); there is none")
    _check_complete(numbers, params.layout)
    part = parts(facts, len(names))
    places = list(outline.along("part"))
    frames: dict[tuple[int, int], int] = {}
    for i in single_lights(raw):
        name = part[i], light_number(names[i])
        if name in frames:
            raise StageError(f"{names[i]} has two pictures (frames {frames[name]} and {i}); keep one")
        frames[name] = i
    empty = sorted(set(places) - {place for place, _ in frames})
    if empty:
        raise StageError(
            f"place {empty[0]} of the ball has no picture under one light; add them, or leave the place out"
        )
    measured: dict[Name, dict[str, int]] = {name: {"frame": i} for name, i in frames.items()}
    reads: dict[str, dict[Name, dict[str, int]]] = {
        "raw": {name: {"frame": i, "band": 0, "polarisation": camera} for name, i in frames.items()},
        **dict.fromkeys(("at_px", "flux", "peak", "width_px", "saturated_px", "noise"), measured),
        "ring": {place: {"part": i} for i, place in enumerate(places)},
    }
    sizes = {
        "all": 1, "light": len(numbers), "part": len(places), "xyz": 3, "xy": 2, "point": OUTLINE_POINTS, "row": 3,
        "column": 3, "value": 4,
    }  # fmt: skip
    labels: dict[str, Any] = {
        "light": (("light",), [light_name(number) for number in numbers]),
        "xyz": (("xyz",), list("xyz")),
    }
    return Arrangement(Grid(sizes, labels), (Group(reads, {"count": len(numbers)}),))


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: LightsParams
) -> Mapping[str, Any]:
    camera = intrinsics(items, facts["shape"])
    radius = facts["target"].get("radius_mm")
    if camera is not None and radius is None:
        raise StageError("the ball's size is not known; write target: {kind: mirror_ball, radius_mm: ...}")
    return {
        "camera": camera,
        "ball_radius_mm": radius,
        "mask": facts["mask"],
        "geodesic": geodesic(labels["count"], params.layout),
    }


STAGE = Stage(
    name="lights",
    version=1,
    summary="where every light is",
    params=LightsParams,
    inputs={
        "raw": Input("raw", ("frame", "band", "polarisation", "y", "x"), "group", 0),
        "at_px": Input("at_px", ("frame", "spot", "xy"), "group", 1),
        "flux": Input("flux", ("frame", "spot"), "group", 1),
        "peak": Input("peak", ("frame", "spot"), "group", 1),
        "width_px": Input("width_px", ("frame", "spot"), "group", 1),
        "saturated_px": Input("saturated_px", ("frame", "spot"), "group", 1),
        "noise": Input("noise", ("frame",), "group", 1),
        "ring": Input("ring", ("part", "point", "xy"), "group", 2),
    },
    calibration={"camera": Needs(why="the camera is taken as orthographic: directions only")},
    outputs={
        "position_mm": Output(("all", "light", "xyz"), "float64", ("light", "xyz"), {"units": "mm"}),
        "direction": Output(("all", "light", "xyz"), "float64", ("light", "xyz")),
        "sigma_mm": Output(("all", "light"), "float64", ("light",), {"units": "mm"}),
        "residual_mm": Output(("all", "light"), "float64", ("light",), {"units": "mm"}),
        "layout_place": Output(("all", "light"), "int64", ("light",)),
        "drive_position": Output(("all", "light", "xyz"), "float64", ("light", "xyz")),
        "at_px": Output(("all", "part", "light", "xy"), "float64", ("part", "light", "xy"), {"units": "pixel"}),
        "flux": Output(("all", "part", "light"), "float64", ("part", "light"), {"units": "counts"}),
        "status": Output(
            ("all", "part", "light"), "int64", ("part", "light"), {"meanings": " ".join(LIGHT_STATUS)}
        ),
        "ball_mm": Output(("all", "part", "xyz"), "float64", ("part", "xyz"), {"units": "mm"}),
        "outline": Output(("all", "part", "point", "xy"), "float64", ("part", "point", "xy"), {"units": "pixel"}),
        "off_place": Output(("all", "light"), "bool", ("light",)),
        "renumbered": Output(("all",), "bool", ()),
        "turn": Output(("all", "row", "column"), "float64", ("row", "column")),
        "stage_mm": Output(("all", "value"), "float64", ("value",), {"meanings": "centre x y z, radius"}),
    },
    blocks=("all",),
    arrange=_arrange,
    context=_context,
    prepare="lightstage.kernels.targets.lights:prepare",
    prepared=("ball", "layout"),
    kernel="lightstage.kernels.targets.lights:lights",
    item="lightstage.kernels.targets.lights:item",
    verdict="lightstage.kernels.targets.lights:verdict",
)

"""outline: the outline of a mirror ball, from the picture with all lights on.

One block for each place of the ball. Without a picture under all lights (C) a mask, or points picked by hand, must
say where the ball is; then the mean over all one-light pictures tells the edge.

Must have run before: capture. Sources: those of `kernels/targets/ball_outline.py` (search) and `ball_conic.py`
(fit).
"""

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

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
from lightstage.hw.illuminations import CONSTANT
from lightstage.kernels.targets.labels import OUTLINE_POINTS
from lightstage.stages.calibration.session import (
    frames_of,
    intrinsics,
    need_target,
    parts,
    reference,
    single_lights,
)


class OutlineParams(Params):
    """Parameters of `outline`."""

    points: str = Field(
        "", description="points on the outline picked by hand: x,y x,y ... in pixels; empty: it is found"
    )


def picked(text: str) -> list[list[float]] | None:
    """Points `x,y x,y ...`, (point, xy); None for no text.

    Raises:
        StageError: it is not of that form.
    """
    if not text.strip():
        return None
    try:
        points = [[float(value) for value in pair.split(",")] for pair in text.split()]
        if not all(len(point) == 2 and all(map(isfinite, point)) for point in points):
            raise ValueError
    except ValueError:
        raise StageError(f"points: '{text[:40]}' is not x,y x,y ... (six points or more around the ball)") from None
    return points


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: OutlineParams) -> Arrangement:
    (raw,) = grids
    need_target(facts, "mirror_ball", "finding the ball")
    camera = reference(raw)
    part = parts(facts, raw.sizes["frame"])
    places = sorted(set(part))
    groups = []
    for place in places:
        chosen = [i for i in frames_of(raw, CONSTANT) if part[i] == place]
        if not chosen:
            if facts["mask"] is None and picked(params.points) is None:
                raise StageError(
                    "the picture with all lights on (illumination C) is missing"
                    + (f" at place {place} of the ball" if len(places) > 1 else "")
                    + "; add it, or a mask of the ball, or give points on its outline (--outline)"
                )
            chosen = [i for i in single_lights(raw) if part[i] == place]
        pictures: dict[Name, dict[str, int]] = {
            (i, nm): {"frame": i, "band": b, "polarisation": camera}
            for i in chosen
            for b, nm in enumerate(raw.along("band"))
        }
        groups.append(Group({"raw": pictures}))
    sizes = {"part": len(places), "row": 3, "column": 3, "point": OUTLINE_POINTS, "xy": 2}
    return Arrangement(Grid(sizes, {"part": (("part",), places)}), tuple(groups))


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: OutlineParams
) -> Mapping[str, Any]:
    camera = intrinsics(items, facts["shape"])
    if camera is not None:
        camera.pop("world_to_camera")
    return {"camera": camera, "mask": facts["mask"], "by_hand": picked(params.points)}


STAGE = Stage(
    name="outline",
    version=1,
    summary="the outline of a mirror ball",
    params=OutlineParams,
    inputs={"raw": Input("raw", ("frame", "band", "polarisation", "y", "x"), "group")},
    calibration={"camera": Needs(why="the camera is taken as orthographic")},
    outputs={
        "conic": Output(("part", "row", "column"), "float64", ("row", "column")),
        "ring": Output(("part", "point", "xy"), "float64", ("point", "xy"), {"units": "pixel"}),
        "centre_px": Output(("part", "xy"), "float64", ("xy",), {"units": "pixel"}),
        "radius_px": Output(("part",), "float64", (), {"units": "pixel"}),
        "rms_px": Output(("part",), "float64", (), {"units": "pixel"}),
    },
    blocks=("part",),
    arrange=_arrange,
    context=_context,
    prepare="lightstage.kernels.targets.outline:prepare",
    prepared=("lens", "mask", "by_hand"),
    kernel="lightstage.kernels.targets.outline:outline",
)

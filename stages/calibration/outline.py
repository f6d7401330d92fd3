"""outline: the outline of a mirror ball, from the picture with all lights on.

The kernel is in `ball_outline.py`, the fit in `ball_conic.py`. One block for each place of the ball. Without a
picture under all lights (C) a mask, or points picked by hand, must say where the ball is; then the mean over all
one-light pictures tells the edge.

Must have run before: capture. Sources: those of the two modules.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Needs, Output, Params, Stage, StageError
from lightstage.kernels.targets.ball_conic import outline_of_points
from lightstage.kernels.targets.ball_outline import find_outline
from lightstage.stages.calibration.session import frames_of, intrinsics, need_target, parts, reference


class OutlineParams(Params):
    """Parameters of `outline`."""

    points: str = Field(
        "", description="points on the outline picked by hand: x,y x,y ... in pixels; empty: it is found"
    )


def outline(
    raw: Sequence[NDArray[np.uint16]],
    *,
    camera: Mapping[str, Any] | None,
    mask: NDArray[np.bool_] | None,
    by_hand: NDArray[np.float64] | None,
) -> Mapping[str, NDArray[Any]]:
    """The outline at one place of the ball.

    Args:
        raw: (y, x) counts: the pictures under all lights, or all under one each.
        camera: K and distortion; None takes the camera as orthographic.
        mask: (y, x), where the ball is.
        by_hand: (point, xy) on the outline, pixels.

    Returns:
        `conic` (row, column), `ring` (point, xy) as in the picture, `centre_px` (xy), `radius_px`, `rms_px` ().

    Raises:
        StageError: no ball, two balls, or a ball cut by the frame.
    """
    lens: dict[str, Any] = {
        "intrinsics": None if camera is None else np.asarray(camera["K"], float),
        "distortion": None if camera is None else np.asarray(camera["distortion"], float),
    }
    if by_hand is not None:
        found = outline_of_points(by_hand, **lens, frame=raw[0].shape)
    else:
        found = find_outline(np.mean([np.asarray(r, np.float32) for r in raw], axis=0), mask=mask, **lens)
    return {
        "conic": found.conic,
        "ring": found.ring_px,
        "centre_px": found.centre_px,
        "radius_px": np.array(found.radius_px),
        "rms_px": np.array(found.rms_px),
    }


def picked(text: str) -> NDArray[np.float64] | None:
    """Points `x,y x,y ...` as (point, xy); None for no text.

    Raises:
        StageError: it is not of that form.
    """
    if not text.strip():
        return None
    try:
        points = np.array([[float(v) for v in pair.split(",")] for pair in text.split()])
        if points.ndim != 2 or points.shape[1] != 2:
            raise ValueError
    except ValueError:
        raise StageError(f"points: '{text[:40]}' is not x,y x,y ... (six points or more around the ball)") from None
    return points


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: OutlineParams) -> Arrangement:
    (raw,) = grids
    need_target(facts, "mirror_ball", "measuring lights")
    camera = reference(raw)
    part = parts(facts, raw.sizes["frame"])
    places = sorted(set(part))
    all_on, single = frames_of(raw, "C"), frames_of(raw, "L")
    points = picked(params.points)
    groups = []
    for place in places:
        chosen = [i for i in all_on if part[i] == place]
        if not chosen:
            if facts["mask"] is None and points is None:
                raise StageError(
                    "the picture with all lights on (illumination C) is missing"
                    + (f" at place {place} of the ball" if len(places) > 1 else "")
                    + "; add it, or a mask of the ball, or give points on its outline (--outline)"
                )
            chosen = [i for i in single if part[i] == place]
        pieces = [{"frame": i, "band": b, "polarisation": camera} for i in chosen for b in range(raw.sizes["band"])]
        groups.append(Group({"raw": pieces}))
    sizes = {"part": len(places), "row": 3, "column": 3, "point": 720, "xy": 2}
    return Arrangement(Grid(sizes, {"part": (("part",), places)}), tuple(groups))


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: OutlineParams
) -> Mapping[str, Any]:
    camera = intrinsics(items, facts["shape"])
    if camera is not None:
        camera.pop("world_to_camera")
    return {"camera": camera, "mask": facts["mask"]}


def _prepare(*, camera: Mapping[str, Any] | None, mask: Any, points: str) -> Mapping[str, Any]:
    return {
        "camera": camera,
        "mask": None if mask is None else np.asarray(mask.load()) > 0,
        "by_hand": picked(points),
    }


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
    prepare=_prepare,
    prepared=("camera", "mask", "by_hand"),
    kernel=outline,
)

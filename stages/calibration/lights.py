"""lights: where every light of the stage is, from its highlight on a mirror ball.

Each highlight gives a ray (`light_rays.py`); all together are fitted to the geodesic layout that the stage was
built to (`light_positions.py`), which also names lights that disagree and places those that the stand hides.
Without a layout of that many lights, or without a camera item, directions are what there is.

Must have run before: outline, highlights. The outline is measured anew on the mean of all one-light pictures,
which has less noise than any one. Limits: the stage's radius is not measured by one ball; a swap of two files and
one of two channels cannot be told apart. Sources: Dutta (2010) 3.1.2, and those of the modules.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import cv2
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
    Needs,
    Output,
    Params,
    Result,
    Stage,
    StageError,
)
from lightstage.hw.geodesic import light_positions
from lightstage.kernels.errors import KernelError
from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.kernels.targets.ball_conic import sphere_centre
from lightstage.kernels.targets.ball_outline import find_outline
from lightstage.kernels.targets.light_positions import Balls, Highlights, Layout, refine
from lightstage.kernels.targets.light_rays import (
    light_rays,
    orthographic_directions,
    ray_sigma,
    to_world,
    triangulate,
)
from lightstage.stages.calibration.session import (
    frames_of,
    intrinsics,
    light_numbers,
    need_target,
    parts,
    reference,
)

Floats = NDArray[np.float64]

STATUS = ("seen", "dark", "saturated", "cut", "double", "missing")
_LEAST_PART, _DOUBLE_PART, _SATURATED_PART = 0.05, 0.25, 0.15
_PIXEL = 0.1
"""Standard deviation of a good centroid and of the outline together, px."""


class LightsParams(Params):
    """Parameters of `lights`."""

    stage_radius_mm: float = Field(790.0, gt=0, description="radius of the sphere that the lights are mounted on")
    stage_sigma_mm: float = Field(3.0, gt=0, description="how well that radius is known")
    placement_sigma_mm: float = Field(5.0, gt=0, description="how far a light may be off its place")
    layout: str = Field("auto", pattern="auto|none|[1-9][0-9]*", description="frequency of the geodesic sphere")
    driven_from: Literal["ideal", "measured"] = Field(
        "ideal", description="where the rig's gradient weights were made from: the layout, or measured positions"
    )


def lights(
    raw: Sequence[NDArray[np.uint16]],
    at_px: Sequence[Floats],
    flux: Sequence[Floats],
    peak: Sequence[Floats],
    width_px: Sequence[Floats],
    saturated_px: Sequence[Floats],
    noise: Sequence[Floats],
    ring: Sequence[Floats],
    *,
    place: Sequence[Sequence[int]],
    camera: Mapping[str, Any] | None,
    ball_radius_mm: float | None,
    mask: NDArray[np.bool_] | None,
    layout_vectors: Floats | None,
    stage_radius_mm: float = 790.0,
    stage_sigma_mm: float = 3.0,
    placement_sigma_mm: float = 5.0,
) -> Mapping[str, Any]:
    """All lights together.

    Args:
        raw: the one-light pictures (y, x), counts, in the order of `place`.
        at_px, flux, peak, width_px, saturated_px, noise: of `highlights`, one a picture.
        ring: of `outline`, one a place of the ball.
        place: per picture (place of the ball, row of the light).
        camera: K, distortion, world_to_camera; None: orthographic.
        ball_radius_mm: None only for an orthographic camera.
        mask: (y, x), where the ball is.
        layout_vectors: (light, xyz) unit places of the layout; None when there is no layout.

    Returns:
        by light, in the order of their numbers; see the declaration. NaN where not known.

    Raises:
        StageError: too few highlights, or they do not fit the layout.
    """
    balls = 1 + max(ball for ball, _ in place)
    count = 1 + max(row for _, row in place)
    status = np.full((balls, count), STATUS.index("missing"), np.int64)
    at, sigma = np.full((balls, count, 2), np.nan), np.full((balls, count), np.nan)
    power = np.full((balls, count), np.nan)
    first_peak = np.array([p[0] for p in peak])
    shown = first_peak[np.isfinite(first_peak)]
    if shown.size < 4:
        raise StageError(
            f"{shown.size} of {len(place)} pictures show a highlight; check the outline, and that one light is on "
            "in each picture"
        )
    floor = _LEAST_PART * float(np.median(shown))
    for i, (ball, row) in enumerate(place):
        outline = ring[ball]
        radius = float(np.sqrt(np.prod(np.ptp(outline, axis=0)))) / 2
        kind = _status(at_px[i], flux[i], peak[i], width_px[i], saturated_px[i], outline, radius, floor)
        status[ball, row] = STATUS.index(kind)
        if kind in ("seen", "cut"):
            at[ball, row], power[ball, row] = at_px[i][0], flux[i][0]
            spread = 0.1 * width_px[i][0] if saturated_px[i][0] > 3 else float(noise[i]) / peak[i][0]
            sigma[ball, row] = np.hypot(_PIXEL, spread)
            if kind == "cut":
                sigma[ball, row] = np.hypot(sigma[ball, row], 0.25 * width_px[i][0])
    lens: dict[str, Any] = {
        "intrinsics": None if camera is None else np.asarray(camera["K"], float),
        "distortion": None if camera is None else np.asarray(camera["distortion"], float),
    }
    outlines = []
    for ball in range(balls):
        pictures = [raw[i] for i, (b, _) in enumerate(place) if b == ball]
        mean = np.zeros(pictures[0].shape, np.float64)
        for picture in pictures:
            mean += picture
        try:
            outlines.append(_nearby(find_outline(mean / len(pictures), mask=mask, **lens), ring[ball], lens))
        except KernelError:
            outlines.append(_kept(ring[ball], lens))  # the one-light pictures may show no outline at all
    out: dict[str, Any] = {
        "at_px": at,
        "flux": power,
        "status": status,
        "position_mm": np.full((count, 3), np.nan),
        "direction": np.full((count, 3), np.nan),
        "sigma_mm": np.full(count, np.nan),
        "residual_mm": np.full(count, np.nan),
        "layout_place": np.full(count, -1, np.int64),
        "drive_position": np.full((count, 3), np.nan),
        "ball_mm": np.full((balls, 3), np.nan),
        "outline": np.stack([o.ring_px for o in outlines]),
        "turn": np.full((3, 3), np.nan),
        "stage_mm": np.full(4, np.nan),
        "off_place": np.zeros(count, np.bool_),
        "renumbered": np.array(False),
    }
    if camera is None or ball_radius_mm is None:
        ball = outlines[0]
        direction = orthographic_directions(at[0], ball.centre_px, ball.radius_px)
        return {**out, "direction": direction}
    centres = np.stack([sphere_centre(o.conic, lens["intrinsics"], ball_radius_mm) for o in outlines])
    shape = (raw[0].shape[0], raw[0].shape[1])
    eye = Pinhole.of({**camera, "size_px": shape[::-1]}, shape)
    if layout_vectors is None:
        return {**out, **_without_layout(at, sigma, centres, ball_radius_mm, eye)}
    highlights, spheres = Highlights(at, sigma), Balls(centres, ball_radius_mm)
    layout = Layout(layout_vectors, stage_radius_mm, stage_sigma_mm, placement_sigma_mm=placement_sigma_mm)
    found = refine(highlights, spheres, eye, layout)
    order = renumbered(found.place, layout_vectors)
    if order is not None:
        layout_vectors = layout_vectors[order]
        found = refine(highlights, spheres, eye, layout._replace(places=layout_vectors))
    off_place = np.zeros(count, np.bool_)
    off_place[[k for f in found.findings if f.kind == "off its place" for k in f.lights]] = True
    unit = found.position_mm / np.linalg.norm(found.position_mm, axis=1, keepdims=True)
    at_home = np.where(found.place[:, None] >= 0, layout_vectors[np.maximum(found.place, 0)], np.nan)
    return {
        **out,
        "position_mm": found.position_mm,
        "direction": unit,
        "sigma_mm": found.sigma_mm,
        "residual_mm": found.residual_mm,
        "layout_place": found.place,
        # driven as the controller believes: by its own number, wherever it turned out to be
        "drive_position": layout_vectors[:count] if count <= len(layout_vectors) else at_home,
        "off_place": off_place,
        "renumbered": np.array(order is not None),
        "ball_mm": found.ball_mm,
        "turn": found.turn,
        "stage_mm": np.array([*found.centre_mm, found.radius_mm]),
    }


def _without_layout(
    at: Floats, sigma: Floats, centres: Floats, ball_radius_mm: float, eye: Pinhole
) -> Mapping[str, Floats]:
    """Directions of the rays; with several places of the ball, positions where they meet."""
    rays = [
        to_world(*light_rays(a, c, ball_radius_mm, eye.matrix, distortion=eye.lens), eye.rotation, eye.translation)
        for a, c in zip(at, centres, strict=True)
    ]
    points, directions = (np.stack(part) for part in zip(*rays, strict=True))
    spread = np.stack(
        [
            ray_sigma(a, s, c, ball_radius_mm, eye.matrix, distortion=eye.lens)
            for a, s, c in zip(at, sigma, centres, strict=True)
        ]
    )
    shown = np.isfinite(directions[..., 0])
    total = np.where(shown[..., None], directions, 0).sum(axis=0)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    found = {"direction": np.where(length > 0, total / np.maximum(length, 1e-12), np.nan), "ball_mm": centres}
    if len(at) > 1:
        found["position_mm"], found["sigma_mm"] = triangulate(points, directions, spread)
    return found


def renumbered(place: NDArray[np.int64], layout: Floats) -> NDArray[np.int64] | None:
    """The layout's rows in the rig's own order, where it counts a ring of lights from another start; else None.

    All lights of one height shifted alike are a way to number, not a row of wiring faults.
    """
    order = np.arange(len(layout))
    height = np.round(layout[:, 1], 6)
    for level in np.unique(height):
        ring = np.flatnonzero(height == level)
        seen = [k for k in ring if k < len(place) and place[k] >= 0]
        shifts = {int((np.flatnonzero(ring == place[k])[0] - i) % ring.size) if place[k] in ring else -1
                  for i, k in enumerate(ring) if k in seen}  # fmt: skip
        if len(seen) >= 4 and len(seen) > ring.size / 2 and len(shifts) == 1 and -1 not in shifts:
            order[ring] = np.roll(ring, -shifts.pop())
    return order if (order != np.arange(len(layout))).any() else None


def _status(
    at: Floats, flux: Floats, peak: Floats, width: Floats, saturated: Floats, outline: Floats, radius: float,
    floor: float,
) -> str:  # fmt: skip
    if not peak[0] > floor:
        return "dark"
    if 2 * np.sqrt(saturated[0] / np.pi) > _SATURATED_PART * radius:
        return "saturated"
    if peak[1] > floor and min(flux[1] / flux[0], peak[1] / peak[0]) > _DOUBLE_PART:
        return "double"
    x, y = (float(v) for v in at[0])
    rim = float(cv2.pointPolygonTest(outline.astype(np.float32)[:, None], (x, y), True))
    return "cut" if rim < max(2.0, 2 * width[0]) else "seen"


def _nearby(found: Any, ring: Floats, lens: Mapping[str, Any]) -> Any:
    """The outline of the mean picture, unless it is another thing than that under all lights."""
    size = float(np.sqrt(np.prod(np.ptp(ring, axis=0)))) / 2
    off = np.linalg.norm(found.ring_px.mean(axis=0) - ring.mean(axis=0))
    return found if off + abs(found.radius_px - size) < 0.03 * size else _kept(ring, lens)


def _kept(ring: Floats, lens: Mapping[str, Any]) -> Any:
    from lightstage.kernels.targets.ball_conic import outline_of_points

    return outline_of_points(ring[::6], **lens)


def layout_of(count: int, frequency: str) -> Floats | None:
    """The geodesic layout of so many lights: all vertices, or all but the lowest; None when there is none.

    Raises:
        StageError: the frequency asked for has another number of lights.
    """
    if frequency == "none":
        return None
    tried = range(1, 17) if frequency == "auto" else [int(frequency)]
    for f in tried:
        vertices = 10 * f * f + 2
        if count == vertices - 1:
            return light_positions(f)
        if count == vertices:
            return light_positions(f, left_out=())
    if frequency == "auto":
        return None
    have = 10 * int(frequency) ** 2 + 2
    raise StageError(
        f"layout: {frequency} has {have - 1} or {have} lights, the capture names {count}; a missing picture "
        "must be named as a frame, too"
    )


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: LightsParams) -> Arrangement:
    raw, _, outline = grids
    need_target(facts, "mirror_ball", "measuring lights")
    camera = reference(raw)
    names = list(raw.along("illumination"))
    numbers = light_numbers(names)
    if not numbers:
        raise StageError("measuring lights needs pictures under one light each (L00, L01, ...); there is none")
    part = parts(facts, len(names))
    places = list(outline.along("part"))
    frames = frames_of(raw, "L")
    seen: dict[tuple[int, str], int] = {}
    for i in frames:
        if (part[i], names[i]) in seen:
            raise StageError(f"{names[i]} has two pictures (frames {seen[part[i], names[i]]} and {i}); keep one")
        seen[part[i], names[i]] = i
    gaps = sorted(set(range(numbers[-1] + 1)) - set(numbers))
    near = "direction" if len(numbers) < 4 else "position"
    if gaps:
        raise StageError(
            f"the picture of L{gaps[0]:02d} is missing" + (f" and {len(gaps) - 1} more" if gaps[1:] else "")
            + f" (L00 to L{numbers[-1]:02d} are named); capture it, or its {near} stays unknown"
        )  # fmt: skip
    layout = layout_of(len(numbers), params.layout)
    if layout is None and params.layout == "auto" and len(numbers) > 12:
        short = min((10 * f * f + 1 for f in range(1, 17)), key=lambda n: abs(n - len(numbers)))
        raise StageError(
            f"{len(numbers)} lights are named; a geodesic stage has {short} (or {short + 1}): a picture is "
            "missing, or set layout: none for directions alone"
        )
    pieces: dict[str, list[dict[str, int]]] = {
        "raw": [{"frame": i, "band": 0, "polarisation": camera} for i in frames]
    }
    for name in ("at_px", "flux", "peak", "width_px", "saturated_px", "noise"):
        pieces[name] = [{"frame": i} for i in frames]
    pieces["ring"] = [{"part": i} for i in range(len(places))]
    told = {
        "place": [[places.index(part[i]), numbers.index(int(names[i][1:]))] for i in frames],
        "count": len(numbers),
    }
    sizes = {
        "all": 1, "light": len(numbers), "part": len(places), "xyz": 3, "xy": 2, "point": 720, "row": 3,
        "column": 3, "value": 4,
    }  # fmt: skip
    labels: dict[str, Any] = {
        "light": (("light",), [f"L{n:02d}" for n in numbers]),
        "xyz": (("xyz",), list("xyz")),
    }
    return Arrangement(Grid(sizes, labels), (Group(pieces, told),))


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: LightsParams
) -> Mapping[str, Any]:
    camera = intrinsics(items, facts["shape"])
    return {
        "place": labels["place"],
        "count": labels["count"],
        "camera": camera,
        "ball_radius_mm": facts["target"].get("radius_mm"),
        "mask": facts["mask"],
    }


def _prepare(
    *, place: Any, count: int, camera: Any, ball_radius_mm: float | None, mask: Any, layout: str
) -> Mapping[str, Any]:
    if camera is not None and ball_radius_mm is None:
        raise StageError("the ball's size is not known; write target: {kind: mirror_ball, radius_mm: ...}")
    return {
        "place": place,
        "camera": camera,
        "ball_radius_mm": ball_radius_mm,
        "mask": None if mask is None else np.asarray(mask.load()) > 0,
        "layout_vectors": layout_of(count, layout),
    }


def _item(result: Result) -> Mapping[str, Any]:
    """The lights item."""
    driven_from = result.attrs["parameters"]["driven_from"]
    rows = []
    for k, name in enumerate(result.labels["light"]):
        row: dict[str, Any] = {"id": name, "channel": int(name[1:])}
        position, direction = result.arrays["position_mm"][k], result.arrays["direction"][k]
        if np.isfinite(position).all():
            row["position_mm"] = [round(float(v), 3) for v in position]
        elif np.isfinite(direction).all():
            row["direction"] = [round(float(v), 6) for v in direction]
        else:
            continue  # not seen, and nothing says where it is
        drive = result.arrays["drive_position"][k]
        if driven_from == "ideal" and np.isfinite(drive).all():
            row["drive_position"] = [round(float(v), 8) for v in drive]
        row |= {"power": 1.0, "seen": bool(_is_seen(result, k))}
        rows.append(row)
    return {"item": "lights", "drive": driven_from, "lights": rows}


def _is_seen(result: Result, k: int) -> bool:
    return any(STATUS[s] in ("seen", "cut") for s in result.arrays["status"][:, k])


def _verdict(result: Result) -> list[Finding]:
    """What a lab engineer should know, the worst first."""
    names = list(result.labels["light"])
    place, status = result.arrays["layout_place"], result.arrays["status"]
    findings: list[Finding] = []
    for k, name in enumerate(names):
        j = int(place[k])
        seen = _is_seen(result, k)
        words = {STATUS[s] for s in status[:, k]}
        if seen and 0 <= j < len(names) and place[j] == k and k < j:
            sentence = f"{name} and {names[j]} are swapped: each shows at the other's place (files or channels)"
            findings.append(Finding("bad", sentence))
        elif seen and j >= 0 and j != k and not (j < len(names) and place[j] == k):
            sentence = f"{name} shows at the place of L{j:02d}: wired to the wrong channel, or the wrong file"
            findings.append(Finding("bad", sentence))
        elif seen and j < 0 and np.isfinite(result.arrays["stage_mm"]).all():
            findings.append(Finding("bad", f"{name} shows at no place of the layout"))
        if result.arrays["off_place"][k]:
            findings.append(
                Finding("doubtful", f"{name} is {result.arrays['residual_mm'][k]:.0f} mm off its place")
            )
        if not seen:
            where = "placed by symmetry" if np.isfinite(result.arrays["position_mm"][k]).all() else "left out"
            why = {
                "dark": "not seen (hidden by the stand, dead, or not connected)",
                "saturated": "saturated over too large an area: expose it less",
                "double": "seen twice: two lights are on in its picture",
                "missing": "without a picture",
            }[next((w for w in ("saturated", "double", "dark") if w in words), "missing")]
            findings.append(Finding("doubtful", f"{name} {why}, {where}"))
        elif "cut" in words and "seen" not in words:
            sentence = f"{name} is cut by the ball's outline, so its direction is less certain"
            findings.append(Finding("doubtful", sentence))
    if result.arrays["renumbered"]:
        sentence = "the rig counts a ring of lights from another start than the layout: its own numbering is used"
        findings.append(Finding("good", sentence))
    radius = result.arrays["stage_mm"]
    if np.isfinite(radius).all():
        residual = result.arrays["residual_mm"]
        sentence = (
            f"{int(np.isfinite(residual).sum())} of {len(names)} lights fit the layout to "
            f"{float(np.nanmedian(residual)):.1f} mm (median); stage radius {radius[3]:.1f} mm"
        )
    else:
        sentence = f"directions of {sum(_is_seen(result, k) for k in range(len(names)))} lights, without a layout"
    return [*findings, Finding("good", sentence)]


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
        "status": Output(("all", "part", "light"), "int64", ("part", "light"), {"meanings": " ".join(STATUS)}),
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
    prepare=_prepare,
    prepared=("place", "camera", "ball_radius_mm", "mask", "layout_vectors"),
    kernel=lights,
    item=_item,
    verdict=_verdict,
)

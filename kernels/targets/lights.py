"""Where every light of a stage is, from highlights on a mirror ball: the kernel of `stages/calibration/lights.py`.

Which highlights count is told by how bright all are; each that does gives a ray (`light_rays.py`), and all together
are fitted to the layout (`light_positions.py`). The ball's outline is measured anew on the mean of all one-light
pictures, which has less noise than any one.

Sources: Dutta (2010) 3.1.2, and those of the modules.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.hw.geodesic import light_positions
from lightstage.hw.illuminations import light_name, light_number
from lightstage.kernels.errors import KernelError
from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.kernels.targets.ball_conic import Floats, Outline, outline_of_points, sphere_centre
from lightstage.kernels.targets.ball_outline import find_outline
from lightstage.kernels.targets.highlights import FEW_SATURATED_PX
from lightstage.kernels.targets.item_pictures import mask_of
from lightstage.kernels.targets.labels import LIGHT_STATUS
from lightstage.kernels.targets.light_positions import Balls, Highlights, Layout, refine
from lightstage.kernels.targets.light_rays import (
    light_rays,
    orthographic_directions,
    ray_sigma,
    to_world,
    triangulate,
)
from lightstage.kernels.targets.outline import Lens, ring_radius_px
from lightstage.kernels.targets.verdicts import Verdict

PictureName = tuple[int, int]
"""A one-light picture: place of the ball, number of the light."""

_LEAST_LIGHTS = 4
"""Fewer highlights say nothing of how bright one should be."""
_LEAST_PART = 0.05
"""Of the median peak: what is darker is no highlight."""
_DOUBLE_PART = 0.25
"""Of the first spot's flux and peak: from here a second one is a light of its own."""
_SATURATED_PART = 0.15
"""Of the ball's radius: a saturated spot of this diameter says too little of where its middle is."""
_PIXEL = 0.1
"""Standard deviation of a good centroid and of the outline together, px."""
_SATURATED_SIGMA, _CUT_SIGMA = 0.1, 0.25
"""How far off the middle of a saturated spot, and of one at the rim, may be, of its width."""
_LEAST_RIM_PX, _RIM_WIDTHS = 2.0, 2.0
"""A spot nearer to the outline, in pixels or in its own widths, is cut by it."""
_MOVED_PART = 0.03
"""Of the radius: an outline of the mean picture that is off by more is another thing than the ball."""
_EVERY_RING_POINT = 6
"""Enough for an outline that is known already: a point each three degrees."""


class Spots(NamedTuple):
    """What one picture shows within the ball: by spot, the strongest first, NaN where there is none."""

    at_px: Floats
    """(spot, xy)."""
    flux: Floats
    peak: Floats
    width_px: Floats
    saturated_px: Floats
    noise: float
    """Counts."""


class Sightings(NamedTuple):
    """All lights as the ball shows them, at each of its places."""

    status: NDArray[np.int64]
    """(place, light): index into LIGHT_STATUS."""
    highlights: Highlights
    """NaN where one does not count."""
    flux: Floats
    """(place, light), counts."""


class Ball(NamedTuple):
    """What is known before of the ball and of the camera that sees it."""

    camera: Pinhole | None
    """None: orthographic."""
    radius_mm: float | None
    """None only for an orthographic camera."""
    mask: NDArray[np.bool_] | None
    """(y, x), where the ball is."""

    @property
    def lens(self) -> Lens:
        """Of the camera."""
        return Lens() if self.camera is None else Lens(self.camera.matrix, self.camera.lens)


def lights(
    raw: Mapping[PictureName, NDArray[np.uint16]],
    at_px: Mapping[PictureName, Floats],
    flux: Mapping[PictureName, Floats],
    peak: Mapping[PictureName, Floats],
    width_px: Mapping[PictureName, Floats],
    saturated_px: Mapping[PictureName, Floats],
    noise: Mapping[PictureName, Floats],
    ring: Mapping[int, Floats],
    *,
    ball: Ball,
    layout: Layout | None,
) -> Mapping[str, Any]:
    """All lights together.

    Args:
        raw: the one-light pictures (y, x), counts.
        at_px, flux, peak, width_px, saturated_px, noise: of `highlights`, of the same pictures.
        ring: of `outline`, by place of the ball.
        ball: what is known of it.
        layout: what the lights were built to; None when there is none.

    Returns:
        by light, in the order of their numbers; see the declaration. NaN where not known.

    Raises:
        KernelError: too few highlights, or they do not fit the layout.
    """
    pictures = {
        name: Spots(at_px[name], flux[name], peak[name], width_px[name], saturated_px[name], float(noise[name]))
        for name in raw
    }
    seen = sightings(pictures, ring)
    outlines = [_measured_outline(raw, place, ring[place], ball) for place in ring]
    places, count = seen.status.shape
    out: dict[str, Any] = {
        "at_px": seen.highlights.at_px,
        "flux": seen.flux,
        "status": seen.status,
        "position_mm": np.full((count, 3), np.nan),
        "direction": np.full((count, 3), np.nan),
        "sigma_mm": np.full(count, np.nan),
        "residual_mm": np.full(count, np.nan),
        "layout_place": np.full(count, -1, np.int64),
        "drive_position": np.full((count, 3), np.nan),
        "ball_mm": np.full((places, 3), np.nan),
        "outline": np.stack([outline.ring_px for outline in outlines]),
        "turn": np.full((3, 3), np.nan),
        "stage_mm": np.full(4, np.nan),
        "off_place": np.zeros(count, np.bool_),
        "renumbered": np.array(False),
    }
    if ball.camera is None or ball.radius_mm is None:
        first = outlines[0]
        directions = orthographic_directions(seen.highlights.at_px[0], first.centre_px, first.radius_px)
        return {**out, "direction": directions}
    centres = [sphere_centre(outline.conic, ball.camera.matrix, ball.radius_mm) for outline in outlines]
    balls = Balls(np.stack(centres), ball.radius_mm)
    if layout is None:
        return {**out, **_without_layout(seen.highlights, balls, ball.camera)}
    return {**out, **_on_layout(seen.highlights, balls, ball.camera, layout)}


def prepare(
    *,
    camera: Mapping[str, Any] | None,
    ball_radius_mm: float | None,
    mask: Any,
    geodesic: Mapping[str, Any] | None,
    stage_radius_mm: float,
    stage_sigma_mm: float,
    placement_sigma_mm: float,
) -> Mapping[str, Any]:
    """The context in numbers; `geodesic` names the layout: its `frequency`, and whether it is `whole`."""
    eye = None
    if camera is not None:
        columns, rows = camera["size_px"]
        eye = Pinhole.of(camera, (rows, columns))
    layout = None
    if geodesic is not None:
        places = light_positions(geodesic["frequency"], left_out=() if geodesic["whole"] else None)
        layout = Layout(places, stage_radius_mm, stage_sigma_mm, placement_sigma_mm=placement_sigma_mm)
    return {"ball": Ball(eye, ball_radius_mm, mask_of(mask)), "layout": layout}


def sightings(pictures: Mapping[PictureName, Spots], ring: Mapping[int, Floats]) -> Sightings:
    """Which highlights count, and how well they are placed.

    Args:
        pictures: by place of the ball and number of the light.
        ring: (point, xy) by place of the ball: its outline.

    Raises:
        KernelError: too few pictures show a spots.
    """
    places, numbers = list(ring), sorted({number for _, number in pictures})
    size = (len(places), len(numbers))
    status = np.full(size, LIGHT_STATUS.index("missing"), np.int64)
    at, sigma, power = np.full((*size, 2), np.nan), np.full(size, np.nan), np.full(size, np.nan)
    peaks = np.array([spots.peak[0] for spots in pictures.values()])
    shown = peaks[np.isfinite(peaks)]
    if shown.size < _LEAST_LIGHTS:
        raise KernelError(
            f"{shown.size} of {len(pictures)} pictures show a highlight; check the outline, and that one light "
            "is on in each picture"
        )
    floor = _LEAST_PART * float(np.median(shown))
    for (place, number), spots in pictures.items():
        cell = places.index(place), numbers.index(number)
        kind = _status(spots, ring[place], floor)
        status[cell] = LIGHT_STATUS.index(kind)
        if kind in ("seen", "cut"):
            at[cell], power[cell], sigma[cell] = spots.at_px[0], spots.flux[0], _sigma_px(spots, kind)
    return Sightings(status, Highlights(at, sigma), power)


def _status(spots: Spots, ring: Floats, floor: float) -> str:
    """What a picture shows of its light; `floor` is the least peak of a highlight, counts."""
    flux, peak = spots.flux, spots.peak
    if not peak[0] > floor:
        return "dark"
    if 2 * np.sqrt(spots.saturated_px[0] / np.pi) > _SATURATED_PART * ring_radius_px(ring):
        return "saturated"
    if peak[1] > floor and min(flux[1] / flux[0], peak[1] / peak[0]) > _DOUBLE_PART:
        return "double"
    x, y = (float(v) for v in spots.at_px[0])
    rim = float(cv2.pointPolygonTest(ring.astype(np.float32)[:, None], (x, y), True))
    return "cut" if rim < max(_LEAST_RIM_PX, _RIM_WIDTHS * spots.width_px[0]) else "seen"


def _sigma_px(spots: Spots, kind: str) -> Any:
    """Standard deviation of a highlight's place, px."""
    width = spots.width_px[0]
    saturated = spots.saturated_px[0] > FEW_SATURATED_PX
    spread = _SATURATED_SIGMA * width if saturated else spots.noise / spots.peak[0]
    sigma = np.hypot(_PIXEL, spread)
    return np.hypot(sigma, _CUT_SIGMA * width) if kind == "cut" else sigma


def _measured_outline(
    raw: Mapping[PictureName, NDArray[np.uint16]], place: int, ring: Floats, ball: Ball
) -> Outline:
    """The outline of the mean of one place's pictures, unless it is another thing than that under all lights."""
    names = [name for name in raw if name[0] == place]
    total = raw[names[0]].astype(np.float64)
    for name in names[1:]:
        total += raw[name]
    lens = ball.lens._asdict()
    size = ring_radius_px(ring)
    try:
        outline = find_outline(total / len(names), mask=ball.mask, **lens)
        off = np.linalg.norm(outline.ring_px.mean(axis=0) - ring.mean(axis=0))
        if off + abs(outline.radius_px - size) < _MOVED_PART * size:
            return outline
    except KernelError:
        pass  # the one-light pictures may show no outline at all
    return outline_of_points(ring[::_EVERY_RING_POINT], **lens)


def _without_layout(highlights: Highlights, balls: Balls, camera: Pinhole) -> Mapping[str, Floats]:
    """Directions of the rays; with several places of the ball, positions where they meet."""
    rays, spread = [], []
    for at, sigma, centre in zip(highlights.at_px, highlights.sigma_px, balls.centre_mm, strict=True):
        ray = light_rays(at, centre, balls.radius_mm, camera.matrix, distortion=camera.lens)
        rays.append(to_world(*ray, camera.rotation, camera.translation))
        spread.append(ray_sigma(at, sigma, centre, balls.radius_mm, camera.matrix, distortion=camera.lens))
    points, directions = (np.stack(part) for part in zip(*rays, strict=True))
    shown = np.isfinite(directions[..., 0])
    total = np.where(shown[..., None], directions, 0).sum(axis=0)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    out = {
        "direction": np.where(length > 0, total / np.maximum(length, 1e-12), np.nan),
        "ball_mm": balls.centre_mm,
    }
    if len(rays) > 1:
        out["position_mm"], out["sigma_mm"] = triangulate(points, directions, np.stack(spread))
    return out


def _on_layout(highlights: Highlights, balls: Balls, camera: Pinhole, layout: Layout) -> Mapping[str, Any]:
    """All lights fitted to the layout, in the rig's own numbering."""
    fit = refine(highlights, balls, camera, layout)
    order = renumbered(fit.place, layout.places)
    if order is not None:
        layout = layout._replace(places=layout.places[order])
        fit = refine(highlights, balls, camera, layout)
    count = len(fit.place)
    off_place = np.zeros(count, np.bool_)
    off_place[[k for finding in fit.findings if finding.kind == "off its place" for k in finding.lights]] = True
    at_home = np.where(fit.place[:, None] >= 0, layout.places[np.maximum(fit.place, 0)], np.nan)
    return {
        "position_mm": fit.position_mm,
        "direction": fit.position_mm / np.linalg.norm(fit.position_mm, axis=1, keepdims=True),
        "sigma_mm": fit.sigma_mm,
        "residual_mm": fit.residual_mm,
        "layout_place": fit.place,
        # driven as the controller believes: by its own number, wherever it turned out to be
        "drive_position": layout.places[:count] if count <= len(layout.places) else at_home,
        "off_place": off_place,
        "renumbered": np.array(order is not None),
        "ball_mm": fit.ball_mm,
        "turn": fit.turn,
        "stage_mm": np.array([*fit.centre_mm, fit.radius_mm]),
    }


def renumbered(place: NDArray[np.int64], layout: Floats) -> NDArray[np.int64] | None:
    """The layout's rows in the rig's own order, where it counts a ring of lights from another start; else None.

    All lights of one height shifted alike are a way to number, not a row of wiring faults.

    Args:
        place: (light): row of the layout where it shows; -1 where unknown.
        layout: (light, xyz), unit.
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


def item(*, arrays: Mapping[str, Any], labels: Mapping[str, Any], attrs: Mapping[str, Any]) -> Mapping[str, Any]:
    """The lights item."""
    driven_from = attrs["parameters"]["driven_from"]
    rows = []
    for k, name in enumerate(labels["light"]):
        row: dict[str, Any] = {"id": name, "channel": light_number(name)}
        position, direction = arrays["position_mm"][k], arrays["direction"][k]
        if np.isfinite(position).all():
            row["position_mm"] = [round(float(v), 3) for v in position]
        elif np.isfinite(direction).all():
            row["direction"] = [round(float(v), 6) for v in direction]
        else:
            continue  # not seen, and nothing says where it is
        drive = arrays["drive_position"][k]
        if driven_from == "ideal" and np.isfinite(drive).all():
            row["drive_position"] = [round(float(v), 8) for v in drive]
        row |= {"power": 1.0, "seen": _is_seen(arrays, k)}
        rows.append(row)
    return {"item": "lights", "drive": driven_from, "lights": rows}


def verdict(*, arrays: Mapping[str, Any], labels: Mapping[str, Any]) -> Verdict:
    """Light by light what somebody should look at, then how well all fit."""
    names = list(labels["light"])
    findings: Verdict = []
    for k in range(len(names)):
        findings += _wiring(arrays, names, k) + _visibility(arrays, names, k)
    if arrays["renumbered"]:
        sentence = "the rig counts a ring of lights from another start than the layout: its own numbering is used"
        findings.append(("good", sentence))
    stage = arrays["stage_mm"]
    if np.isfinite(stage).all():
        residual = arrays["residual_mm"]
        sentence = (
            f"{int(np.isfinite(residual).sum())} of {len(names)} lights fit the layout to "
            f"{float(np.nanmedian(residual)):.1f} mm (median); stage radius {stage[3]:.1f} mm"
        )
    else:
        sentence = f"directions of {sum(_is_seen(arrays, k) for k in range(len(names)))} lights, without a layout"
    return [*findings, ("good", sentence)]


def _is_seen(arrays: Mapping[str, Any], k: int) -> bool:
    return any(LIGHT_STATUS[status] in ("seen", "cut") for status in arrays["status"][:, k])


def _wiring(arrays: Mapping[str, Any], names: list[str], k: int) -> Verdict:
    """Whether a light that is seen shows where it should."""
    findings: Verdict = []
    place = arrays["layout_place"]
    j = int(place[k])
    if _is_seen(arrays, k):
        exchanged = 0 <= j < len(names) and place[j] == k
        if exchanged and k < j:
            sentence = f"{names[k]} and {names[j]} are swapped: each shows at the other's place (files or channels)"
            findings.append(("bad", sentence))
        elif j >= 0 and j != k and not exchanged:
            where = f"{names[k]} shows at the place of {light_name(j)}"
            findings.append(("bad", f"{where}: wired to the wrong channel, or the wrong file"))
        elif j < 0 and np.isfinite(arrays["stage_mm"]).all():
            findings.append(("bad", f"{names[k]} shows at no place of the layout"))
    if arrays["off_place"][k]:
        findings.append(("doubtful", f"{names[k]} is {arrays['residual_mm'][k]:.0f} mm off its place"))
    return findings


_UNSEEN = {
    "saturated": "saturated over too large an area: expose it less",
    "double": "seen twice: two lights are on in its picture",
    "dark": "not seen (hidden by the stand, dead, or not connected)",
    "missing": "without a picture",
}
"""Why a light is not seen, the most certain reason first."""


def _visibility(arrays: Mapping[str, Any], names: list[str], k: int) -> Verdict:
    """Whether and how well a light is seen."""
    kinds = {LIGHT_STATUS[status] for status in arrays["status"][:, k]}
    if not _is_seen(arrays, k):
        where = "placed by symmetry" if np.isfinite(arrays["position_mm"][k]).all() else "left out"
        return [("doubtful", f"{names[k]} {next(why for kind, why in _UNSEEN.items() if kind in kinds)}, {where}")]
    if "cut" in kinds and "seen" not in kinds:
        return [("doubtful", f"{names[k]} is cut by the ball's outline, so its direction is less certain")]
    return []

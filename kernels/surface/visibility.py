"""Which lights each point sees: shadows cast through a depth map.

A ray from the point to the light is marched through the picture; where it runs behind the surface, and in
front of that surface's back, it is blocked. Three things that a depth map does not hold are made up, each
from the picture itself:

- the back of the body: as far behind the rim of its row as the front is before it (right for a sphere and for
  a cylinder), so that light passes behind a head;
- the body below the picture, where the mask touches the lower edge: the profile of the lowest row goes on, and
  its outline goes on widening as it did, ever less (`WIDENING_MM`); otherwise lights from below would shine
  through the shoulders;
- a soft edge: between one and two times `slack_mm` behind the surface a ray fades out, because the depth is an
  estimate.
"""

import itertools
import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lightstage.kernels.surface.pinhole import Pinhole

Array = NDArray[np.float64]

WIDENING_MM = 60.0
"""The outline below the picture widens by its slope at the edge times this, at most: shoulders end."""
_BELOW_MM = 200.0
_SLOPE_MM = 15.0
"""The slope of the outline is taken over the last rows of this height."""
_THINNEST_MM = 20.0
_REACH_MM = 400.0
_FIRST_STEP_PX, _GROWTH = 0.9, 1 / 40
"""Steps grow with the way: far occluders are large."""


def visible(
    points: Array, depth: Array, camera: Pinhole, lights: Array, *, slack_mm: float = 1.0
) -> NDArray[np.float32]:
    """How much of each light each point sees.

    Args:
        points: (point, xyz) world, mm.
        depth: (y, x) camera z in mm, NaN where there is no surface.
        camera: of the depth map.
        lights: (light, xyz) world, mm.
        slack_mm: how far behind the surface a ray still counts as before it.

    Returns:
        (point, light) from 0 to 1.
    """
    pixel_mm = float(np.nanmedian(depth)) / camera.focal
    front, left = _continued(depth, pixel_mm)
    back = _backs(front)
    out = np.empty((len(points), len(lights)), np.float32)
    seen_from = camera.to_camera(points)
    lamps = camera.to_camera(lights)
    fx, fy, cx, cy = camera.intrinsics
    lens = _Lens(fx, fy, cx + left, cy, camera.distortion, any(camera.distortion))
    body = _Body(front.astype(np.float32), back.astype(np.float32), slack_mm)
    step = _FIRST_STEP_PX * pixel_mm

    def work(part: slice) -> None:
        _march(body, lens, seen_from[part], lamps, step, out[part])

    in_parts(work, len(points))
    return out


def in_parts(work: Any, count: int) -> None:
    """Call `work` with slices that cover `count`, on as many threads as there are processors."""
    threads = len(os.sched_getaffinity(0))
    edges = np.linspace(0, count, 4 * threads + 1).astype(int)
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, [slice(a, b) for a, b in itertools.pairwise(edges) if b > a]))


def _continued(depth: Array, pixel_mm: float) -> tuple[Array, int]:
    """The depth map with the body below the picture, and how many columns were added on the left."""
    height, width = depth.shape
    rows = np.flatnonzero(np.isfinite(depth[-1]))
    if rows.size < 8:
        return depth, 0
    fit = max(4, int(_SLOPE_MM / pixel_mm))
    above = np.flatnonzero(np.isfinite(depth[max(0, height - 1 - fit)]))
    reach = WIDENING_MM / pixel_mm
    # an outline that the side of the picture cuts says nothing of its slope
    slopes = [0.0, 0.0]
    if above.size:
        if rows[0] > 0:
            slopes[0] = min(0.0, (rows[0] - above[0]) / fit)
        if rows[-1] < width - 1:
            slopes[1] = max(0.0, (rows[-1] - above[-1]) / fit)
    added, side = int(_BELOW_MM / pixel_mm), min(3 * width, int(np.ceil(max(-slopes[0], slopes[1]) * reach)))
    out = np.full((height + added, width + 2 * side), np.nan)
    out[:height, side : side + width] = depth
    place = (rows - rows[0]) / (rows[-1] - rows[0])
    for i in range(1, added + 1):
        widened = reach * (1 - np.exp(-i / reach))
        first, last = rows[0] + slopes[0] * widened + side, rows[-1] + slopes[1] * widened + side
        columns = np.arange(int(np.ceil(first)), int(last) + 1)
        columns = columns[(columns >= 0) & (columns < out.shape[1])]
        out[height - 1 + i, columns] = np.interp((columns - first) / (last - first), place, depth[-1, rows])
    return out, side


def _backs(front: Array) -> Array:
    """Depth at which each column of the body ends: as far behind the rim of its row as the front is before it."""
    out = np.full(front.shape, np.nan)
    for i in np.flatnonzero(np.isfinite(front).any(axis=1)):
        columns = np.flatnonzero(np.isfinite(front[i]))
        rim = max(front[i, columns[:3]].max(), front[i, columns[-3:]].max())
        out[i, columns] = np.maximum(2 * rim - front[i, columns], front[i, columns] + _THINNEST_MM)
    return out


class _Body(NamedTuple):
    """What blocks light."""

    front: NDArray[np.float32]
    """(y, x) camera z, mm; NaN where there is nothing."""
    back: NDArray[np.float32]
    slack_mm: float


class _Lens(NamedTuple):
    """Where a point of the camera's frame shows in the maps of a body; a skew of the image is neglected."""

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float]
    bent: bool
    """Whether there is any."""


@njit(nogil=True, cache=True)
def _march(body: Any, lens: Any, points: Any, lights: Any, step: float, out: Any) -> None:
    front, back, slack = body.front, body.back, body.slack_mm
    height, width = front.shape
    fx, fy, cx, cy, bent = lens.fx, lens.fy, lens.cx, lens.cy, lens.bent
    k1, k2, p1, p2, k3 = lens.distortion
    for i in range(points.shape[0]):
        px, py, pz = points[i]
        for k in range(lights.shape[0]):
            dx, dy, dz = lights[k, 0] - px, lights[k, 1] - py, lights[k, 2] - pz
            length = np.sqrt(dx * dx + dy * dy + dz * dz)
            dx, dy, dz = dx / length, dy / length, dz / length
            seen = 1.0
            way = 1.5 * step
            end = min(_REACH_MM, length)
            while way < end:
                z = pz + way * dz
                if z <= 0:
                    break
                x, y = (px + way * dx) / z, (py + way * dy) / z
                if bent:
                    r2 = x * x + y * y
                    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
                    x, y = (
                        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
                    )
                u, v = fx * x + cx, fy * y + cy
                if u < 0 or v < 0 or u > width - 1 or v > height - 1:
                    break
                column, row = min(int(u), width - 2), min(int(v), height - 2)
                a, b = u - column, v - row
                surface = (front[row, column] * (1 - a) + front[row, column + 1] * a) * (1 - b) + (
                    front[row + 1, column] * (1 - a) + front[row + 1, column + 1] * a
                ) * b
                behind = z - surface
                if behind > slack and z < back[row, column]:  # not so for NaN
                    seen = min(seen, 2 - behind / slack)
                    if seen <= 0:
                        seen = 0.0
                        break
                way += step + way * _GROWTH
            out[i, k] = seen

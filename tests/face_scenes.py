"""Heads of the virtual rig in the frame of stimuli, with places that are known on each.

A head is a union of ellipsoids, so its parts have names: the front of an eye's ellipsoid is the eye on every head.
And a bent head (`hw.head`) is the same material elsewhere, so every pixel of it is known on the head at rest.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.hw import head
from lightstage.kernels.faces.face_frame import Frame, bring, similarity, turned
from lightstage.kernels.motion.flow_warp import unit

Array = NDArray[Any]
PARTS = {
    "left eye": 15,
    "right eye": 16,
    "bridge of the nose": 6,
    "tip of the nose": 7,
    "left wing of the nose": 8,
    "right wing of the nose": 9,
    "upper lip": 10,
    "lower lip": 11,
    "chin": 2,
}
"""Ellipsoids whose front is a place that every head has."""
BENT = np.array(
    [
        [0, -60, 60, 60, 50, 60, 0, -7, 0],
        [0, -20, 80, 40, 40, 50, 4, 0, 0],
        [30, 10, 60, 45, 45, 50, 3, 3, 0],
        [-30, 10, 60, 45, 45, 50, -3, -2, 0],
    ],
    float,
)
"""A warp: the chin 7 mm down, the nose 4 mm aside, the eyes 3 to 4 mm outwards and up."""
_SIZE = 309, 406
_FOCAL_PX = 714.0
_CAMERA = np.array([0.0, 0.0, 890.0])


@dataclass(frozen=True)
class View:
    """A head as the camera sees it."""

    normal: Array
    """(xyz, y, x) float32, NaN off the head."""
    points: Array
    """(y, x, xyz) mm."""
    places: Array
    """(part, xy) pixels of PARTS."""


@dataclass(frozen=True)
class Framed:
    """A view brought to a frame by its true eyes."""

    normal: Array
    """(xyz, y, x), unit, finite."""
    places: Array
    """(part, xy)."""
    matrix: Array
    """(2, 3), frame -> picture."""


def project(points: Array) -> Array:
    """(..., xy) pixels of places (..., xyz) in mm."""
    towards = _CAMERA - points
    scaled = _FOCAL_PX * points[..., :2] / towards[..., 2:]
    return (np.array(_SIZE[::-1]) - 1) / 2 + scaled * (1, -1)


@cache
def view(seed: int, *, bent: bool = False) -> View:
    """The head of a seed (0 is the mean), at rest or bent by BENT."""
    shape = head.parts(seed)
    warp = BENT if bent else None
    y, x = np.mgrid[: _SIZE[0], : _SIZE[1]].astype(float)
    rays = np.stack([x - (_SIZE[1] - 1) / 2, (_SIZE[0] - 1) / 2 - y, np.full(_SIZE, -_FOCAL_PX)], axis=-1)
    rays = (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).reshape(-1, 3)
    field = head.bent_field(shape, head.coarse_field(shape), warp)
    distance, normal = head.surface(shape, field, warp, rays, _CAMERA)
    points = _CAMERA + distance[:, None] * rays
    normal[distance < 0] = points[distance < 0] = np.nan
    fronts = np.array([shape[row, :3] + (0, 0, shape[row, 5]) for row in PARTS.values()])
    return View(
        normal.reshape(*_SIZE, 3).transpose(2, 0, 1).astype(np.float32),
        points.reshape(*_SIZE, 3),
        project(head.place(fronts, warp)),
    )


def framed(seen: View, frame: Frame) -> Framed:
    """A view in the frame."""
    matrix = similarity(seen.places[:2], frame)
    normal, _ = bring(seen.normal, matrix, frame.shape)
    back = np.linalg.inv(np.vstack([matrix, [0, 0, 1]]))
    return Framed(turned(unit(normal), matrix), seen.places @ back[:2, :2].T + back[:2, 2], matrix)


def true_flow(frame: Frame) -> Array:
    """(xy, y, x): from the bent mean head to the one at rest, both in the frame; NaN off the bent head."""
    bent, rest = view(0, bent=True), view(0)
    material = head.material(np.nan_to_num(bent.points).reshape(-1, 3), BENT).reshape(bent.points.shape)
    there = project(material)
    there[np.isnan(bent.points[..., 0])] = np.nan
    to_rest = np.linalg.inv(np.vstack([framed(rest, frame).matrix, [0, 0, 1]]))[:2]
    landing = np.moveaxis(there @ to_rest[:, :2].T + to_rest[:, 2], 2, 0).astype(np.float32)
    brought, known = bring(landing, framed(bent, frame).matrix, frame.shape)
    y, x = np.mgrid[: frame.shape[0], : frame.shape[1]]
    return np.where(known, brought - np.stack([x, y]), np.nan)

"""A height map as triangles on its pixels, and the frames that a tangent-space normal map is relative to.

World frame, right-handed, x right, y up, z towards the camera, faces counter-clockwise as the camera sees them. No
triangle spans a break that `shape` has found (its `edge`), nor one that the camera sees edge-on.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError
from lightstage.kernels.normals.rig_normals import surface_normals
from lightstage.kernels.surface.pinhole import Pinhole

Array = NDArray[np.float64]
_EDGE_ON = 0.06
"""Least cosine between a triangle and the view: 86.5 degrees."""
_SMOOTH_PX = 2.0
"""Least sigma of the blur that makes the smooth surface's normals."""


@dataclass(frozen=True)
class Surface:
    """A triangle mesh on the pixels of a picture."""

    vertices: Array
    """(vertex, xyz) world, mm."""
    faces: NDArray[np.int64]
    """(face, 3), counter-clockwise to the camera."""
    normals: Array
    """(vertex, xyz), unit vectors, world."""
    tangents: Array
    """(vertex, xyz), unit vectors to the right in the picture, across `normals`."""
    pixels: NDArray[np.int64]
    """(vertex, 2): row and column of each."""
    shape: tuple[int, int]
    """Rows and columns of the picture."""

    @property
    def uv(self) -> Array:
        """(vertex, 2): texture coordinates, the origin at the lower left."""
        rows, columns = self.shape
        return np.stack([(self.pixels[:, 1] + 0.5) / columns, 1 - (self.pixels[:, 0] + 0.5) / rows], axis=1)


@dataclass(frozen=True)
class Frames:
    """The smooth surface at every pixel, (y, x, xyz) each: what a tangent-space normal map is relative to."""

    normal: Array
    tangent: Array
    """To the right in the picture, across the normal. The bitangent, normal x tangent, is up."""


def triangulate(
    depth_mm: Array,
    camera: Pinhole,
    *,
    every: int = 1,
    edge: NDArray[np.uint8] | None = None,
    normal: Array | None = None,
) -> Surface:
    """Triangles over every `every`th pixel of a height map.

    Args:
        depth_mm: (y, x) camera z, NaN off the subject.
        camera: of the picture.
        edge: (y, x) bits, 1 and 2 where the surface is broken to the right and below; None: nowhere.
        normal: (y, x, xyz) measured normals for the vertices, NaN where there is none; None: the smooth surface's.

    Raises:
        KernelError: no triangle is left.
    """
    points = camera.points(depth_mm)
    frames = smooth_frames(depth_mm, camera, every=every)
    rows, columns = np.arange(0, depth_mm.shape[0], every), np.arange(0, depth_mm.shape[1], every)
    grid = points[np.ix_(rows, columns)]
    index = np.arange(grid[..., 0].size).reshape(grid.shape[:2])
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    right, below = _links(depth_mm, edge, every)
    faces = np.concatenate(
        [
            np.stack([a, c, b], axis=-1)[right[:-1] & below[:, :-1]],
            np.stack([b, c, d], axis=-1)[right[1:] & below[:, 1:]],
        ]
    )
    flat = grid.reshape(-1, 3)
    corners = flat[faces]
    turned = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    view = camera.centre - corners.mean(axis=1)
    size = np.linalg.norm(turned, axis=1) * np.linalg.norm(view, axis=1)
    faces = faces[np.einsum("ij,ij->i", turned, view) > _EDGE_ON * np.maximum(size, 1e-12)]
    if not len(faces):
        raise KernelError("the height map has no two neighbouring points, so there is no mesh of it")
    used, places = np.unique(faces, return_inverse=True)
    pixels = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)[used]
    at = (pixels[:, 0], pixels[:, 1])
    normals = frames.normal[at]
    if normal is not None:
        normals = np.where(np.isfinite(normal[at]), normal[at], normals)
    return Surface(
        flat[used],
        places.reshape(-1, 3),
        normals,
        frames.tangent[at],
        pixels,
        (depth_mm.shape[0], depth_mm.shape[1]),
    )


def _links(
    depth_mm: Array, edge: NDArray[np.uint8] | None, every: int
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether the surface goes on from each vertex to the next one, to the right (row, column - 1) and below.

    It does where every pixel on the way is on the subject, and no break lies between them.
    """
    known: NDArray[np.bool_] = np.asarray(np.isfinite(depth_mm))
    links = []
    for bit, axis in ((1, 1), (2, 0)):
        whole = np.moveaxis(known, axis, 1)[::every]
        broken = np.zeros_like(whole) if edge is None else (np.moveaxis(edge, axis, 1)[::every] & bit) > 0
        steps = whole[:, :-1] & whole[:, 1:] & ~broken[:, :-1]
        count = (whole.shape[1] - 1) // every
        whole_steps = np.asarray(steps[:, : count * every].reshape(len(steps), count, every).all(axis=2))
        links.append(np.moveaxis(whole_steps, 1, axis))
    return links[0], links[1]


def smooth_frames(depth_mm: Array, camera: Pinhole, *, every: int = 1) -> Frames:
    """What a renderer has at every pixel of a mesh: the frames of its vertices, interpolated.

    The normal is that of the height map, blurred as widely as the vertices are apart. The tangent is the direction
    in the surface along which the picture's row does not change (but for the lens' distortion), as in MikkTSpace.
    """
    unit = np.nan_to_num(surface_normals(camera.points(depth_mm), np.isfinite(depth_mm)))
    sigma = max(_SMOOTH_PX, float(every))
    normal = _unit(np.stack([cv2.GaussianBlur(unit[..., i], (0, 0), sigma) for i in range(3)], axis=-1))
    rays = camera.rays
    down = np.stack([np.zeros(rays.shape[:2]), rays[..., 2], -rays[..., 1]], axis=-1) @ camera.rotation
    tangent = _unit(np.cross(normal, down))
    if every > 1:
        y, x = (np.mgrid[0 : depth_mm.shape[0], 0 : depth_mm.shape[1]] / every).astype(np.float32)
        normal, tangent = (
            _unit(
                np.stack(
                    [cv2.remap(np.ascontiguousarray(part[::every, ::every, i]), x, y, cv2.INTER_LINEAR,
                               borderMode=cv2.BORDER_REPLICATE) for i in range(3)],
                    axis=-1,
                )
            )
            for part in (normal, tangent)
        )  # fmt: skip
        tangent = _unit(tangent - np.einsum("yxi,yxi->yx", tangent, normal)[..., None] * normal)
    return Frames(normal, tangent)


def _unit(vector: Array) -> Array:
    """(..., xyz) unit vectors; (0, 0, 1) where there is no direction."""
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.where(length > 1e-6, vector / np.maximum(length, 1e-6), np.array([0.0, 0.0, 1.0]))


def tangent_space(normal: Array, frames: Frames) -> Array:
    """Normals (y, x, xyz), world, in the frames of the smooth surface: right, up, out.

    (0, 0, 1), the smooth surface itself, where there is no normal or it points into the surface.
    """
    axes = np.stack([frames.tangent, np.cross(frames.normal, frames.tangent), frames.normal], axis=2)
    seen = np.einsum("yxji,yxi->yxj", axes, np.nan_to_num(normal))
    known = np.isfinite(normal).all(axis=2) & (seen[..., 2] > 0)
    return np.where(known[..., None], seen, np.array([0.0, 0.0, 1.0]))

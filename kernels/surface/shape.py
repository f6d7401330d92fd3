"""A subject's height map, and where its surface is broken: the equations are in `stages/shape.py`.

Source: Cao et al. (2022), doi:10.1007/978-3-031-19769-7_32.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.encodings import EDGE_BELOW, EDGE_RIGHT
from lightstage.kernels.errors import KernelError
from lightstage.kernels.pictures.subject_mask import find_subject, lit
from lightstage.kernels.surface.integration import integrate
from lightstage.kernels.surface.pinhole import Pinhole

Image = NDArray[np.float32]
_LEAST_PX = 64
"""Pixels: fewer are no surface."""
_STEEP = 8.0
"""Tangent of 83 degrees: a camera sees next to nothing of such a slope, and what it sees is rarely a surface."""
_SLANTED, _UNLIKE = 2.0, 0.5
"""A break's least slope, where normals predict another, and by how much it is outside of what they predict."""
_GRAZING = 0.03
"""Least |n . r| of a prediction: as `integration.py` takes it."""


def shape(
    depth_mm: Mapping[int, Image],
    normal: Mapping[float, Image],
    albedo: Mapping[float, Image],
    *,
    camera: Pinhole,
    mask: NDArray[np.bool_] | None = None,
) -> Mapping[str, Any]:
    """Height map of one tracking frame.

    Args:
        depth_mm: camera z (y, x) of the tracking frame, NaN off the subject; empty where none was found.
        normal: (xyz, y, x) by band, world, NaN where not valid. Their mean is taken.
        albedo: (y, x) by band: tells where the subject is, if the capture brought no mask.
        camera: the reference camera.
        mask: (y, x), where the subject is; None: to be found.

    Returns:
        `depth_mm` (y, x) float32: camera z, mm, NaN off the subject; `edge` (y, x) uint8: bits EDGE_RIGHT and
        EDGE_BELOW where the surface is broken towards that neighbour.

    Raises:
        KernelError: there is nothing to integrate.
    """
    unit = _mean(normal.values())
    in_camera = np.nan_to_num(unit) @ camera.rotation.T
    if depth_mm:
        (measured,) = depth_mm.values()
        if not np.isfinite(measured).any():
            raise KernelError("no point of the subject has a depth; give the capture a mask, or light it more")
        return {"depth_mm": measured, "edge": breaks(measured, in_camera, camera)}
    level = np.sum([np.nan_to_num(band) for band in albedo.values()], axis=0)
    where = np.isfinite(unit).all(axis=2) & (find_subject(level) if mask is None else lit(mask, level))
    count, labels = cv2.connectedComponents(where.astype(np.uint8), connectivity=4)
    if count > 1:
        where = labels == 1 + int(np.argmax(np.bincount(labels[where])[1:]))
    if where.sum() < _LEAST_PX:
        raise KernelError(
            f"only {int(where.sum())} pixels of the subject have normals; a surface needs {_LEAST_PX}"
        )
    log_depth = integrate(in_camera, where, camera.rays)
    centre = float(camera.to_camera(np.zeros(3))[2])
    depth = np.exp(log_depth - np.median(log_depth[where])) * centre
    return {"depth_mm": depth.astype(np.float32), "edge": breaks(depth, in_camera, camera)}


def prepare(*, camera: Mapping[str, Any], mask: Any, shape: Sequence[int]) -> Mapping[str, Any]:
    """The reference camera and the capture's mask, for pictures of `shape` (rows, columns).

    Args:
        camera: what `kernels.items.lens_of` takes of a camera item.
        mask: None, or a picture that can be loaded.
    """
    return {
        "camera": Pinhole.of(camera, (int(shape[0]), int(shape[1]))),
        "mask": None if mask is None else np.asarray(mask.load()) > 0,
    }


def _mean(normal: Iterable[Image]) -> NDArray[np.float64]:
    """(y, x, xyz): one normal from all bands; NaN where none has one."""
    total = np.sum([np.nan_to_num(band.astype(np.float64)) for band in normal], axis=0).transpose(1, 2, 0)
    length = np.linalg.norm(total, axis=2, keepdims=True)
    return np.asarray(np.where(length > 0, total / np.maximum(length, 1e-12), np.nan))


def breaks(depth_mm: NDArray[Any], normal: NDArray[np.float64], camera: Pinhole) -> NDArray[np.uint8]:
    """Between which neighbours a surface is broken.

    Args:
        depth_mm: (y, x) camera z; NaN off the subject.
        normal: (y, x, xyz) unit normals in the camera's frame; zeros where there is none, which predict nothing.
        camera: of the picture.

    Returns:
        (y, x) uint8, bits EDGE_RIGHT and EDGE_BELOW; a neighbour off the subject is no break.
    """
    known = np.isfinite(depth_mm)
    log_depth = np.log(np.where(known, depth_mm, 1.0))
    out = np.zeros(depth_mm.shape, np.uint8)
    facing = np.einsum("yxi,yxi->yx", normal, camera.rays)
    every, but_last, but_first = slice(None), slice(0, -1), slice(1, None)
    for bit, near, far in (
        (EDGE_RIGHT, (every, but_last), (every, but_first)),
        (EDGE_BELOW, (but_last, every), (but_first, every)),
    ):
        towards = camera.rays[far] - camera.rays[near]
        length = np.linalg.norm(towards, axis=2)
        step = (log_depth[far] - log_depth[near]) / length
        slopes = [
            -np.einsum("yxi,yxi->yx", normal[side], towards) / np.minimum(facing[side], -_GRAZING) / length
            for side in (near, far)
        ]
        outside = np.maximum(np.minimum(*slopes) - step, step - np.maximum(*slopes))
        predicted = (facing[near] != 0) & (facing[far] != 0)
        broken = (np.abs(step) > _STEEP) | (predicted & (np.abs(step) > _SLANTED) & (outside > _UNLIKE))
        out[near] |= np.where(broken & known[near] & known[far], np.uint8(bit), np.uint8(0))
    return out

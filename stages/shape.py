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

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.dag.stage import (
    Arrangement,
    CalibrationPicture,
    Grid,
    Group,
    Input,
    Items,
    Needs,
    Output,
    Params,
    Stage,
    StageError,
)
from lightstage.kernels.pictures.subject_mask import find_subject, lit
from lightstage.kernels.surface.integration import integrate
from lightstage.kernels.surface.pinhole import Pinhole

Image = NDArray[np.float32]
_LEAST_PX = 64
RIGHT, BELOW = 1, 2
"""Bits of `edge`: the surface is broken towards the neighbour to the right, below."""
_STEEP = 8.0
"""Tangent of 83 degrees: a camera sees next to nothing of such a slope, and what it sees is rarely a surface."""
_SLANTED, _UNLIKE = 2.0, 0.5
_GRAZING = 0.03
"""Least |n . r| of a prediction: as `integration.py` takes it."""


class ShapeParams(Params):
    """Nothing to choose."""


def shape(
    depth_mm: Sequence[Image],
    normal: Sequence[Image],
    albedo: Sequence[Image],
    *,
    camera: Pinhole,
    mask: NDArray[np.bool_] | None = None,
) -> Mapping[str, Any]:
    """Height map of one tracking frame.

    Args:
        depth_mm: none, or one (y, x): camera z; NaN off the subject.
        normal: (xyz, y, x), world, one per band; NaN where not valid. Their mean is taken.
        albedo: (y, x), one per band: tells where the subject is, if the capture brought no mask.
        camera: the reference camera.
        mask: (y, x), where the subject is; None: to be found.

    Returns:
        `depth_mm` (y, x) float32: camera z, mm, NaN off the subject; `edge` (y, x) uint8: bits RIGHT and BELOW
        where the surface is broken towards that neighbour.

    Raises:
        StageError: there is nothing to integrate.
    """
    unit = _mean(normal)
    in_camera = np.nan_to_num(unit) @ camera.rotation.T
    if len(depth_mm):
        depth = depth_mm[0]
        if not np.isfinite(depth).any():
            raise StageError("no point of the subject has a depth; give the capture a mask, or light it more")
        return {"depth_mm": depth, "edge": breaks(depth, in_camera, camera)}
    level = np.sum([np.nan_to_num(one) for one in albedo], axis=0)
    where = np.isfinite(unit).all(axis=2) & (find_subject(level) if mask is None else lit(mask, level))
    count, labels = cv2.connectedComponents(where.astype(np.uint8), connectivity=4)
    if count > 1:
        where = labels == 1 + int(np.argmax(np.bincount(labels[where])[1:]))
    if where.sum() < _LEAST_PX:
        raise StageError(f"only {int(where.sum())} pixels of the subject have normals; a surface needs {_LEAST_PX}")
    log_depth = integrate(in_camera, where, camera.rays)
    centre = float(camera.to_camera(np.zeros(3))[2])
    found = np.exp(log_depth - np.median(log_depth[where])) * centre
    return {"depth_mm": found.astype(np.float32), "edge": breaks(found, in_camera, camera)}


def _mean(normal: Sequence[Image]) -> NDArray[np.float64]:
    """(y, x, xyz): one normal from all bands; NaN where none has one."""
    total = np.sum([np.nan_to_num(one.astype(np.float64)) for one in normal], axis=0).transpose(1, 2, 0)
    length = np.linalg.norm(total, axis=2, keepdims=True)
    return np.asarray(np.where(length > 0, total / np.maximum(length, 1e-12), np.nan))


def breaks(depth_mm: NDArray[Any], normal: NDArray[np.float64], camera: Pinhole) -> NDArray[np.uint8]:
    """Between which neighbours a surface is broken.

    Args:
        depth_mm: (y, x) camera z; NaN off the subject.
        normal: (y, x, xyz) unit normals in the camera's frame; zeros where there is none, which predict nothing.
        camera: of the picture.

    Returns:
        (y, x) uint8, bits RIGHT and BELOW; a neighbour off the subject is no break.
    """
    known = np.isfinite(depth_mm)
    log_depth = np.log(np.where(known, depth_mm, 1.0))
    out = np.zeros(depth_mm.shape, np.uint8)
    facing = np.einsum("yxi,yxi->yx", normal, camera.rays)
    every, but_last, but_first = slice(None), slice(0, -1), slice(1, None)
    for bit, here, there in (
        (RIGHT, (every, but_last), (every, but_first)),
        (BELOW, (but_last, every), (but_first, every)),
    ):
        towards = camera.rays[there] - camera.rays[here]
        length = np.linalg.norm(towards, axis=2)
        step = (log_depth[there] - log_depth[here]) / length
        slopes = [
            -np.einsum("yxi,yxi->yx", normal[side], towards) / np.minimum(facing[side], -_GRAZING) / length
            for side in (here, there)
        ]
        outside = np.maximum(np.minimum(*slopes) - step, step - np.maximum(*slopes))
        told = (facing[here] != 0) & (facing[there] != 0)
        broken = (np.abs(step) > _STEEP) | (told & (np.abs(step) > _SLANTED) & (outside > _UNLIKE))
        out[here] |= np.where(broken & known[here] & known[there], np.uint8(bit), np.uint8(0))
    return out


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: ShapeParams
) -> Mapping[str, Any]:
    names = ("size_px", "K", "distortion", "world_to_camera")
    return {
        "camera": {name: items["camera"][name] for name in names},
        "mask": facts["mask"] if labels["integrated"] else None,
        "shape": labels["shape"],
    }


def _prepare(
    *, camera: Mapping[str, Any], mask: CalibrationPicture | None, shape: Sequence[int]
) -> Mapping[str, Any]:
    return {
        "camera": Pinhole.of(camera, (int(shape[0]), int(shape[1]))),
        "mask": None if mask is None else np.asarray(mask.load()) > 0,
    }


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: ShapeParams) -> Arrangement:
    (relief,) = grids
    height, width = relief.sizes["y"], relief.sizes["x"]
    found = "depth_mm" in relief.arrays
    groups = []
    for t in range(relief.sizes["tracking"]):
        bands = [{"tracking": t, "band": b} for b in range(relief.sizes["band"])]
        groups.append(
            Group(
                {"depth_mm": [{"tracking": t}], "normal": bands, "albedo": bands},
                {"shape": [height, width], "integrated": not found},
            )
        )
    labels = {name: relief.labels[name] for name in ("tracking", "time_s") if name in relief.labels}
    attrs = {
        "from": "depth found with the normals" if found else "integrated normals; distance: the stage's centre"
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
                "flag_masks": [RIGHT, BELOW],
                "flag_meanings": "right below",
                "long_name": "the surface is broken towards this neighbour",
            },
        ),
    },
    blocks=("tracking",),
    arrange=_arrange,
    context=_context,
    prepare=_prepare,
    prepared=("camera", "mask"),
    kernel=shape,
)

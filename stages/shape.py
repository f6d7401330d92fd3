"""shape: the surface as a height map, in millimetres.

Where the node above found depth together with the normals (`normals` with `correct: near` and beyond) that is the
shape. Otherwise normals are integrated: a plane through the point z r with normal n gives for the ray r' beside it

    (n . r) (L' - L) = -n . (r' - r),    L = log z ,

masked, perspective-correct, and aware of discontinuities (`integration.py`). Normals tell depth up to one factor;
it is set so that the subject's median lies at the stage's centre, which is where the rig wants it.

Must have run before: normals. Limits: without a model of the rig's lights the height map has the bend that near
lights put into normals; parts of the subject that do not touch have no common distance.

Sources: Cao et al. (2022), doi:10.1007/978-3-031-19769-7_32; Dutta (2010) chapter 3 for the normals.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dag.stage import Arrangement, Grid, Group, Input, Items, Needs, Output, Params, Stage, StageError
from stages.integration import integrate
from stages.pinhole import Pinhole
from stages.subject_mask import find_subject

Image = NDArray[np.float32]
_LEAST_PX = 64


class ShapeParams(Params):
    """Nothing to choose."""


def shape(
    depth_mm: Sequence[Image], normal: Sequence[Image], albedo: Sequence[Image], *, camera: Pinhole
) -> Mapping[str, Any]:
    """Height map of one tracking frame.

    Args:
        depth_mm: none, or one (y, x): camera z; NaN off the subject.
        normal: (xyz, y, x), world, one per band; NaN where not valid. The first is taken.
        albedo: (y, x), one per band: tells where the subject is. The first is taken.
        camera: the reference camera.

    Returns:
        `depth_mm` (y, x): camera z, mm, NaN off the subject.

    Raises:
        StageError: there is nothing to integrate.
    """
    if len(depth_mm):
        depth = depth_mm[0]
        if not np.isfinite(depth).any():
            raise StageError("no point of the subject has a depth; give the capture a mask, or light it more")
        return {"depth_mm": depth}
    unit = np.moveaxis(normal[0], 0, 2).astype(np.float64)
    mask = np.isfinite(unit).all(axis=2) & find_subject(albedo[0])
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
    if count > 1:
        mask = labels == 1 + int(np.argmax(np.bincount(labels[mask])[1:]))
    if mask.sum() < _LEAST_PX:
        raise StageError(f"only {int(mask.sum())} pixels of the subject have normals; a surface needs {_LEAST_PX}")
    in_camera = np.where(mask[..., None], unit, 0) @ camera.rotation.T
    log_depth = integrate(in_camera, mask, camera.rays)
    centre = float(camera.to_camera(np.zeros(3))[2])
    found = np.exp(log_depth - np.median(log_depth[mask])) * centre
    return {"depth_mm": found.astype(np.float32)}


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: ShapeParams
) -> Mapping[str, Any]:
    names = ("size_px", "K", "distortion", "world_to_camera")
    return {"camera": {name: items["camera"][name] for name in names}, "shape": labels["shape"]}


def _prepare(*, camera: Mapping[str, Any], shape: Sequence[int]) -> Mapping[str, Any]:
    return {"camera": Pinhole.of(camera, (int(shape[0]), int(shape[1])))}


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: ShapeParams) -> Arrangement:
    (relief,) = grids
    height, width = relief.sizes["y"], relief.sizes["x"]
    found = "depth_mm" in relief.arrays
    groups = []
    for t in range(relief.sizes["tracking"]):
        one = [{"tracking": t, "band": 0}]
        groups.append(
            Group({"depth_mm": [{"tracking": t}], "normal": one, "albedo": one}, {"shape": [height, width]})
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
        )
    },
    blocks=("tracking",),
    arrange=_arrange,
    context=_context,
    prepare=_prepare,
    prepared=("camera",),
    kernel=shape,
)

"""Normals with a model of the rig's lights: what `normals` gives for `correct: lights` and beyond.

`near_light.py` has the model, `self_consistent.py` the rounds; this file puts them together for one tracking frame
and writes what comes out in the form of the stage's outputs.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.encodings import VISIBILITY_STEPS
from lightstage.kernels.errors import KernelError
from lightstage.kernels.normals import near_light, quantised, self_consistent
from lightstage.kernels.normals.normal_filter import non_local_means
from lightstage.kernels.normals.openness import share_of_light
from lightstage.kernels.pictures.masked_mean import MaskedMean
from lightstage.kernels.pictures.subject_mask import find_subject, lit
from lightstage.kernels.surface.pinhole import Pinhole

_EXCESS_PX, _POWER_PX = 0.8, 2.0
"""Blur of the norm's excess, and of its power: its noise must not go into the albedo."""
_BLURRED_NOISE = 0.3
"""Variance that noise keeps in that blur; 0.13 if pixels were independent, but pictures were resampled."""

_NO_DISTANCE = (
    "the norm does not tell the distance; the stage's centre was taken, so check the lights and camera items"
)


class Scene(NamedTuple):
    """What the corrections know of the rig and the subject."""

    camera: Pinhole | None
    """None where lights are taken as distant."""
    lights: near_light.Lights
    mask: NDArray[np.bool_] | None
    """(y, x); None: to be found in the pictures."""


def solve(
    bands: Sequence[Mapping[str, NDArray[np.float32]]],
    scene: Scene,
    *,
    model: str,
    as_one: bool,
    filtered: str,
    openness: str = "measured",
) -> Mapping[str, Any]:
    """Normals of one tracking frame.

    Args:
        bands: per band, pictures (y, x) by illumination, radiance, NaN where not valid.
        scene: the rig and the subject.
        model: lights, near, near+shadows or full.
        as_one: all bands give one map.
        filtered: none, nlm or surface.
        openness: of the irradiance, measured or modelled.

    Returns:
        the outputs of `normals` with a leading band; see there.

    Raises:
        KernelError: nothing is measured, or no subject is found.
    """
    measured = near_light.measure(bands)
    shape = measured.constant.shape[1:]
    if model == "lights":
        return _read_out(measured, None, np.zeros((*shape, 3)), scene, as_one=as_one, filtered=filtered)
    assert scene.camera is not None
    if not (measured.weight > 0).any():
        raise KernelError("no pixel is measured in all pictures of the set: they are black, or saturated")
    constant = measured.constant.mean(axis=0)
    mask = lit(scene.mask, constant) if scene.mask is not None else find_subject(constant)
    geometry = self_consistent.solve(measured, mask, scene.camera, scene.lights, model=model)
    points = scene.camera.points(geometry.depth)
    return _read_out(measured, geometry, points, scene, as_one=as_one, filtered=filtered, openness=openness)


def _read_out(
    measured: near_light.LightVectors,
    geometry: self_consistent.Geometry | None,
    points: NDArray[np.float64],
    scene: Scene,
    *,
    as_one: bool,
    filtered: str,
    openness: str = "modelled",
) -> Mapping[str, Any]:
    """The kernel's outputs from what the rounds found; without it, lights are distant."""
    mask = measured.weight.sum(axis=0) > 0 if geometry is None else geometry.mask
    at, seen = points[mask], None if geometry is None else geometry.seen
    albedo = measured.constant
    irradiance = np.full(mask.shape, np.nan)
    joint = near_light.fused(measured)
    irradiance[mask] = near_light.invert(joint.vector[0][mask], at, scene.lights, seen).direct
    if geometry is not None:
        measured = geometry.without_bounces(measured, np.where(mask, irradiance, 1.0))
        joint = near_light.fused(measured)
        irradiance[mask] = _irradiance(joint, mask, at, scene.lights, seen, openness)
    norms = np.linalg.norm(measured.vector, axis=3) / (2 * np.maximum(measured.constant, 1e-30))
    wanted = near_light.fused(measured) if as_one else measured
    stored, valids = [], []
    for vector, weight in zip(wanted.vector, wanted.weight, strict=True):
        inside = mask & (weight > 0)
        normal = np.full((*mask.shape, 3), np.nan)
        normal[inside] = near_light.invert(
            vector[inside], points[inside], scene.lights, None if seen is None else seen[inside[mask]]
        ).normal
        if filtered == "surface":
            normal = np.where(inside[..., None], surface_normals(points, mask), np.nan)
        if filtered == "nlm":
            normal = non_local_means(normal, np.where(inside, 1 / np.sqrt(np.maximum(weight, 1e-30)), 0), inside)
        stored.append(quantised.encode(np.moveaxis(normal, 2, 0)))
        valids.append(inside & np.isfinite(normal).all(axis=2))
    norm = norms
    if as_one:
        total = np.maximum(measured.weight.sum(axis=0), 1e-30)
        albedo, norm = (((measured.weight * a).sum(axis=0) / total)[None] for a in (albedo, norm))
    valid = np.stack(valids)
    out: dict[str, Any] = {
        "normal": np.stack(stored),
        "albedo": np.where(valid, albedo, np.nan).astype(np.float32),
        "norm": np.where(valid, norm, np.nan).astype(np.float32),
        "valid": valid,
    }
    if geometry is not None:
        out["depth_mm"] = geometry.depth.astype(np.float32)
        out["irradiance"] = irradiance.astype(np.float32)
        out["stats"] = {"distance_mm": geometry.distance_mm}
        if not geometry.distance_found:
            out["warnings"] = [_NO_DISTANCE]
    if seen is not None:
        share = np.zeros((seen.shape[1], *mask.shape), np.uint8)
        share[:, mask] = np.floor(seen.T * VISIBILITY_STEPS + 0.5).astype(np.uint8)
        out["visibility"] = share
    return out


def _irradiance(
    joint: near_light.LightVectors,
    mask: NDArray[np.bool_],
    at: NDArray[np.float64],
    lights: near_light.Lights,
    seen: NDArray[np.float32] | None,
    openness: str,
) -> NDArray[np.float64]:
    """(point,): light that arrives directly, as the found surface has it or, measured, as the norm corrects it."""
    vector, weight = joint.vector[0][mask], joint.weight[0][mask]
    response = near_light.invert(vector, at, lights, seen)
    if openness == "modelled":
        return response.direct
    share = np.ones(len(at))
    if seen is not None:
        unshadowed = near_light.invert(response.vector, at, lights).direct
        share = np.clip(response.direct / np.maximum(unshadowed, 1e-12), 0, 1)
    # noise lengthens a vector: by its two components across, squared
    square = np.einsum("pi,pi->p", vector, vector) - 2 / np.maximum(weight, 1e-12)
    excess, variance = np.zeros((2, *mask.shape))
    excess[mask] = np.nan_to_num(np.sqrt(np.maximum(square, 0)) - response.norm)
    variance[mask] = 1 / np.maximum(weight, 1e-12)
    excess = _without_noise(excess, variance, mask)
    return np.asarray(response.direct * share_of_light(share, excess[mask]) / np.maximum(share, 1e-3))


def _without_noise(
    values: NDArray[np.float64], variance: NDArray[np.float64], mask: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Values (y, x) blurred a little, and shrunk by the share of noise in their power around each pixel."""
    smooth = MaskedMean(mask, _EXCESS_PX)(values)
    around = MaskedMean(mask, _POWER_PX)
    noise, power = _BLURRED_NOISE * around(variance), around(smooth**2)
    return np.asarray(smooth * np.maximum(1 - noise / np.maximum(power, 1e-12), 0))


def surface_normals(points: NDArray[np.float64], mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Normals of a surface given as points (y, x, xyz), (y, x, xyz); NaN off the mask.

    Differences to the neighbours on both sides, or on the one side that is in the mask.
    """
    known = np.where(mask[..., None], points, np.nan)
    slopes = []
    for axis in (1, 0):
        step = np.diff(known, axis=axis)
        edge = np.full_like(np.take(known, [0], axis=axis), np.nan)
        both = np.stack([np.concatenate([step, edge], axis=axis), np.concatenate([edge, step], axis=axis)])
        there = np.isfinite(both)
        slopes.append(np.where(there, both, 0).sum(axis=0) / np.maximum(there.sum(axis=0), 1))
    # x runs right, y down in the picture: their cross product points away from the camera
    normal = np.cross(slopes[1], slopes[0])
    length = np.linalg.norm(normal, axis=2, keepdims=True)
    return np.asarray(np.where(mask[..., None] & (length > 0), normal / np.maximum(length, 1e-12), np.nan))


def prepared(context: Mapping[str, Any], shape: tuple[int, int]) -> Scene:
    """What `normals` reads of the rig, in numbers, for pictures of `shape` (rows, columns).

    Raises:
        KernelError: the camera item is of another size, or a light has no place.
    """
    mask = None if context["mask"] is None else np.asarray(context["mask"].load()) > 0
    camera = None if context["camera"] is None else Pinhole.of(context["camera"], shape)
    return Scene(camera, near_light.Lights.of(context["lights"], near=context["near"]), mask)

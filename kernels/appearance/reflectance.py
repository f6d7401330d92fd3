"""Albedo of the diffuse component in every band, with its standard error: the equations are in
`stages/reflectance.py`.

Sources: Ma et al. (2007) for constant light as albedo; Goral et al. (1984), doi:10.1145/964965.808601, for
radiosity; Horn (1974), doi:10.1016/0146-664X(74)90022-7, for smooth shading.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.hw.illuminations import CONSTANT, pairs
from lightstage.kernels.pictures.masked_mean import MaskedMean
from lightstage.kernels.pictures.noise import noise_model
from lightstage.kernels.pictures.subject_mask import find_subject
from lightstage.kernels.surface.interreflection import Tiles
from lightstage.kernels.surface.pinhole import Pinhole

Image = NDArray[np.float32]
_DARK = 0.1
"""Of the open irradiance: where less arrives the quotient is the error of S."""
_SMOOTH = 1 / 4
"""Of the picture's width: sigma of what `smooth` takes for shading. A smaller one takes more shading and, on a
rendered head, still more of the skin."""
_BRIGHT = 99.5
"""Percentile that is 1 when the scale is relative."""


def reflectance(
    radiance: Mapping[tuple[float, str], Image],
    irradiance: Mapping[int, Image],
    normal: Mapping[int, Image],
    depth_mm: Mapping[int, Image],
    *,
    shading: str,
    white: float | None,
    camera: Pinhole | None,
    bounced: str,
) -> Mapping[str, Any]:
    """Reflectance of one tracking frame.

    Args:
        radiance: (y, x) by band (nm) and illumination, diffuse component: C, or gradients with their complements,
            or both; NaN where not valid.
        irradiance: S (y, x) of the tracking frame; empty without a model of the rig.
        normal: (xyz, y, x) of it, world. depth_mm: (y, x) of it, camera z; empty where none was found.
        shading: geometry, smooth or none.
        white: radiance of a white surface at the stage's centre that faces the camera under constant light; None
            where it is not known.
        camera: what bounced light needs; None where it is not to be taken out.
        bounced: see ReflectanceParams.

    Returns:
        `reflectance` and `standard_error` (band, y, x), `shading` (y, x): what was divided out, relative to
        `white`, the mean over bands. NaN where not valid.
    """
    pictures: dict[float, dict[str, Image]] = {}
    for band, name in radiance:
        pictures.setdefault(band, {})[name] = radiance[band, name]
    constant, variance = (np.stack(parts) for parts in zip(*map(_constant, pictures.values()), strict=True))
    if shading == "geometry":
        (direct,) = irradiance.values()
        arrives = np.broadcast_to(direct, constant.shape)
        if camera is not None and bounced == "removed" and normal and depth_mm:
            (turned,), (depth,) = normal.values(), depth_mm.values()
            arrives = _arrives(constant, direct, turned, depth, camera)
        level = white or float(np.nanmedian(direct))
    else:
        level = white or 1.0
        arrives = np.full(constant.shape, np.float32(level))
        if shading == "smooth":
            arrives *= _smooth(constant)
    arrives = np.where(arrives > _DARK * level, arrives, np.float32(np.nan))
    albedo, error = constant / arrives, np.sqrt(variance) / arrives
    if white is None:
        known = albedo[np.isfinite(albedo)]
        brightest = np.float32(np.percentile(known, _BRIGHT)) if known.size else np.float32(1)
        albedo, error = albedo / brightest, error / brightest
    return {
        "reflectance": albedo.astype(np.float32),
        "standard_error": error.astype(np.float32),
        "shading": (arrives.mean(axis=0) / np.float32(level)).astype(np.float32),
        "stats": {"standard_error": float(np.nanmean(error)) if np.isfinite(error).any() else float("nan")},
    }


def prepare(
    *, shading: str, shape: Sequence[int], lights: Mapping[str, Any] | None, camera: Mapping[str, Any] | None
) -> Mapping[str, Any]:
    """White and the camera, for pictures of `shape` (rows, columns); None where they are not known.

    Args:
        lights: a lights item's. camera: what `kernels.items.lens_of` takes of a camera item.
    """
    return {
        "shading": shading,
        "white": None if lights is None else white_radiance(lights),
        "camera": None if camera is None else Pinhole.of(camera, (int(shape[0]), int(shape[1]))),
    }


def _constant(pictures: Mapping[str, Image]) -> tuple[Image, Image]:
    """r_c of one band (y, x) and its variance: C and each pair that adds up to it, weighted by their noise."""
    alpha, beta = noise_model(pictures)
    estimates = [(pictures[CONSTANT], 1)] if CONSTANT in pictures else []
    estimates += [(pictures[a] + pictures[b], 2) for a, b in pairs(pictures)]
    total = np.zeros(estimates[0][0].shape)
    weights = np.zeros(total.shape)
    known = np.isfinite(estimates[0][0])
    for estimate, _ in estimates[1:]:
        known |= np.isfinite(estimate)
    # one level for all weights, smoothed, so that a pixel's own noise does not choose its weight
    first = np.where(np.isfinite(estimates[0][0]), estimates[0][0], 0).astype(np.float64)
    shot = beta * np.maximum(cv2.GaussianBlur(first, (0, 0), 1.0), 0)
    for estimate, count in estimates:
        seen = np.isfinite(estimate)
        weight = np.where(seen, 1 / np.maximum(count * alpha + shot, 1e-20), 0)
        total += weight * np.where(seen, estimate, 0)
        weights += weight
    weights = np.where(known, weights, np.nan)
    return np.asarray(total / weights, np.float32), np.asarray(1 / weights, np.float32)


def _arrives(constant: Image, direct: Image, normal: Image, depth_mm: Image, camera: Pinhole) -> Image:
    """S + B_b, (band, y, x)."""
    turned, depth = np.moveaxis(normal, 0, 2).astype(np.float64), depth_mm.astype(np.float64)
    mask = np.isfinite(depth) & np.isfinite(turned).all(axis=2) & np.isfinite(direct)
    if not mask.any():
        return np.broadcast_to(direct, constant.shape)
    tiles = Tiles(camera.points(depth), turned, depth, mask, camera)
    light = np.zeros((*direct.shape, 4))
    light[..., 3] = np.where(mask, direct, 0)
    more = [tiles.bounced(light, np.nan_to_num(picture).astype(np.float64))[..., 3] for picture in constant]
    return np.asarray(direct + np.stack(more), np.float32)


def _smooth(constant: Image) -> Image:
    """Low frequencies of constant light, (y, x): the mean over bands of the logarithm, 1 in the median."""
    middle = constant.mean(axis=0)
    subject = find_subject(np.nan_to_num(middle)) & np.isfinite(middle) & (constant > 0).all(axis=0)
    if not subject.any():
        return np.ones(middle.shape, np.float32)
    log = np.where(subject, np.log(np.where(subject, constant, 1).astype(np.float64)).mean(axis=0), 0)
    low = MaskedMean(subject, _SMOOTH * constant.shape[2])(log)
    return np.where(subject, np.exp(low - np.median(low[subject])), np.float32(np.nan)).astype(np.float32)


def white_radiance(item: Mapping[str, Any]) -> float:
    """Radiance of a white surface at the stage's centre that faces the camera, all lights on.

    1 is one light at full power at the lights' mean distance, straight ahead (docs/formats.md).
    """
    places = [np.asarray(x["position_mm"] or x["direction"], float) for x in item["lights"]]
    near = all(light["position_mm"] is not None for light in item["lights"])
    usual = float(np.mean([np.linalg.norm(place) for place in places]))
    total = 0.0
    for light, place in zip(item["lights"], places, strict=True):
        length = float(np.linalg.norm(place))
        total += light["power"] * max(place[2] / length, 0.0) * ((usual / length) ** 2 if near else 1.0)
    return total

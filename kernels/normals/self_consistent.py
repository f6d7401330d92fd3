"""Depth, shadows and bounced light, found together with the normals.

The model of `near_light.py` needs to know where each point is and which lights it sees; that follows from depth,
and depth from the normals. So in rounds:

    normals -> depth (`integration.py`) -> loose parts (`loose_parts.py`) -> distance
    -> visibility (`visibility.py`) -> bounces (`interreflection.py`) -> normals

- The distance comes from the light itself: |m| / r_c must be what the model predicts, and the residual crosses
  zero at one distance. Its median is taken over open points, which see nearly all of their light, because
  shadows and bounced light change the norm.
- Visibility is averaged with the round before, or it would oscillate.
- Pictures wider than about 400 px are binned for the rounds; one more is done at full size.

Source: ours (docs/methods/near-light.md has the ablation); the modules named give those of the ingredients.
"""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError
from lightstage.kernels.normals.near_light import Lights, LightVectors, Response, binned, fused, invert
from lightstage.kernels.surface.integration import integrate
from lightstage.kernels.surface.interreflection import Tiles, without_bounces
from lightstage.kernels.surface.loose_parts import LooseParts
from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.kernels.surface.visibility import visible

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ROUNDS = {"near": 3, "near+shadows": 5, "full": 6}
_COARSE_PX = 420
"""Larger pictures are binned to about this width for the rounds; the last round is at full size."""
_LEAST_PART_PX = 400
"""A part of the mask of its own has so many pixels, or its norm is too noisy to tell a distance."""
_OPEN = 0.98
"""A point is open when this much of its light reaches it."""
_ROOT_MM, _MOST_TRIALS = 1e-6, 40
"""The distance is told to a tenth of a millimetre at best; it is looked for so much closer that where the search
ends does not show."""
_SPECTRAL_BANDS = 3
_FIRST_SWING = 2
"""The round from which parts are placed: before, shadows and bounced light are not in the norm yet."""


@dataclass(frozen=True)
class Geometry:
    """What the rounds found."""

    mask: Mask
    """(y, x): where there is a surface and a measurement."""
    depth: Array
    """(y, x) camera z, mm; NaN outside the mask."""
    seen: NDArray[np.float32] | None
    """(point, light) visibility of the mask's points in C order; None when shadows are not modelled."""
    slope: Array | None
    """(y, x, xyz): spectral slope of bounced light."""
    albedo: Array | None
    """(band, y, x): the albedo around each point, for `slope`."""
    bounced: Array | None
    """(band, y, x, 4): irradiance by way of other points, for radiosity."""
    distance_mm: float
    """Median depth of the mask."""
    distance_found: bool
    """False when the norm did not tell it, and the stage's centre was taken."""
    loose: LooseParts | None = None
    """What the light has placed beside the distance."""

    def without_bounces(self, measured: LightVectors, direct: Array) -> LightVectors:
        """The measurement with bounced light taken out; `direct` (y, x) is S."""
        if self.slope is not None and self.albedo is not None:
            ratio = measured.ratio() - self.albedo[..., None] * self.slope
            return replace(measured, vector=ratio * measured.constant[..., None])
        if self.bounced is not None:
            share = measured.constant / np.maximum(direct + self.bounced[..., 3], 1e-3)
            vector = measured.vector - share[..., None] * self.bounced[..., :3]
            return replace(measured, vector=vector, constant=measured.constant - share * self.bounced[..., 3])
        return measured


def solve(measured: LightVectors, mask: Mask, camera: Pinhole, lights: Lights, *, model: str) -> Geometry:
    """The rounds.

    Args:
        measured: the pictures' numbers.
        mask: (y, x), where the subject is.
        camera: the reference camera.
        lights: the rig's.
        model: near, near+shadows or full.

    Raises:
        KernelError: nothing is left in the mask.
    """
    factor = max(1, round(mask.shape[1] / _COARSE_PX))
    if factor == 1:
        return _rounds(measured, mask, camera, lights, model)
    small_mask = binned(mask.astype(float), factor) > 0.5
    coarse = _rounds(measured.smaller(factor), small_mask, camera.smaller(factor), lights, model)
    return _at_full_size(coarse, measured, mask, camera, lights, factor)


def _rounds(measured: LightVectors, mask: Mask, camera: Pinhole, lights: Lights, model: str) -> Geometry:
    mask = mask & (measured.weight.sum(axis=0) > 0)
    if mask.sum() < 64:
        raise KernelError("the subject's mask holds no measured pixels; give the capture a mask, or light it more")
    geometry = Geometry(mask, np.full(mask.shape, np.nan), None, None, None, None, 0.0, False)
    direct = np.ones(mask.shape)
    log_depth: Array | None = None
    joint = fused(measured)
    normal = _unit(joint.vector[0][mask])
    response: Response | None = None
    for turn in range(ROUNDS[model]):
        turned = _in_camera(normal, mask, camera)
        log_depth = integrate(turned, mask, camera.rays, start=log_depth)
        if model != "near" and turn >= _FIRST_SWING:
            loose = geometry.loose or LooseParts.of(turned, mask, camera, log_depth)
            loose = loose.moved(log_depth, geometry.distance_mm, joint, camera, lights)
            log_depth, geometry = log_depth + loose.swing(), replace(geometry, loose=loose)
        geometry = _placed(geometry, log_depth, joint, normal, camera, lights)
        points = camera.points(geometry.depth)
        if model != "near" and turn > 0:
            now = visible(points[mask], geometry.depth, camera, lights.position)
            mixed = now if geometry.seen is None else (geometry.seen + now) / np.float32(2)
            geometry = replace(geometry, seen=np.asarray(mixed, np.float32))
        if model == "full" and turn > 0 and response is not None:
            direct[mask] = response.direct
            geometry = _with_bounces(geometry, measured, direct, response, points, camera, lights, turn)
            joint = fused(geometry.without_bounces(measured, direct))
        response = invert(joint.vector[0][mask], points[mask], lights, geometry.seen)
        normal = _filled(response.normal, joint.vector[0][mask])
    return geometry


def _with_bounces(
    geometry: Geometry, measured: LightVectors, direct: Array, response: Response, points: Array,
    camera: Pinhole, lights: Lights, turn: int,
) -> Geometry:  # fmt: skip
    mask = geometry.mask
    if len(measured.constant) >= _SPECTRAL_BANDS:
        slope, albedo = without_bounces(measured.ratio(), measured.weight, measured.constant, direct, mask)
        return replace(geometry, slope=slope, albedo=albedo)
    if turn % 2 == 0:  # form factors are the dear part, and change little
        return geometry
    normal = np.zeros((*mask.shape, 3))
    normal[mask] = np.nan_to_num(response.normal)
    tiles = Tiles(points, normal, geometry.depth, mask, camera)
    light = np.zeros((*mask.shape, 4))
    light[mask] = np.concatenate([response.vector, response.direct[:, None]], axis=1)
    return replace(geometry, bounced=np.stack([tiles.bounced(np.nan_to_num(light), c) for c in measured.constant]))


def _placed(
    geometry: Geometry, log_depth: Array, joint: LightVectors, normal: Array, camera: Pinhole, lights: Lights
) -> Geometry:
    """The depth map at the distance at which |m| / r_c is what the model predicts.

    Parts of the mask that do not touch have a distance each; small ones keep their place beside the largest.
    """
    mask = geometry.mask
    centre = float(camera.to_camera(np.zeros(3))[2])
    _, parts, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    order = 1 + np.argsort(-stats[1:, cv2.CC_STAT_AREA], kind="stable")
    shape = np.exp(log_depth - np.nanmedian(log_depth[parts == order[0]]))
    depth = np.full(mask.shape, np.nan)
    measured = False
    first = guess = geometry.distance_mm or centre
    for k, part in enumerate(order):
        region = parts == part
        distance, known = first, False
        if k == 0 or region.sum() >= max(_LEAST_PART_PX, 0.02 * mask.sum()):
            own = shape if k == 0 else shape / np.nanmedian(shape[region])
            distance, known = _distance(region, own, joint, camera, lights, guess, centre)
            if k and known:
                depth[region] = own[region] * distance
                continue
        if k == 0:
            measured = known
            first = distance if known else centre
        depth[region] = shape[region] * first
    return replace(geometry, depth=depth, distance_mm=float(np.median(depth[mask])), distance_found=measured)


def _distance(
    region: Mask, shape: Array, joint: LightVectors, camera: Pinhole, lights: Lights, guess: float, centre: float
) -> tuple[float, bool]:
    """Where the norm's residual crosses zero for one part of the surface."""
    some = np.zeros(region.shape, np.bool_)
    some[::2, ::2] = region[::2, ::2]
    if some.sum() < 16 or centre <= 0:
        return guess, False
    front = np.where(region, shape * guess, np.nan)
    points = camera.points(front)[some]
    seen = visible(points, front, camera, lights.position)
    vector, norm = joint.vector[0][some], np.linalg.norm(joint.vector[0][some], axis=1) / joint.constant[0][some]
    # open points: shadows and bounced light would change the norm
    whole = invert(vector, points, lights).direct
    openness = invert(vector, points, lights, seen).direct / np.maximum(whole, 1e-12)
    chosen = openness >= min(_OPEN, float(np.nanquantile(openness, 0.6)))
    rays = (camera.rays @ camera.rotation)[some] * shape[some][:, None]
    rays, vector, norm, seen = rays[chosen], vector[chosen], norm[chosen], seen[chosen]

    def residual(distance: float) -> float:
        predicted = invert(vector, camera.centre + distance * rays, lights, seen).norm
        return float(np.nanmedian(norm / np.maximum(predicted, 1e-12) - 1))

    return _root(residual, guess, 0.5 * centre, 1.5 * centre)


def _root(residual: Any, guess: float, low: float, high: float) -> tuple[float, bool]:
    """Where a rising or falling residual crosses zero (regula falsi, Illinois); False if nowhere.

    Not scipy's brentq: on a performance it ended elsewhere, and up to 3 mm of depth came out otherwise.
    """
    at_low, at_high = residual(low), residual(high)
    if not at_low * at_high < 0:
        return guess, False
    for _ in range(_MOST_TRIALS):
        middle = (low * at_high - high * at_low) / (at_high - at_low)
        at_middle = residual(middle)
        if at_middle == 0:
            break
        if at_middle * at_high < 0:
            low, at_low = high, at_high
        else:
            at_low /= 2
        done = abs(high - middle) < _ROOT_MM
        high, at_high = middle, at_middle
        if done:
            break
    return middle, True


def _at_full_size(
    coarse: Geometry, measured: LightVectors, mask: Mask, camera: Pinhole, lights: Lights, factor: int
) -> Geometry:
    """One more round at full size, from what the small pictures told of depth, shadows and bounced light."""
    spread = _Spread(coarse.mask, mask.shape, factor)
    # what binning has lost, such as a strip of a pixel, has no depth to start from
    mask = mask & (measured.weight.sum(axis=0) > 0) & spread.reached
    depth = spread(coarse.depth)
    seen = None
    if coarse.seen is not None:
        seen = np.empty((int(mask.sum()), coarse.seen.shape[1]), np.float32)
        for k in range(seen.shape[1]):
            layer = np.zeros(coarse.mask.shape)
            layer[coarse.mask] = coarse.seen[:, k]
            seen[:, k] = spread(layer)[mask]
    geometry = replace(
        coarse,
        mask=mask,
        depth=np.where(mask, depth, np.nan),
        seen=seen,
        slope=None if coarse.slope is None else spread(coarse.slope),
        albedo=None if coarse.albedo is None else np.stack([spread(a) for a in coarse.albedo]),
        bounced=None if coarse.bounced is None else np.stack([spread(b) for b in coarse.bounced]),
    )
    direct = np.ones(mask.shape)
    if geometry.bounced is not None:
        points = camera.points(geometry.depth)[mask]
        direct[mask] = invert(fused(measured).vector[0][mask], points, lights, seen).direct
    joint = fused(geometry.without_bounces(measured, direct))
    response = invert(joint.vector[0][mask], camera.points(geometry.depth)[mask], lights, seen)
    normal = _filled(response.normal, joint.vector[0][mask])
    start = np.where(mask, np.log(np.maximum(depth, 1.0)), np.nan)
    log_depth = integrate(_in_camera(normal, mask, camera), mask, camera.rays, start=start, rounds=3)
    if geometry.loose is not None:
        # what the light has told of the small pictures, integration does not know again
        log_depth = log_depth + geometry.loose.spread(spread, mask).drawn(start - log_depth)
    # each part of the mask stays where the small pictures have put it
    _, parts = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
    fine = np.full(mask.shape, np.nan)
    for part in range(1, int(parts.max()) + 1):
        region = parts == part
        fine[region] = np.exp(log_depth[region] + np.median(start[region] - log_depth[region]))
    return replace(geometry, depth=fine)


class _Spread:
    """Small pictures to full size, filled a little beyond their mask."""

    def __init__(self, mask: Mask, shape: tuple[int, int], factor: int) -> None:
        self._inside = mask.astype(np.float32)
        y, x = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32)
        self._where = ((x + 0.5) / factor - 0.5, (y + 0.5) / factor - 0.5)
        self._known = self._pull(cv2.GaussianBlur(self._inside, (0, 0), 1.5))
        self._sure = self._pull(self._inside)
        self.reached = self._known > 1e-3

    def _pull(self, small: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(cv2.remap(small, *self._where, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    def __call__(self, small: Array) -> Array:
        if small.ndim == 3:
            return np.stack([self(small[..., i]) for i in range(small.shape[2])], axis=-1)
        known = np.where(self._inside > 0, np.nan_to_num(small), 0).astype(np.float32)
        near = self._pull(cv2.GaussianBlur(known, (0, 0), 1.5)) / np.maximum(self._known, 1e-6)
        sharp = self._pull(known) / np.maximum(self._sure, 1e-6)
        return np.asarray(np.where(self._sure > 0.5, sharp, near), np.float64)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))


def _filled(normal: Array, vector: Array) -> Array:
    return np.where(np.isfinite(normal), normal, _unit(vector))


def _in_camera(normal: Array, mask: Mask, camera: Pinhole) -> Array:
    out = np.zeros((*mask.shape, 3))
    out[mask] = normal @ camera.rotation.T
    return out

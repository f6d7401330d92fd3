"""How strong and how rough the specular reflection is, and how sure that is: equations in `stages/gloss.py`.

Source: Walter et al. (2007) for the lobe. The comparison with the rig's own response is ours.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.appearance.microfacets import at_normal_incidence, response, shines
from lightstage.kernels.appearance.roughness import (
    WIDTHS,
    Lobes,
    Moments,
    Widths,
    at_width,
    find_widths,
    local_mean,
    measure,
    sphere_lobes,
)
from lightstage.kernels.normals.near_light import Lights, binned
from lightstage.kernels.surface.pinhole import Pinhole

Image = NDArray[np.float32]
Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_COARSE_PX = 420
"""Roughness of wider pictures is found in pictures binned to about this width; its neighbourhoods are wider yet."""
_DARK = 0.05
"""Of the median: where the model has less specular light, the quotient is the error of the model."""
_TILT_DEG = 1.5
"""One sigma of each component of the surface's normals, whose error is 1.5 to 3 degrees in the mean on rendered
subjects (docs/methods/near-light.md)."""
_EDGE_PX = 1.5
"""Sigma of the neighbourhood over which a shadow may end elsewhere."""
_STEP = 0.05
"""Of ln a, in a difference quotient."""
_BRIGHT = 99.5
"""Percentile that is 1 when the intensity is relative."""


class Setup(NamedTuple):
    """Who looks, and where light comes from."""

    camera: Pinhole
    lights: Lights


class Surface(NamedTuple):
    """What reflects, (y, x, ...)."""

    normal: Array
    depth: Array
    visibility: Image | None
    """(light, y, x); None where all is seen."""
    known: Mask


def gloss(
    radiance: Mapping[tuple[float, str], Image],
    specular_normal: Mapping[int, Image],
    normal: Mapping[int, Image],
    depth_mm: Mapping[int, Image],
    visibility: Mapping[int, Image],
    *,
    setup: Setup | None,
    absolute: bool,
    index: float,
    spread: float,
) -> Mapping[str, Any]:
    """Specular intensity and roughness of one tracking frame; all inputs but radiance hold it alone.

    Args:
        radiance: (y, x) by band (nm) and illumination, specular component, NaN where not valid: for every axis a
            gradient, its complement, or both; and C or a pair.
        specular_normal: (xyz, y, x), world: the surface where there is no other.
        normal: (xyz, y, x), world. depth_mm: (y, x), camera z. visibility: (light, y, x). The last two are empty
            where none was found.
        setup: the rig's; None where the model is a sphere of light.
        absolute: whether radiance has an absolute scale.
        index, spread: see GlossParams.

    Returns:
        `specular` (y, x): reflectance at normal incidence, relative where not `absolute`; `specular_error`, its
        standard error; `roughness` (y, x): GGX width; `roughness_error`. float32, NaN where not valid.
    """
    bands: dict[float, dict[str, Image]] = {}
    for band, name in radiance:
        bands.setdefault(band, {})[name] = radiance[band, name]
    moments = measure(list(bands.values()))
    if setup is None or not depth_mm:
        (turned,) = specular_normal.values()
        known, width, expected, of_model = _under_a_sphere(moments, _upright(turned), index, spread)
    else:
        (turned,), (depth,) = normal.values(), depth_mm.values()
        surface = _surface(moments, _upright(turned), depth, next(iter(visibility.values()), None))
        known = surface.known
        width = _rig_widths(moments, surface, setup, index, spread)
        expected = _expected(surface, width.value, setup, index)
        of_model = _model_error(surface, width, expected, setup, index)
    usual = float(np.median(expected[known])) if known.any() else 1.0
    known = known & (expected > _DARK * usual)
    scale = at_normal_incidence(index) / np.where(known, expected, np.nan)
    strength = moments.constant * scale
    error = np.hypot(np.sqrt(moments.variance_constant) * scale, strength * of_model)
    if not absolute:
        inside = strength[np.isfinite(strength)]
        bright = float(np.percentile(inside, _BRIGHT)) if inside.size else 1.0
        strength, error = strength / bright, error / bright
    valid = np.isfinite(strength)
    return {
        "specular": strength.astype(np.float32),
        "specular_error": error.astype(np.float32),
        "roughness": np.where(valid, width.value, np.nan).astype(np.float32),
        "roughness_error": np.where(valid, width.error, np.nan).astype(np.float32),
        "stats": {"roughness": float(np.median(width.value[valid])) if valid.any() else float("nan")},
    }


def prepare(
    *,
    absolute: bool,
    shape: Sequence[int],
    camera: Mapping[str, Any] | None,
    lights: Mapping[str, Any] | None,
) -> Mapping[str, Any]:
    """The rig's camera and lights, for pictures of `shape` (rows, columns).

    Args:
        camera, lights: what `kernels.items.lens_of` and `lights_of` take of the items; None where there is no
            surface that they light.
    """
    setup = None
    if camera is not None and lights is not None:
        setup = Setup(Pinhole.of(camera, (int(shape[0]), int(shape[1]))), Lights.of(lights, near=True))
    return {"setup": setup, "absolute": absolute}


def _upright(normal: Image) -> Array:
    """(y, x, xyz)."""
    return np.moveaxis(np.asarray(normal, np.float64), 0, 2)


def _known(moments: Moments, normal: Array) -> Mask:
    return np.isfinite(normal).all(axis=2) & np.isfinite(moments.constant)


def _surface(moments: Moments, normal: Array, depth_mm: Image, visibility: Image | None) -> Surface:
    depth = np.asarray(depth_mm, np.float64)
    return Surface(normal, depth, visibility, _known(moments, normal) & np.isfinite(depth))


def _under_a_sphere(
    moments: Moments, normal: Array, index: float, spread: float
) -> tuple[Mask, Widths, Array, Array]:
    """Where all is known, the width, s for w = 1, and its relative error by that of the width."""
    known = _known(moments, normal)
    lobes = sphere_lobes(normal[..., 2], known, index)
    width = find_widths(moments, lobes, known, spread)
    expected = at_width(lobes.constant, width.value)
    wider = at_width(lobes.constant, np.minimum(width.value * np.exp(_STEP), WIDTHS[-1]))
    of_model = _relative(wider, expected)
    of_model *= width.error / (width.value * _STEP)
    return known, width, expected, of_model


def _rig_widths(moments: Moments, surface: Surface, setup: Setup, index: float, spread: float) -> Widths:
    """Found in smaller pictures where these are wide."""
    factor = max(1, round(surface.known.shape[1] / _COARSE_PX))
    if factor == 1:
        return find_widths(moments, _rig_lobes(surface, setup, index), surface.known, spread)
    few, coarse = _smaller(moments, surface, factor)
    camera = setup.camera.smaller(factor)
    lobes = _rig_lobes(coarse, setup._replace(camera=camera), index)
    widths = find_widths(few, lobes, coarse.known, spread)
    height, width = surface.known.shape
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    where = ((x + 0.5) / factor - 0.5, (y + 0.5) / factor - 0.5)
    large = [
        cv2.remap(v.astype(np.float32), *where, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) for v in widths
    ]
    return Widths(*(np.asarray(v, np.float64) for v in large))


def _smaller(moments: Moments, surface: Surface, factor: int) -> tuple[Moments, Surface]:
    """Binned: `factor` x `factor` pixels are one."""
    known = surface.known
    share = binned(known.astype(float), factor)

    def mean(values: NDArray[Any]) -> Array:
        return binned(np.where(known, values, 0), factor) / np.maximum(share, 1e-9)

    less = factor**2 * np.maximum(share, 1e-9)
    vector = np.stack([mean(moments.vector[..., i]) for i in range(3)], axis=-1)
    of_constant = mean(moments.variance_constant) / less
    few = Moments(mean(moments.constant), vector, mean(moments.variance) / less, of_constant)
    normal = np.stack([mean(surface.normal[..., i]) for i in range(3)], axis=-1)
    normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-9)
    layers = None
    if surface.visibility is not None:
        layers = np.stack([mean(layer) for layer in surface.visibility]).astype(np.float32)
    return few, Surface(normal, mean(surface.depth), layers, share > 0.5)


def _rig_lobes(surface: Surface, setup: Setup, index: float) -> Lobes:
    """Under the rig's lights."""
    known = surface.known
    points, view = _placed(surface, setup.camera)
    shadow = None
    if surface.visibility is not None:
        shadow = np.ascontiguousarray(surface.visibility[:, known].T, np.float32)
    constant, vector = response(surface.normal[known], points, view, setup.lights, WIDTHS, index, shadow)
    out = Lobes(*np.zeros((2, len(WIDTHS), *known.shape)))
    out.constant[:, known] = constant
    out.square[:, known] = np.einsum("api,api->ap", vector, vector)
    return out


def _expected(surface: Surface, width: Array, setup: Setup, index: float) -> Array:
    """(y, x): s for w = 1."""
    known, lights = surface.known, setup.lights
    points, view = _placed(surface, setup.camera)
    each = shines(surface.normal[known], points, view, width[known], lights.position, lights.distance, index)
    power = lights.power.astype(np.float32)
    if surface.visibility is not None:
        power = surface.visibility[:, known].T * power
    out = np.zeros(known.shape)
    out[known] = (each * power).sum(axis=1, dtype=np.float64)
    return out


def _model_error(surface: Surface, width: Widths, expected: Array, setup: Setup, index: float) -> Array:
    """(y, x): relative standard error of s by the width, the normals and where shadows end."""
    wider = _expected(surface, width.value * np.exp(_STEP), setup, index)
    square = (_relative(wider, expected) * width.error / (width.value * _STEP)) ** 2
    sideways = np.cross(surface.normal, np.array([0.0, 1.0, 0.0]))
    sideways /= np.maximum(np.linalg.norm(sideways, axis=2, keepdims=True), 1e-9)
    for axis in (sideways, np.cross(surface.normal, sideways)):
        tilted = surface.normal + np.radians(_TILT_DEG) * axis
        tilted /= np.linalg.norm(tilted, axis=2, keepdims=True)
        turned = _expected(surface._replace(normal=tilted), width.value, setup, index)
        square += _relative(turned, expected) ** 2
    if surface.visibility is not None:
        opened = _expected(surface._replace(visibility=None), width.value, setup, index)
        share = expected / np.maximum(opened, 1e-30)
        spread = local_mean(share**2, surface.known, _EDGE_PX) - local_mean(share, surface.known, _EDGE_PX) ** 2
        square += np.maximum(spread, 0) / np.maximum(share, 1e-9) ** 2
    return np.sqrt(square)


def _relative(changed: Array, expected: Array) -> Array:
    return np.asarray((changed - expected) / np.maximum(expected, 1e-30))


def _placed(surface: Surface, camera: Pinhole) -> tuple[Array, Array]:
    """(point, xyz): places, mm, and unit vectors to the camera."""
    points = camera.points(surface.depth)[surface.known]
    view = camera.centre - points
    return points, view / np.linalg.norm(view, axis=1, keepdims=True)

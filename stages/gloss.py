"""gloss: how strong and how rough the specular reflection is, from its constant picture and its norm.

`microfacets.py` has the model: a GGX lobe of width a and intensity w under the rig's lights. Its norm |m| / (2 s)
falls with a and does not depend on w; with a known, the brightness tells w:

    a:  blur(|m|^2 - 3 v_m) / blur(s^2 - v_s) = blur(|m_a|^2) / blur(s_a^2)      w = s / s_a ,

m, s measured; m_a, s_a the model's for w = 1 at each point of the found surface; v_m, v_s the variances of the
noise, measured in the capture (a gradient and its complement add up to constant light, whatever the subject) and
taken off because noise makes |m| longer. Specular light is the same in every band, so all bands are one, weighted
by that noise.

A pixel's norm is too noisy to tell a width. So a is found from wide neighbourhoods to narrow ones, and each
narrower one moves ln a only as far as its predicted error allows (a Gaussian prior of `spread` for each halving).
The standard error of a is that of the pictures' noise. In that of w are also the errors of a, of the surface's
normals (_TILT_DEG each way), and of where shadows end (the light seen as it varies over _EDGE_PX), to first order:

    (dw/w)^2 = v_s / s^2 + (d ln s_a / d ln a)^2 (da/a)^2 + sum over tilts (ds_a/s_a)^2 + var(q) / q^2

with q = s_a / s_open.

Noise of darks and flats is in neither.

With no surface, or no placed lights, the model is a whole sphere of light. Then a is some tens of per cent off on a
rig of few lights, and the intensity is relative.

Must have run before: align and normals, twice (of the specular component, and the surface). Limits: between lights
there is nothing to reflect, so lobes narrower than the lights' spacing are not told apart (41 lights stand 32
degrees apart: below a = 0.1 the norm hardly changes); one lobe a point; light that polarisers split is taken as
split evenly at every angle; light that was reflected twice counts as once.

Sources: Ma et al. (2007) 3.2 for specular gradients; Walter et al. (2007) for the lobe; Ghosh et al. (2009),
doi:10.1111/j.1467-8659.2009.01493.x, for roughness from moments of the lobe (they use second-order gradients). The
comparison with the rig's own response is ours.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Needs, Output, Params, Stage, StageError
from lightstage.kernels.appearance.microfacets import at_normal_incidence, response, shines, sphere_response
from lightstage.kernels.normals.near_light import Lights, binned
from lightstage.kernels.surface.pinhole import Pinhole

Image = NDArray[np.float32]
Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

WIDTHS: Array = np.geomspace(0.05, 0.8, 18)
"""GGX widths that are told; beyond them a result is at the end."""
_WINDOWS_PX = (32.0, 16.0, 8.0, 4.0, 2.0)
"""Sigma of the neighbourhoods, in pixels of the pictures that roughness is found in."""
_COARSE_PX = 420
"""Roughness of wider pictures is found in pictures binned to about this width; its neighbourhoods are wider yet."""
_NOISE_PX = 8.0
_DARK = 0.05
"""Of the median: where the model has less specular light, the quotient is the error of the model."""
_LEAST_SLOPE = 0.02
"""d norm / d ln a below which a norm tells no width."""
_FACING = np.linspace(0.05, 1, 20)
_TILT_DEG = 1.5
"""One sigma of each component of the surface's normals, whose error is 1.5 to 3 degrees in the mean on rendered
subjects (docs/methods/near-light.md)."""
_EDGE_PX = 1.5
_STEP = 0.05
"""Of ln a, in a difference quotient."""
_BRIGHT = 99.5
"""Percentile that is 1 when the intensity is relative."""


class GlossParams(Params):
    """Parameters of `gloss`."""

    index: float = Field(1.4, gt=1.0, le=3.0, description="refractive index; decides how bright grazing light is")
    spread: float = Field(
        0.15,
        gt=0,
        le=2,
        description="how much ln roughness differs between a neighbourhood and its middle; smaller is smoother",
    )


class Measured(NamedTuple):
    """All bands as one; NaN where not valid."""

    constant: Array
    """(y, x): s."""
    vector: Array
    """(y, x, xyz): m."""
    variance: Array
    """(y, x): of the noise of a component of m."""
    variance_constant: Array
    """(y, x): of s."""


class Model(NamedTuple):
    """What lobes of WIDTHS show, for w = 1."""

    constant: Array
    """(width, y, x)."""
    square: Array
    """(width, y, x): |m|^2."""


def gloss(
    radiance: Sequence[Image],
    specular_normal: Sequence[Image],
    normal: Sequence[Image],
    depth_mm: Sequence[Image],
    visibility: Sequence[Image],
    *,
    names: Sequence[str],
    camera: Pinhole | None,
    lights: Lights | None,
    absolute: bool,
    index: float,
    spread: float,
) -> Mapping[str, Any]:
    """Specular intensity and roughness of one tracking frame.

    Args:
        radiance: per band the pictures of `names`, (y, x), specular component; NaN where not valid.
        specular_normal: one (xyz, y, x), world: the surface where there is no other.
        normal: one (xyz, y, x), world. depth_mm: none, or one (y, x), camera z. visibility: none, or (light, y, x).
        names: illuminations: for every axis a gradient, its complement, or both; and C or a pair.
        camera, lights: the rig's; None where the model is a sphere of light.
        absolute: whether radiance has an absolute scale.
        index, spread: see GlossParams.

    Returns:
        `specular` (y, x): reflectance at normal incidence, relative where not `absolute`; `specular_error`, its
        standard error; `roughness` (y, x): GGX width; `roughness_error`. float32, NaN where not valid.
    """
    count = len(names)
    bands = [{name: radiance[b * count + i] for i, name in enumerate(names)} for b in range(len(radiance) // count)]
    measured = measure(bands)
    surface = bool(len(depth_mm)) and camera is not None and lights is not None
    turned = np.moveaxis(np.asarray(normal[0] if surface else specular_normal[0], np.float64), 0, 2)
    known = np.isfinite(turned).all(axis=2) & np.isfinite(measured.constant)
    if not surface or camera is None or lights is None:
        facing = np.clip(turned[..., 2], _FACING[0], 1)
        model = _sphere(np.where(known, facing, 1), index)
        width = _widths(measured, model, known, spread)
        expected = _at(model.constant, width.value)
        of_model = _relative(_at(model.constant, np.minimum(width.value * np.exp(_STEP), WIDTHS[-1])), expected)
        of_model *= width.error / (width.value * _STEP)
    else:
        depth = np.asarray(depth_mm[0], np.float64)
        known &= np.isfinite(depth)
        seen = visibility[0] if len(visibility) else None
        factor = max(1, round(known.shape[1] / _COARSE_PX))
        width = _rig_widths(measured, turned, depth, seen, known, camera, lights, index, spread, factor)
        lit = Lit(turned, depth, seen, known, width.value)
        expected = _expected(lit, camera, lights, index)
        of_model = _model_error(lit, width, expected, camera, lights, index)
    usual = float(np.median(expected[known])) if known.any() else 1.0
    known &= expected > _DARK * usual
    scale = at_normal_incidence(index) / np.where(known, expected, np.nan)
    strength = measured.constant * scale
    error = np.hypot(np.sqrt(measured.variance_constant) * scale, strength * of_model)
    if not absolute:
        inside = strength[np.isfinite(strength)]
        bright = float(np.percentile(inside, _BRIGHT)) if inside.size else 1.0
        strength, error = strength / bright, error / bright
    told = np.isfinite(strength)
    return {
        "specular": strength.astype(np.float32),
        "specular_error": error.astype(np.float32),
        "roughness": np.where(told, width.value, np.nan).astype(np.float32),
        "roughness_error": np.where(told, width.error, np.nan).astype(np.float32),
        "stats": {"roughness": float(np.median(width.value[told])) if told.any() else float("nan")},
    }


def measure(bands: Sequence[Mapping[str, Image]]) -> Measured:
    """s and m of the specular component, bands weighted by their noise.

    Args:
        bands: per band, pictures (y, x) by illumination.
    """
    shape = next(iter(bands[0].values())).shape
    total, weights = np.zeros((*shape, 4)), np.zeros(shape)
    for pictures in bands:
        part, known = _vector(pictures)
        weight = np.where(known, 1 / _noise(pictures, known), 0)
        total += weight[..., None] * np.where(known[..., None], part, 0)
        weights += weight
    weights = np.where(weights > 0, weights, np.nan)
    total /= weights[..., None]
    pairs = sum(a in bands[0] and a + "c" in bands[0] for a in "XYZ") + int("C" in bands[0])
    # shot noise: a pair's sum is as noisy as C, and so is its difference
    return Measured(total[..., 3], total[..., :3], 1 / weights, 1 / weights / pairs)


def _vector(pictures: Mapping[str, Image]) -> tuple[Array, Mask]:
    """(y, x, 4): m and s, and where all pictures are valid."""
    whole = [pictures["C"]] if "C" in pictures else []
    whole += [pictures[a] + pictures[a + "c"] for a in "XYZ" if a in pictures and a + "c" in pictures]
    constant = np.mean(np.stack(whole), axis=0, dtype=np.float64)
    out = np.empty((*constant.shape, 4))
    out[..., 3] = constant
    for i, axis in enumerate("XYZ"):
        if axis in pictures and axis + "c" in pictures:
            out[..., i] = pictures[axis] - pictures[axis + "c"]
        else:
            out[..., i] = 2 * pictures[axis] - constant if axis in pictures else constant - 2 * pictures[axis + "c"]
    return out, np.asarray(np.isfinite(out).all(axis=2))


def _noise(pictures: Mapping[str, Image], known: Mask) -> Array:
    """(y, x): variance of a constant picture around each pixel. The specular component is the difference of two
    cameras, so its noise is mostly the diffuse light's, and does not follow from its own brightness."""
    pairs = [a for a in "XYZ" if a in pictures and a + "c" in pictures and "C" in pictures]
    if pairs:
        off = [(pictures[a] + pictures[a + "c"] - pictures["C"]).astype(np.float64) ** 2 / 2 for a in pairs]
    else:
        # the finest detail (Immerkaer 1996)
        mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float64) / 6
        picture = next(iter(pictures.values())).astype(np.float64)
        off = [cv2.filter2D(np.where(known, picture, 0), -1, mask) ** 2]
    around = _mean(np.mean(off, axis=0), known, _NOISE_PX)
    least = float(np.max(around[known], initial=0.0)) * 1e-6
    return np.maximum(around, max(least, 1e-30))


class Widths(NamedTuple):
    """Roughness and its standard error, (y, x)."""

    value: Array
    error: Array


def _widths(measured: Measured, model: Model, known: Mask, spread: float) -> Widths:
    """From wide neighbourhoods to narrow ones."""
    square = np.einsum("yxi,yxi->yx", measured.vector, measured.vector) - 3 * measured.variance
    level = measured.constant**2 - measured.variance_constant
    noisy = 4 * np.maximum(square, 0) * measured.variance + 6 * measured.variance**2
    noisy_level = 4 * np.maximum(level, 0) * measured.variance_constant + 2 * measured.variance_constant**2
    log_width = np.zeros(known.shape)
    weights: list[Array] = []
    deviations: list[Array] = []
    for step, sigma in enumerate(_WINDOWS_PX):
        up, down = _mean(square, known, sigma), _mean(level, known, sigma)
        norm = 0.5 * np.sqrt(np.maximum(up, 0) / np.maximum(down, 1e-30))
        expected = [
            0.5 * np.sqrt(_mean(m, known, sigma) / np.maximum(_mean(s**2, known, sigma), 1e-30))
            for m, s in zip(model.square, model.constant, strict=True)
        ]
        here, slope = _crossing(np.stack(expected), norm)
        # a Gaussian window of sigma averages the variance of 4 pi sigma^2 pixels
        pixels = 4 * np.pi * sigma**2 * np.maximum(_mean(known.astype(float), known | True, sigma), 1e-6)
        narrow = sigma / np.sqrt(2)
        relative = _mean(noisy, known, narrow) / np.maximum(up, 1e-30) ** 2
        relative += _mean(noisy_level, known, narrow) / np.maximum(down, 1e-30) ** 2
        own = norm**2 * relative / (4 * pixels) / np.maximum(slope, _LEAST_SLOPE) ** 2
        if step == 0:
            middle = float(np.median(here[known])) if known.any() else 0.0
            log_width = np.where(np.isfinite(here), here, middle)
            gain = np.ones(known.shape)
        else:
            gain = spread**2 / (spread**2 + own)
            log_width = log_width + gain * (here - log_width)
        weights = [*(weight * (1 - gain) for weight in weights), gain]
        deviations.append(np.sqrt(own))
    return Widths(np.exp(log_width), np.exp(log_width) * np.sqrt(_summed(weights, deviations)))


def _summed(weights: Sequence[Array], deviations: Sequence[Array]) -> Array:
    """Variance of a weighted sum of what the neighbourhoods of _WINDOWS_PX tell.

    A narrow neighbourhood lies within the wide ones, so their noise is correlated: two Gaussian windows of sigma s
    and t, over white noise, with 2 s t / (s^2 + t^2).
    """
    parts = [weight * deviation for weight, deviation in zip(weights, deviations, strict=True)]
    total = np.zeros(parts[0].shape)
    for s, one in zip(_WINDOWS_PX, parts, strict=True):
        for t, other in zip(_WINDOWS_PX, parts, strict=True):
            total += 2 * s * t / (s**2 + t**2) * one * other
    return total


def _crossing(expected: Array, norm: Array) -> tuple[Array, Array]:
    """ln a at which the model has the measured norm, and -d norm / d ln a there, (y, x)."""
    falling = np.minimum.accumulate(expected, axis=0)
    logs = np.log(WIDTHS)
    below = np.clip((falling > norm).sum(axis=0), 1, len(WIDTHS) - 1)[None]
    high = np.take_along_axis(falling, below - 1, axis=0)[0]
    low = np.take_along_axis(falling, below, axis=0)[0]
    part = np.clip((high - norm) / np.maximum(high - low, 1e-12), 0, 1)
    step = logs[1] - logs[0]
    return logs[below[0] - 1] + part * step, (high - low) / step


def _mean(values: Array, known: Mask, sigma: float) -> Array:
    """Gaussian mean over what is known."""
    inside = known.astype(np.float64)
    top = cv2.GaussianBlur(np.where(known, values, 0.0), (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
    share = cv2.GaussianBlur(inside, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(top / np.maximum(share, 1e-9))


def _at(model: Array, width: Array) -> Array:
    """The model (width, y, x) at the width of each pixel."""
    place = np.log(width / WIDTHS[0]) / np.log(WIDTHS[1] / WIDTHS[0])
    below = np.clip(place.astype(int), 0, len(WIDTHS) - 2)
    part = np.clip(place - below, 0, 1)
    low, high = (np.take_along_axis(model, (below + i)[None], axis=0)[0] for i in (0, 1))
    return np.asarray(low + part * (high - low))


def _sphere(facing: Array, index: float) -> Model:
    constant, norm = sphere_response(_FACING, WIDTHS, index)
    at = np.stack([np.interp(facing, _FACING, row) for row in constant])
    length = np.stack([np.interp(facing, _FACING, row) for row in norm])
    return Model(at, (2 * length * at) ** 2)


def _rig_widths(
    measured: Measured, normal: Array, depth: Array, seen: Image | None, known: Mask,
    camera: Pinhole, lights: Lights, index: float, spread: float, factor: int,
) -> Widths:  # fmt: skip
    if factor > 1:
        share = binned(known.astype(float), factor)
        small = share > 0.5

        def mean(values: NDArray[Any]) -> Array:
            return binned(np.where(known, values, 0), factor) / np.maximum(share, 1e-9)

        less = factor**2 * np.maximum(share, 1e-9)
        vector = np.stack([mean(measured.vector[..., i]) for i in range(3)], axis=-1)
        of_constant = mean(measured.variance_constant) / less
        few = Measured(mean(measured.constant), vector, mean(measured.variance) / less, of_constant)
        turned = np.stack([mean(normal[..., i]) for i in range(3)], axis=-1)
        turned /= np.maximum(np.linalg.norm(turned, axis=2, keepdims=True), 1e-9)
        layers = None if seen is None else np.stack([mean(layer) for layer in seen]).astype(np.float32)
        model = _rig(turned, mean(depth), layers, small, camera.smaller(factor), lights, index)
        found = _widths(few, model, small, spread)
        height, width = known.shape
        y, x = np.mgrid[0:height, 0:width].astype(np.float32)
        where = ((x + 0.5) / factor - 0.5, (y + 0.5) / factor - 0.5)
        large = [
            cv2.remap(v.astype(np.float32), *where, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            for v in found
        ]
        return Widths(*(np.asarray(v, np.float64) for v in large))
    return _widths(measured, _rig(normal, depth, seen, known, camera, lights, index), known, spread)


def _rig(
    normal: Array, depth: Array, seen: Image | None, known: Mask, camera: Pinhole, lights: Lights, index: float
) -> Model:
    points, view = _placed(depth, known, camera)
    shadow = None if seen is None else np.ascontiguousarray(seen[:, known].T, np.float32)
    constant, vector = response(normal[known], points, view, lights, WIDTHS, index, shadow)
    out = Model(*np.zeros((2, len(WIDTHS), *known.shape)))
    out.constant[:, known] = constant
    out.square[:, known] = np.einsum("api,api->ap", vector, vector)
    return out


class Lit(NamedTuple):
    """A surface under the rig, (y, x, ...)."""

    normal: Array
    depth: Array
    seen: Image | None
    """(light, y, x)."""
    known: Mask
    width: Array


def _expected(lit: Lit, camera: Pinhole, lights: Lights, index: float) -> Array:
    """(y, x): s for w = 1."""
    points, view = _placed(lit.depth, lit.known, camera)
    normal, width = lit.normal[lit.known], lit.width[lit.known]
    each = shines(normal, points, view, width, lights.position, lights.distance, index)
    power = lights.power.astype(np.float32)
    if lit.seen is not None:
        power = lit.seen[:, lit.known].T * power
    out = np.zeros(lit.known.shape)
    out[lit.known] = (each * power).sum(axis=1, dtype=np.float64)
    return out


def _model_error(lit: Lit, width: Widths, expected: Array, camera: Pinhole, lights: Lights, index: float) -> Array:
    """(y, x): relative standard error of s by the width, the normals and where shadows end."""
    wider = _expected(lit._replace(width=lit.width * np.exp(_STEP)), camera, lights, index)
    square = (_relative(wider, expected) * width.error / (width.value * _STEP)) ** 2
    sideways = np.cross(lit.normal, np.array([0.0, 1.0, 0.0]))
    sideways /= np.maximum(np.linalg.norm(sideways, axis=2, keepdims=True), 1e-9)
    for axis in (sideways, np.cross(lit.normal, sideways)):
        tilted = lit.normal + np.radians(_TILT_DEG) * axis
        tilted /= np.linalg.norm(tilted, axis=2, keepdims=True)
        square += _relative(_expected(lit._replace(normal=tilted), camera, lights, index), expected) ** 2
    if lit.seen is not None:
        opened = _expected(lit._replace(seen=None), camera, lights, index)
        share = expected / np.maximum(opened, 1e-30)
        spread = _mean(share**2, lit.known, _EDGE_PX) - _mean(share, lit.known, _EDGE_PX) ** 2
        square += np.maximum(spread, 0) / np.maximum(share, 1e-9) ** 2
    return np.sqrt(square)


def _relative(changed: Array, expected: Array) -> Array:
    return np.asarray((changed - expected) / np.maximum(expected, 1e-30))


def _placed(depth: Array, known: Mask, camera: Pinhole) -> tuple[Array, Array]:
    """(point, xyz): places, mm, and unit vectors to the camera."""
    points = camera.points(depth)[known]
    view = camera.centre - points
    return points, view / np.linalg.norm(view, axis=1, keepdims=True)


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: GlossParams
) -> Mapping[str, Any]:
    camera = lights = None
    if labels["surface"]:
        lights = Lights.part_of(items["lights"])
        camera = {name: items["camera"][name] for name in ("size_px", "K", "distortion", "world_to_camera")}
    told = {name: labels[name] for name in ("names", "absolute", "shape")}
    return {**told, "camera": camera, "lights": lights}


def _prepare(
    *,
    names: Sequence[str],
    absolute: bool,
    shape: Sequence[int],
    camera: Mapping[str, Any] | None,
    lights: Mapping[str, Any] | None,
) -> Mapping[str, Any]:
    return {
        "names": tuple(names),
        "absolute": absolute,
        "camera": None if camera is None else Pinhole.of(camera, (int(shape[0]), int(shape[1]))),
        "lights": None if lights is None else Lights.of(lights, near=True),
    }


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: GlossParams) -> Arrangement:
    aligned, specular, relief = grids
    if specular.attrs.get("component") != "specular":
        raise StageError(
            "gloss reads align, normals of the specular component, and the surface, in this order: "
            "from: [align, specular, relief]"
        )
    component = list(aligned.along("component")).index("specular")
    surface = "depth_mm" in relief.arrays and facts["lights_placed"] and "camera" in facts["items"]
    absolute = surface and "bands" in facts["items"]
    bands = aligned.sizes["band"]
    where = {frame: t for t, frame in enumerate(aligned.along("tracking"))}
    of_specular = list(specular.along("tracking"))
    groups, frames = [], []
    for k, frame in enumerate(relief.along("tracking")):
        if frame not in of_specular:
            continue
        t = where[frame]
        members = zip(aligned.along("illumination")[t], aligned.along("frame")[t], strict=True)
        names = {n: m for m, (n, at) in enumerate(members) if n and (n != "C" or at == frame)}
        _check(names)
        pieces = [
            {"tracking": t, "member": m, "band": b, "component": component}
            for b in range(bands)
            for m in names.values()
        ]
        one = {"tracking": k}
        reads = {
            "radiance": pieces,
            "specular_normal": [{"tracking": of_specular.index(frame), "band": 0}],
            "normal": [{**one, "band": 0}],
            "depth_mm": [one],
            "visibility": [one],
        }
        told = {
            "names": list(names),
            "surface": surface,
            "absolute": absolute,
            "shape": [aligned.sizes["y"], aligned.sizes["x"]],
        }
        groups.append(Group(reads, told))
        frames.append(frame)
    labels: dict[str, tuple[tuple[str, ...], Sequence[Any]]] = {"tracking": (("tracking",), frames)}
    if "time_s" in relief.labels:
        when = dict(zip(relief.along("tracking"), relief.along("time_s"), strict=True))
        labels["time_s"] = (("tracking",), [when[frame] for frame in frames])
    attrs = {
        "model": "rig" if surface else "sphere",
        "scale": "absolute" if absolute else "relative",
        "index": params.index,
        "lobe": "GGX, separable Smith shadowing, Fresnel's reflectance of the index",
    }
    sizes = {"tracking": len(groups), "y": aligned.sizes["y"], "x": aligned.sizes["x"]}
    return Arrangement(Grid(sizes, labels, attrs), tuple(groups))


def _check(names: Mapping[str, int]) -> None:
    axes = all(a in names or a + "c" in names for a in "XYZ")
    whole = "C" in names or any(a in names and a + "c" in names for a in "XYZ")
    if not axes or not whole:
        raise StageError(
            "gloss needs a gradient of every axis, and C or a gradient with its complement; the session has "
            + " ".join(names)
        )


STAGE = Stage(
    name="gloss",
    version=1,
    summary="specular intensity and roughness",
    params=GlossParams,
    inputs={
        "radiance": Input("aligned", ("tracking", "member", "band", "component", "y", "x"), "group"),
        "specular_normal": Input("normal", ("tracking", "band", "xyz", "y", "x"), "group", source=1),
        "normal": Input("normal", ("tracking", "band", "xyz", "y", "x"), "group", source=2),
        "depth_mm": Input("depth_mm", ("tracking", "y", "x"), "group", source=2, optional=True),
        "visibility": Input("visibility", ("tracking", "light", "y", "x"), "group", source=2, optional=True),
    },
    calibration={
        "lights": Needs(why="the lobe is compared with a sphere of light, and the intensity is relative"),
        "camera": Needs(why="the lobe is compared with a sphere of light, and the intensity is relative"),
        "bands": Needs(why="the specular intensity is relative"),
    },
    outputs={
        "specular": Output(
            ("tracking", "y", "x"),
            "float32",
            attrs={"units": "1", "long_name": "specular reflectance at normal incidence"},
        ),
        "specular_error": Output(
            ("tracking", "y", "x"), "float32", attrs={"units": "1", "long_name": "standard error of specular"}
        ),
        "roughness": Output(("tracking", "y", "x"), "float32", attrs={"units": "1", "long_name": "GGX alpha"}),
        "roughness_error": Output(
            ("tracking", "y", "x"),
            "float32",
            attrs={"units": "1", "long_name": "standard error of roughness, by noise"},
        ),
    },
    blocks=("tracking",),
    arrange=_arrange,
    context=_context,
    prepare=_prepare,
    prepared=("names", "camera", "lights", "absolute"),
    kernel=gloss,
)

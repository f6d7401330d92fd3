"""reflectance: the albedo of the diffuse component in every band, with its standard error.

    rho_b = r_b / (S + B_b)

r_b is constant light, from C and from every gradient with its complement (r_a + r_a' = r_c), weighted by their
noise; S the irradiance that reaches the point directly, attached and cast shadows in (from `normals` with a model
of the rig), B_b what arrives by way of other points (radiosity on the found surface, a band at a time, because it
depends on the albedo around). All in radiance of a white surface, so with a `bands` item, which is measured on a
white target, rho is absolute; not so of a parallel camera alone, and without any polariser gloss is in it.

Without a surface there is no S: `smooth` takes the low frequencies of constant light, all bands together, for the
shading. That takes what is smooth in the skin with it, and rho is right up to it. Without lights or bands rho is
relative: 1 is the brightest point.

The standard error is that of the pictures' noise, measured in the capture (`noise.noise_model`); the error of
S is not in it.

Must have run before: align and normals.

Sources: Ma et al. (2007) for constant light as albedo; Goral et al. (1984), doi:10.1145/964965.808601, for
radiosity; Horn (1974), doi:10.1016/0146-664X(74)90022-7, for smooth shading.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Needs, Output, Params, Stage, StageError
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


class ReflectanceParams(Params):
    """Parameters of `reflectance`."""

    shading: Literal["auto", "geometry", "smooth", "none"] = Field(
        "auto",
        description="what is divided out: geometry: what the found surface receives; smooth: low frequencies of "
        "constant light; auto: geometry where there is one",
    )
    bounced: Literal["removed", "kept"] = Field(
        "removed", description="light that arrives by way of other points; with geometry and an absolute scale"
    )


def reflectance(
    radiance: Sequence[Image],
    irradiance: Sequence[Image],
    normal: Sequence[Image],
    depth_mm: Sequence[Image],
    *,
    names: Sequence[str],
    shading: str,
    white: float | None,
    camera: Pinhole | None,
    bounced: str,
) -> Mapping[str, Any]:
    """Reflectance of one tracking frame.

    Args:
        radiance: per band the pictures of `names`, (y, x), diffuse component; NaN where not valid.
        irradiance: none, or one (y, x): S.
        normal: none, or one (xyz, y, x), world. depth_mm: none, or one (y, x), camera z.
        names: illuminations: C, or gradients with their complements, or both.
        shading: geometry, smooth or none.
        white: radiance of a white surface at the stage's centre that faces the camera under constant light; None
            where it is not known.
        camera: what bounced light needs; None where it is not to be taken out.
        bounced: see ReflectanceParams.

    Returns:
        `reflectance` and `standard_error` (band, y, x), `shading` (y, x): what was divided out, relative to
        `white`, the mean over bands. NaN where not valid.
    """
    count = len(names)
    bands = len(radiance) // count
    pictures = [{name: radiance[b * count + i] for i, name in enumerate(names)} for b in range(bands)]
    constant, variance = (np.stack(parts) for parts in zip(*map(_constant, pictures), strict=True))
    if shading == "geometry":
        arrives = _arrives(constant, irradiance[0], normal, depth_mm, camera if bounced == "removed" else None)
        level = white or float(np.nanmedian(irradiance[0]))
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


def _constant(pictures: Mapping[str, Image]) -> tuple[Image, Image]:
    """r_c of one band (y, x) and its variance: C and each pair that adds up to it, weighted by their noise."""
    alpha, beta = noise_model(pictures)
    estimates = [(pictures["C"], 1)] if "C" in pictures else []
    estimates += [(pictures[a] + pictures[a + "c"], 2) for a in "XYZ" if a in pictures and a + "c" in pictures]
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


def _arrives(
    constant: Image, direct: Image, normal: Sequence[Image], depth_mm: Sequence[Image], camera: Pinhole | None
) -> Image:
    """S + B_b, (band, y, x)."""
    if camera is None or not len(normal) or not len(depth_mm):
        return np.broadcast_to(direct, constant.shape)
    turned, depth = np.moveaxis(normal[0], 0, 2).astype(np.float64), depth_mm[0].astype(np.float64)
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
    sigma = _SMOOTH * constant.shape[2]
    part = cv2.GaussianBlur(subject.astype(np.float64), (0, 0), sigma)
    low = cv2.GaussianBlur(log, (0, 0), sigma) / np.maximum(part, 1e-6)
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


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: ReflectanceParams
) -> Mapping[str, Any]:
    lights = None
    if labels["absolute"]:
        fields = ("position_mm", "direction", "power")
        lights = {"lights": [{k: light[k] for k in fields} for light in items["lights"]["lights"]]}
    camera = None
    if labels["shading"] == "geometry" and labels["absolute"] and "camera" in items:
        camera = {name: items["camera"][name] for name in ("size_px", "K", "distortion", "world_to_camera")}
    return {
        "names": labels["names"],
        "shading": labels["shading"],
        "shape": labels["shape"],
        "lights": lights,
        "camera": camera,
    }


def _prepare(
    *,
    names: Sequence[str],
    shading: str,
    shape: Sequence[int],
    lights: Mapping[str, Any] | None,
    camera: Mapping[str, Any] | None,
) -> Mapping[str, Any]:
    return {
        "names": tuple(names),
        "shading": shading,
        "white": None if lights is None else white_radiance(lights),
        "camera": None if camera is None else Pinhole.of(camera, (int(shape[0]), int(shape[1]))),
    }


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: ReflectanceParams) -> Arrangement:
    aligned, relief = grids
    surface = "irradiance" in relief.arrays
    shading = params.shading if params.shading != "auto" else ("geometry" if surface else "smooth")
    if shading == "geometry" and not surface:
        raise StageError(
            "shading: geometry needs a surface: normals above with correct: near+shadows or full, which need the "
            "lights and camera items; shading: smooth does without"
        )
    components = list(aligned.along("component"))
    component = next(c for c in ("diffuse", "total", components[0]) if c in components)
    members = list(aligned.along("illumination"))
    where = {frame: t for t, frame in enumerate(aligned.along("tracking"))}
    # parallel light alone is half of the diffuse light and all of the specular, in parts that nobody knows
    told = list(facts["polarisation"]) != ["parallel"]
    absolute = "bands" in facts["items"] and bool(facts["light_ids"]) and told
    bands = list(aligned.along("band"))
    height, width = aligned.sizes["y"], aligned.sizes["x"]
    still = facts["frame_rate_hz"] is None
    groups = []
    for k, frame in enumerate(relief.along("tracking")):
        t = where[frame]
        names = _used(members[t], aligned.along("frame")[t], frame, still)
        if not names:
            have = " ".join(name for name in members[t] if name)
            raise StageError(
                "reflectance needs constant light: C, or a gradient and its complement; the session has " + have
            )
        one = {"tracking": k}
        groups.append(
            Group(
                {
                    "radiance": [
                        {"tracking": t, "member": m, "band": b, "component": components.index(component)}
                        for b in range(len(bands))
                        for m in names.values()
                    ],
                    "irradiance": [one],
                    "depth_mm": [one],
                    "normal": [{**one, "band": 0}],
                },
                {"names": list(names), "shading": shading, "absolute": absolute, "shape": [height, width]},
            )
        )
    sizes = {"tracking": len(groups), "band": len(bands), "y": height, "x": width}
    labels: dict[str, tuple[tuple[str, ...], Sequence[Any]]] = {
        "tracking": (("tracking",), list(relief.along("tracking"))),
        "band": (("band",), bands),
    }
    if "time_s" in relief.labels:
        labels["time_s"] = relief.labels["time_s"]
    attrs = {"shading": shading, "scale": "absolute" if absolute else "relative", "component": component}
    return Arrangement(Grid(sizes, labels, attrs), tuple(groups))


def _used(names: Sequence[str], frames: Sequence[int], tracking: int, still: bool) -> dict[str, int]:
    """Illumination -> member, of the pictures that tell constant light.

    Of a moving subject the tracking frame alone: what is a little misaligned would blur it.
    """
    own = {name: m for m, name in enumerate(names) if name and (name != "C" or frames[m] == tracking)}
    if not still and "C" in own:
        return {"C": own["C"]}
    paired = {n for a in "XYZ" if a in own and a + "c" in own for n in (a, a + "c")}
    return {name: m for name, m in own.items() if name == "C" or name in paired}


STAGE = Stage(
    name="reflectance",
    version=1,
    summary="albedo in every band, shading taken out",
    params=ReflectanceParams,
    inputs={
        "radiance": Input("aligned", ("tracking", "member", "band", "component", "y", "x"), "group"),
        "irradiance": Input("irradiance", ("tracking", "y", "x"), "group", source=1, optional=True),
        "normal": Input("normal", ("tracking", "band", "xyz", "y", "x"), "group", source=1),
        "depth_mm": Input("depth_mm", ("tracking", "y", "x"), "group", source=1, optional=True),
    },
    calibration={
        "lights": Needs(why="reflectance is relative"),
        "bands": Needs(why="reflectance is relative, and bands do not compare"),
        "camera": Needs(why="bounced light stays in"),
    },
    outputs={
        "reflectance": Output(("tracking", "band", "y", "x"), "float32", attrs={"units": "1"}),
        "standard_error": Output(
            ("tracking", "band", "y", "x"), "float32", attrs={"units": "1", "long_name": "of reflectance, by noise"}
        ),
        "shading": Output(
            ("tracking", "y", "x"),
            "float32",
            attrs={
                "units": "1",
                "long_name": "light that arrives, relative to an open surface that faces the camera",
            },
        ),
    },
    blocks=("tracking",),
    arrange=_arrange,
    context=_context,
    prepare=_prepare,
    prepared=("names", "shading", "white", "camera"),
    kernel=reflectance,
)

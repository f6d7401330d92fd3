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
from typing import Any

from pydantic import Field

from lightstage.dag.stage import (
    Arrangement,
    Grid,
    Group,
    Input,
    Items,
    Name,
    Needs,
    Output,
    Params,
    Stage,
    StageError,
)
from lightstage.hw.illuminations import AXES, CONSTANT, complement, pairs
from lightstage.kernels.items import lens_of, lights_of, lights_placed


class GlossParams(Params):
    """Parameters of `gloss`."""

    index: float = Field(1.4, gt=1.0, le=3.0, description="refractive index; decides how bright grazing light is")
    spread: float = Field(
        0.15,
        gt=0,
        le=2,
        description="how much ln roughness differs between a neighbourhood and its middle; smaller is smoother",
    )


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: GlossParams
) -> Mapping[str, Any]:
    camera = lights = None
    if labels["surface"]:
        lights, camera = lights_of(items["lights"]), lens_of(items["camera"])
    return {"absolute": labels["absolute"], "shape": labels["shape"], "camera": camera, "lights": lights}


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: GlossParams) -> Arrangement:
    aligned, specular, relief = grids
    if specular.attrs.get("component") != "specular":
        raise StageError(
            "gloss reads align, normals of the specular component, and the surface, in this order: "
            "from: [align, specular, relief]"
        )
    component = list(aligned.along("component")).index("specular")
    items = facts["items"]
    placed = "camera" in items and "lights" in items and lights_placed(items["lights"])
    surface = placed and "depth_mm" in relief.arrays
    absolute = surface and "bands" in items
    where = {frame: t for t, frame in enumerate(aligned.along("tracking"))}
    of_specular = list(specular.along("tracking"))
    groups, frames = [], []
    for k, frame in enumerate(relief.along("tracking")):
        if frame not in of_specular:
            continue
        t = where[frame]
        members = zip(aligned.along("illumination")[t], aligned.along("frame")[t], strict=True)
        names = {n: m for m, (n, at) in enumerate(members) if n and (n != CONSTANT or at == frame)}
        _check(names)
        surface_at = {"tracking": k}
        reads: dict[str, dict[Name, dict[str, int]]] = {
            "radiance": {
                (band, name): {"tracking": t, "member": m, "band": b, "component": component}
                for b, band in enumerate(aligned.along("band"))
                for name, m in names.items()
            },
            "specular_normal": {frame: {"tracking": of_specular.index(frame), "band": 0}},
            "normal": {frame: {**surface_at, "band": 0}},
            "depth_mm": {frame: surface_at},
            "visibility": {frame: surface_at},
        }
        block = {
            "surface": surface,
            "absolute": absolute,
            "shape": [aligned.sizes["y"], aligned.sizes["x"]],
        }
        groups.append(Group(reads, block))
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
    axes = all(axis in names or complement(axis) in names for axis in AXES)
    whole = CONSTANT in names or bool(pairs(names))
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
    prepare="lightstage.kernels.appearance.gloss:prepare",
    prepared=("setup", "absolute"),
    kernel="lightstage.kernels.appearance.gloss:gloss",
)

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

from pydantic import Field

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Needs, Output, Params, Stage, StageError
from lightstage.hw.illuminations import CONSTANT, pairs
from lightstage.kernels.items import lens_of


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


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: ReflectanceParams
) -> Mapping[str, Any]:
    lights = None
    if labels["absolute"]:
        fields = ("position_mm", "direction", "power")
        lights = {"lights": [{k: light[k] for k in fields} for light in items["lights"]["lights"]]}
    camera = None
    if labels["shading"] == "geometry" and labels["absolute"] and "camera" in items:
        camera = lens_of(items["camera"])
    return {
        "shading": labels["shading"],
        "shape": labels["shape"],
        "lights": lights,
        "camera": camera,
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
    comparable = list(facts["polarisation"]) != ["parallel"]
    absolute = comparable and "bands" in facts["items"] and "lights" in facts["items"]
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
        surface_at = {"tracking": k}
        groups.append(
            Group(
                {
                    "radiance": {
                        (band, name): {
                            "tracking": t,
                            "member": m,
                            "band": b,
                            "component": components.index(component),
                        }
                        for b, band in enumerate(bands)
                        for name, m in names.items()
                    },
                    "irradiance": {frame: surface_at},
                    "depth_mm": {frame: surface_at},
                    "normal": {frame: {**surface_at, "band": 0}},
                },
                {"shading": shading, "absolute": absolute, "shape": [height, width]},
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
    own = {name: m for m, name in enumerate(names) if name and (name != CONSTANT or frames[m] == tracking)}
    if not still and CONSTANT in own:
        return {CONSTANT: own[CONSTANT]}
    paired = {name for pair in pairs(own) for name in pair}
    return {name: m for name, m in own.items() if name == CONSTANT or name in paired}


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
    prepare="lightstage.kernels.appearance.reflectance:prepare",
    prepared=("shading", "white", "camera"),
    kernel="lightstage.kernels.appearance.reflectance:reflectance",
)

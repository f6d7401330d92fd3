"""normals: photometric surface normals from one set of illuminations.

The gradient methods (ratio, difference, minimal) with their QP correction and their specular form are in
`kernels/normals/spherical_gradients.py`, one light at a time in `one_light.py` beside it. This file chooses the
method that a session's frames support and says which.

`correct` takes out what the methods neglect. `lights` inverts the response of this rig with its lights taken as
distant; `near`, `near+shadows` and `full` (with bounced light) find depth and visibility together with the
normals (`rig_normals.py`, `self_consistent.py`) and give them as results of their own.

A static capture gives one normal map. A performance gives one at every tracking frame (C) whose window,
between the tracking frames before and after it, holds a full set.

Must have run before: align (which passes a still subject's pictures on as they are). Limits: without `correct`
lights are taken as distant and unoccluded, so near light, shadows and inter-reflection stay in the result
(docs/accuracy.md measures them).

Sources: Ma et al. (2007), Wilson et al. (2010), Dutta (2010) chapter 4, Woodham (1980).
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

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
from lightstage.kernels.encodings import NORMAL_ATTRS, VISIBILITY_STEPS
from lightstage.kernels.items import lens_of, lights_of, lights_placed
from lightstage.kernels.pictures.picture_sets import Choice, Window, choose, chosen_sets

RIG_MODELS = ("lights", "near", "near+shadows", "full")
"""The corrections that know this rig's lights; all but the first estimate depth."""


class NormalsParams(Params):
    """Parameters of `normals`."""

    method: Literal["auto", "ratio", "difference", "minimal", "least_squares"] = Field(
        "auto", description="auto: the best that the session's frames support"
    )
    base: Literal["auto", "X", "Y", "Z"] = Field(
        "auto", description="the pair of a minimal set; auto: what is held"
    )
    correct: Literal["none", "auto", "qp", "lights", "near", "near+shadows", "full"] = Field(
        "none",
        description="qp: Dutta's correction, all seven pictures; lights: this rig's response inverted; near, "
        "near+shadows, full: with depth, shadows, bounced light estimated; auto: the most that the items support",
    )
    filter: Literal["none", "nlm", "surface"] = Field(
        "none",
        description="nlm: non-local means with the measured noise; surface: those of the integrated depth (with a "
        "model that has one); both cost some of the finest detail",
    )
    openness: Literal["measured", "modelled"] = Field(
        "measured",
        description="irradiance where depth is found: corrected by the measured norm, or as the surface has it",
    )
    component: Literal["diffuse", "specular"] = Field("diffuse", description="which light the pictures show")
    fuse: Literal["none", "bands"] = Field("none", description="bands: one map from all bands, weighted by noise")


def _number(name: str) -> int | str:
    digits = name.removeprefix("L")
    return int(digits) if digits.isdigit() else name


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: NormalsParams
) -> Mapping[str, Any]:
    choice = labels["choice"]
    camera = lights = rig = None
    correct = labels["correct"]
    if correct in RIG_MODELS:
        rig = _rig(facts, items, correct)
    if params.component == "specular" and "camera" in items:
        lens = lens_of(items["camera"])
        camera = {**lens, "world_to_camera": {"R": lens["world_to_camera"]["R"]}}
    if choice[0] == "least_squares":
        if "lights" not in items:
            raise StageError(
                "method: least_squares needs the lights item; bind one with "
                "`lightstage calibration use FILE --session S`"
            )
        fields = ("position_mm", "direction", "power")
        wanted = {_number(name) for name in choice[2]}
        lights = {
            "lights": [
                {"id": light["id"], **{k: light[k] for k in fields}}
                for light in items["lights"]["lights"]
                if light["position_mm"] is not None or _number(light["id"]) in wanted
            ]
        }
    return {
        "choice": choice,
        "specular": params.component == "specular",
        "shape": labels["shape"],
        "camera": camera,
        "lights": lights,
        "rig": rig,
        "correct": correct,
    }


def _rig(facts: Mapping[str, Any], items: Items, model: str) -> Mapping[str, Any]:
    """The part of camera and lights that a model of the rig reads, and the capture's mask."""
    near = model != "lights"
    missing = [kind for kind in ("lights", "camera") if kind not in items and (near or kind == "lights")]
    if missing:
        raise StageError(
            f"correct: {model} needs the {' and the '.join(missing)} item; bind one with "
            "`lightstage calibration use FILE --session S`, or measure it with `lightstage calibrate`"
        )
    if model == "full" and "bands" not in items:
        raise StageError(
            "correct: full needs the bands item: bounced light is told by the albedo, so radiance must compare "
            "between bands; measure one with `lightstage calibrate bands`, or set correct: near+shadows"
        )
    return {
        "camera": lens_of(items["camera"]) if near else None,
        "lights": lights_of(items["lights"]),
        "near": near,
        "mask": facts["mask"] if near else None,
    }


Places = dict[str, dict[str, int]]
"""Illumination -> where its picture is in the node above: dimension -> index."""


def _sets(aligned: Grid, facts: Mapping[str, Any], params: NormalsParams) -> list[tuple[int, Choice, Places]]:
    """Per tracking frame: its index in the session, the method, and where each picture is."""
    correct = "none" if params.correct == "auto" else params.correct
    ask = {"method": params.method, "base": params.base, "correct": correct}
    if facts["frame_rate_hz"] is None:
        have = list(aligned.along("illumination")[0])
        place = {name: {"tracking": 0, "member": i} for i, name in enumerate(have)}
        return [(aligned.along("tracking")[0], choose(have, **ask), place)]
    where, candidates = {}, []
    rows = zip(aligned.along("tracking"), aligned.along("frame"), aligned.along("illumination"), strict=True)
    for k, (tracking, frames, names) in enumerate(rows):
        at = {name: m for m, name in enumerate(names) if name not in ("", "C") or frames[m] == tracking}
        at.pop("", None)
        candidates.append(Window(tracking, at))
        where[tracking] = {name: {"tracking": k, "member": m} for name, m in at.items()}
    shown = [name for window in candidates for name in window.at]
    whole = f"{' '.join(shown[:24])} ({len(shown)} pictures)"
    sets = chosen_sets(candidates, **ask, whole=whole)
    return [(window.frame, choice, where[window.frame]) for window, choice in sets]


def _supported(sets: Sequence[tuple[int, Choice, Places]], facts: Mapping[str, Any], component: str) -> str:
    """What `correct: auto` is: the best model of the rig that the bound items and the pictures support."""
    if component == "specular" or any(choice.method == "least_squares" for _, choice, _ in sets):
        return "none"
    items = facts["items"]
    if "camera" not in items or "lights" not in items or not lights_placed(items["lights"]):
        return "none"
    return "full" if "bands" in items else "near+shadows"


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: NormalsParams) -> Arrangement:
    (aligned,) = grids
    components = list(aligned.along("component"))
    notes: dict[str, Any] = {}
    component: str = params.component
    if component not in components:
        if component == "specular" or "total" not in components:
            why = aligned.attrs.get("cannot_be_made", f"it has {', '.join(components)}")
            raise StageError(f"component: {component} is not in this session ({why})")
        component = "total"
        notes["note"] = "the capture cannot be split: normals are of the total light"
    sets = _sets(aligned, facts, params)
    bands = list(aligned.along("band"))
    fused = params.fuse == "bands" and len(bands) > 1
    correct = _supported(sets, facts, component) if params.correct == "auto" else params.correct
    modelled = correct in RIG_MODELS
    if modelled and component == "specular":
        raise StageError(f"correct: {correct} is a model of diffuse light; set component: diffuse")
    if correct == "qp" and component == "specular":
        raise StageError(
            "correct: qp has the constants of the diffuse lobe (1/3), and a specular lobe's depend on its "
            "roughness; set correct: none, or component: diffuse"
        )
    if params.filter == "surface" and correct not in RIG_MODELS[1:]:
        raise StageError("filter: surface needs a depth; set correct: near, near+shadows or full")
    height, width = aligned.sizes["y"], aligned.sizes["x"]
    groups = []
    for _, choice, place in sets:
        if component == "specular" and choice.method == "least_squares":
            raise StageError("component: specular needs a gradient method; least_squares is for diffuse light")
        for b in [list(range(len(bands)))] if fused or modelled else [[b] for b in range(len(bands))]:
            extra = component == "specular" and "C" in place
            seen = components.index(component)
            pictures: dict[Name, dict[str, int]] = {
                (bands[i], name): {**place[name], "band": i, "component": seen}
                for i in b
                for name in choice.pictures
            }
            diffuse: dict[Name, dict[str, int]] = {
                bands[i]: {**place["C"], "band": i, "component": components.index("diffuse")} for i in b if extra
            }
            block = {
                "choice": [choice.method, choice.base, list(choice.pictures)],
                "shape": [height, width],
                "correct": correct,
            }
            groups.append(Group({"radiance": pictures, "constant": diffuse}, block))
    sizes = {"tracking": len(sets), "band": 1 if fused else len(bands), "xyz": 3, "y": height, "x": width}
    labels: dict[str, tuple[tuple[str, ...], Sequence[Any]]] = {
        "tracking": (("tracking",), [frame for frame, _, _ in sets]),
        "band": (("band",), [0.0] if fused else bands),
        "xyz": (("xyz",), list("xyz")),
    }
    outputs = {"normal", "albedo", "norm", "valid"}
    if modelled and correct != "lights":
        outputs |= {"depth_mm", "irradiance"}
    ids = [light["id"] for light in facts["items"]["lights"]["lights"]] if "lights" in facts["items"] else []
    if correct in ("near+shadows", "full") and ids:
        outputs |= {"visibility"}
        sizes["light"] = len(ids)
        labels["light"] = (("light",), ids)
    if "time_s" in aligned.labels:
        when = dict(zip(aligned.along("tracking"), aligned.along("time_s"), strict=True))
        labels["time_s"] = (("tracking",), [when[frame] for frame, _, _ in sets])
    used = sorted({choice.method for _, choice, _ in sets})
    attrs = {
        "method": ", ".join(used),
        "base": ", ".join(sorted({choice.base for _, choice, _ in sets if choice.base})),
        "correct": correct,
        "component": component,
        "fuse": params.fuse,
        "filter": params.filter,
        "frame": "world: right-handed, x right, y up, z towards the camera",
        **notes,
    }
    return Arrangement(
        Grid(sizes, labels, attrs),
        tuple(groups),
        {},
        ("tracking",) if modelled else None,  # one geometry for all bands
        frozenset(outputs),
    )


_ALIGNED = Input("aligned", ("tracking", "member", "band", "component", "y", "x"), "group")
STAGE = Stage(
    name="normals",
    version=1,
    summary="surface normals",
    params=NormalsParams,
    remarks=("method", "note", "distance_mm"),
    inputs={"radiance": _ALIGNED, "constant": _ALIGNED},
    calibration={
        "camera": Needs(
            why="specular normals take (0, 0, 1) as the view direction everywhere; no depth can be estimated"
        ),
        "lights": Needs(why="least_squares, and corrections that model the rig's lights, cannot be used"),
    },
    outputs={
        "normal": Output(
            ("tracking", "band", "xyz", "y", "x"),
            "int16",
            whole=("xyz", "y", "x"),
            attrs=NORMAL_ATTRS,
        ),
        "albedo": Output(("tracking", "band", "y", "x"), "float32", attrs={"units": "radiance"}),
        "norm": Output(("tracking", "band", "y", "x"), "float32", attrs={"units": "1"}),
        "valid": Output(("tracking", "band", "y", "x"), "bool"),
        "depth_mm": Output(
            ("tracking", "y", "x"), "float32", attrs={"units": "mm", "long_name": "camera z of the surface"}
        ),
        "irradiance": Output(
            ("tracking", "y", "x"),
            "float32",
            attrs={
                "units": "1",
                "long_name": "constant light that arrives directly, shadows in; radiance of white",
            },
        ),
        "visibility": Output(
            ("tracking", "light", "y", "x"),
            "uint8",
            attrs={
                "scale_factor": 1 / VISIBILITY_STEPS,
                "units": "1",
                "long_name": "part of a light that is seen; 0 off the mask",
            },
        ),
    },
    blocks=("tracking", "band"),
    arrange=_arrange,
    context=_context,
    prepare="lightstage.kernels.normals.methods:prepare",
    prepared=("choice", "lights", "view", "rig", "correct"),
    kernel="lightstage.kernels.normals.methods:normals",
)

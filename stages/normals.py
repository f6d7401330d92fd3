"""normals: photometric surface normals from one set of illuminations.

The gradient methods (ratio, difference, minimal) with their QP correction and their specular form are in
`spherical_gradients.py`, one light at a time in `one_light.py`, the fusion of bands in `band_fusion.py`. This
file chooses the method that a session's frames support and says which.

`correct` takes out what the methods neglect. `lights` inverts the response of this rig with its lights taken as
distant; `near`, `near+shadows` and `full` (with bounced light) find depth and visibility together with the
normals (`rig_normals.py`, `self_consistent.py`) and give them as results of their own.

A static capture gives one normal map. A performance gives one at every tracking frame (C) whose window,
between the tracking frames before and after it, holds a full set. It reads the aligned pictures, or, from `stack`,
the pictures as they are.

Must have run before: align or stack. Limits: without `correct` lights are taken as distant and unoccluded, so near
light, shadows and inter-reflection stay in the result (docs/accuracy.md measures them).

Sources: Ma et al. (2007), Wilson et al. (2010), Dutta (2010) chapter 4, Woodham (1980).
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Needs, Output, Params, Stage, StageError
from lightstage.kernels.normals import one_light, quantised, rig_normals, spherical_gradients
from lightstage.kernels.normals.normal_filter import non_local_means
from lightstage.kernels.normals.rig_normals import RIG_MODELS, VISIBILITY_STEPS
from lightstage.kernels.normals.spherical_gradients import table
from lightstage.kernels.pictures.band_fusion import fuse as fuse_bands
from lightstage.kernels.pictures.picture_sets import Choice, Window, choose, chosen_sets, windows


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


def normals(
    radiance: Sequence[NDArray[np.float32]],
    *,
    choice: Choice,
    names: Sequence[str],
    diffuse_constant: bool,
    lights: NDArray[np.float64] | None,
    view: NDArray[np.float32] | None,
    rig: rig_normals.Rig | None = None,
    correct: str = "none",
    fuse: str = "none",
    filter: str = "none",
    openness: str = "measured",
) -> Mapping[str, Any]:
    """Normals of one tracking frame.

    Args:
        radiance: pictures (y, x), NaN where not valid: per band, the pictures of `names`; after the last
            band, when `diffuse_constant`, the diffuse component's constant picture of each band.
        choice: the method.
        names: the illuminations of one band's pictures.
        diffuse_constant: whether the albedo is read instead of being the method's own r_c.
        lights: (light, xyz) in the order of `names`, for least_squares.
        view: (xyz, y, x) unit vectors to the camera, for specular pictures.
        rig: what the corrections of RIG_MODELS need.
        correct: none, qp, or one of RIG_MODELS.
        fuse: with a rig model, whether all bands give one map (bands) or one each (none).
        filter: none, nlm or surface.
        openness: with a rig model, measured or modelled.

    Returns:
        `normal` (xyz, y, x) int16, as `quantised` stores them; `albedo` and `norm` (y, x) float32, NaN where not
        valid; `valid` (y, x). With a rig model all have a leading band, and `depth_mm`, `irradiance` (y, x) and
        `visibility` (light, y, x) come with them as far as the model has them.
    """
    count = len(names)
    bands = len(radiance) // (count + int(diffuse_constant))
    if rig is not None:
        by_band = [{name: radiance[b * count + i] for i, name in enumerate(names)} for b in range(bands)]
        return rig_normals.solve(
            by_band, rig, model=correct, as_one=fuse == "bands", filtered=filter, openness=openness
        )
    groups = [[radiance[b * count + i] for i in range(count)] for b in range(bands)] if bands > 1 else None
    pictures: Sequence[NDArray[np.float32]] = fuse_bands(groups, names) if groups else _Head(radiance, count)
    if choice.method == "least_squares":
        assert lights is not None
        result = one_light.solve(pictures, lights)
    else:
        method = table(choice.method, choice.base, names, qp=correct == "qp")
        at_hand = [pictures[list(names).index(name)] for name in method.pictures]
        result = spherical_gradients.solve(at_hand, method, view=view)
    albedo = result.constant
    if diffuse_constant:
        constants = [[radiance[bands * count + b]] for b in range(bands)]
        albedo = fuse_bands(constants, ["C"])[0] if bands > 1 else np.asarray(constants[0][0])
        albedo = np.where(result.valid, albedo, np.float32(np.nan))
    normal = result.normal
    if filter == "nlm":
        unit = np.moveaxis(quantised.decode(normal), 0, 2)
        unit = non_local_means(unit, 1 / np.sqrt(np.maximum(albedo, 1e-12)), result.valid)
        normal = quantised.encode(np.moveaxis(unit, 2, 0))
    return {"normal": normal, "albedo": albedo, "norm": result.norm, "valid": result.valid}


class _Head(Sequence[NDArray[np.float32]]):
    """The first pictures of a sequence, still read one at a time."""

    def __init__(self, pictures: Sequence[NDArray[np.float32]], count: int) -> None:
        self._pictures, self._count = pictures, count

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: Any) -> Any:
        if not 0 <= index < self._count:
            raise IndexError(index)
        return self._pictures[index]


def view_vectors(camera: Mapping[str, Any], shape: tuple[int, int]) -> NDArray[np.float32]:
    """Unit vectors from the seen points to the camera, world frame, (xyz, y, x).

    A point's distance does not matter: every point of a pixel's ray sees the camera in the same direction.

    Raises:
        StageError: the camera item is of another picture size.
    """
    width, height = camera["size_px"]
    if (height, width) != tuple(shape):
        raise StageError(f"the camera item is for {width} x {height}; the pictures are {shape[1]} x {shape[0]}")
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    matrix, distortion = np.asarray(camera["K"], float), np.asarray(camera["distortion"], float)
    points = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
    rays = cv2.undistortPoints(points, matrix, distortion).reshape(height, width, 2)
    rays = np.concatenate([rays, np.ones((height, width, 1))], axis=2)
    rotation = np.asarray(camera["world_to_camera"]["R"], float)
    world = -rays @ rotation  # R^T applied to each ray, turned round
    world /= np.linalg.norm(world, axis=2, keepdims=True)
    return np.ascontiguousarray(np.moveaxis(world, 2, 0), dtype=np.float32)


def light_directions(item: Mapping[str, Any], names: Sequence[str]) -> NDArray[np.float64]:
    """Directions times strength at the stage's centre, (light, xyz), for illuminations L00, L01, ...

    A light with a position falls off with its squared distance, relative to the mean of all.

    Raises:
        StageError: a light is not in the item, or all lie in one plane with the centre.
    """
    by_number = {_number(light["id"]): light for light in item["lights"]}
    missing = [name for name in names if _number(name) not in by_number]
    if missing:
        raise StageError(f"the lights item has no {', '.join(missing)} (it has {len(by_number)} lights)")
    distances = [np.linalg.norm(x["position_mm"]) for x in item["lights"] if x["position_mm"] is not None]
    usual = float(np.mean(distances)) if distances else 1.0
    rows = []
    for name in names:
        light = by_number[_number(name)]
        place = np.asarray(light["position_mm"] if light["position_mm"] is not None else light["direction"], float)
        length = float(np.linalg.norm(place))
        fall_off = (usual / length) ** 2 if light["position_mm"] is not None else 1.0
        rows.append(place / length * light["power"] * fall_off)
    lights = np.stack(rows)
    if np.linalg.matrix_rank(lights, tol=1e-3) < 3:
        raise StageError("the lights lie in one plane; least_squares needs three that do not")
    return lights


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
        rig = rig_normals.context_of(facts, items, correct)
    if params.component == "specular" and "camera" in items:
        names = ("size_px", "K", "distortion", "world_to_camera")
        camera = {name: items["camera"][name] for name in names}
        camera["world_to_camera"] = {"R": camera["world_to_camera"]["R"]}
    if choice[0] == "least_squares":
        if "lights" not in items:
            raise StageError(
                "method: least_squares needs the lights item; bind one with "
                "`lightstage calibration use FILE --session S`"
            )
        fields = ("position_mm", "direction", "power")
        wanted = {_number(name) for name in labels["names"]}
        lights = {
            "lights": [
                {"id": light["id"], **{k: light[k] for k in fields}}
                for light in items["lights"]["lights"]
                if light["position_mm"] is not None or _number(light["id"]) in wanted
            ]
        }
    return {
        "choice": choice,
        "names": labels["names"],
        "diffuse_constant": labels["diffuse_constant"],
        "specular": params.component == "specular",
        "shape": labels["shape"],
        "camera": camera,
        "lights": lights,
        "rig": rig,
        "correct": correct,
    }


def _prepare(
    *,
    choice: Sequence[Any],
    names: Sequence[str],
    diffuse_constant: bool,
    specular: bool,
    shape: Sequence[int],
    camera: Mapping[str, Any] | None,
    lights: Mapping[str, Any] | None,
    rig: Mapping[str, Any] | None,
    correct: str,
) -> Mapping[str, Any]:
    view = known = None
    if rig is not None:
        known = rig_normals.prepared(rig, (int(shape[0]), int(shape[1])))
    if specular:
        size = (int(shape[0]), int(shape[1]))
        view = np.zeros((3, *size), np.float32)
        view[2] = 1
        if camera is not None:
            view = view_vectors(camera, size)
    return {
        "choice": Choice(choice[0], choice[1], tuple(choice[2])),
        "names": tuple(names),
        "diffuse_constant": diffuse_constant,
        "lights": None if lights is None else light_directions(lights, names),
        "view": view,
        "rig": known,
        "correct": correct,
    }


Places = dict[str, dict[str, int]]
"""Illumination -> where its picture is in the node above: dimension -> index."""


def _sets(above: Grid, facts: Mapping[str, Any], params: NormalsParams) -> list[tuple[int, Choice, Places]]:
    """Per tracking frame: its index in the session, the method, and where each picture is."""
    correct = "none" if params.correct == "auto" else params.correct
    ask = {"method": params.method, "base": params.base, "correct": correct}
    if facts["frame_rate_hz"] is None:
        if "member" in above.sizes:
            have = list(above.along("illumination")[0])
            place = {name: {"tracking": 0, "member": i} for i, name in enumerate(have)}
            frame = above.along("tracking")[0]
        else:
            have = list(above.along("illumination"))
            place = {name: {"illumination": i} for i, name in enumerate(have)}
            frame = above.along("frame")[have.index("C") if "C" in have else 0]
        return [(frame, choose(have, **ask), place)]
    if "member" in above.sizes:
        where, candidates = {}, []
        rows = zip(above.along("tracking"), above.along("frame"), above.along("illumination"), strict=True)
        for k, (tracking, frames, names) in enumerate(rows):
            at = {name: m for m, name in enumerate(names) if name not in ("", "C") or frames[m] == tracking}
            at.pop("", None)
            candidates.append(Window(tracking, at))
            where[tracking] = {name: {"tracking": k, "member": m} for name, m in at.items()}
    else:
        candidates = windows(list(above.along("illumination")))
        where = {w.frame: {name: {"frame": i} for name, i in w.at.items()} for w in candidates}
    names = (
        [name for window in candidates for name in window.at]
        if "member" in above.sizes
        else list(above.along("illumination"))
    )
    whole = f"{' '.join(names[:24])} ({len(names)} pictures)"
    sets = chosen_sets(candidates, **ask, whole=whole)
    return [(window.frame, choice, where[window.frame]) for window, choice in sets]


def _supported(sets: Sequence[tuple[int, Choice, Places]], facts: Mapping[str, Any], component: str) -> str:
    """What `correct: auto` is: the best model of the rig that the bound items and the pictures support."""
    if component == "specular" or any(choice.method == "least_squares" for _, choice, _ in sets):
        return "none"
    if not facts["lights_placed"] or "camera" not in facts["items"]:
        return "none"
    return "full" if "bands" in facts["items"] else "near+shadows"


def _frames(above: Grid) -> Sequence[int]:
    return list(above.along("tracking" if "member" in above.sizes else "frame"))


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: NormalsParams) -> Arrangement:
    (stacked,) = grids
    components = list(stacked.along("component"))
    notes: dict[str, Any] = {}
    component: str = params.component
    if component not in components:
        if component == "specular" or "total" not in components:
            why = stacked.attrs.get("cannot_be_made", f"it has {', '.join(components)}")
            raise StageError(f"component: {component} is not in this session ({why})")
        component = "total"
        notes["note"] = "the capture cannot be split: normals are of the total light"
    sets = _sets(stacked, facts, params)
    bands = list(stacked.along("band"))
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
    height, width = stacked.sizes["y"], stacked.sizes["x"]
    groups = []
    for _, choice, place in sets:
        if component == "specular" and choice.method == "least_squares":
            raise StageError("component: specular needs a gradient method; least_squares is for diffuse light")
        for b in [list(range(len(bands)))] if fused or modelled else [[b] for b in range(len(bands))]:
            extra = component == "specular" and "C" in place
            seen = components.index(component)
            pieces = [{**place[name], "band": i, "component": seen} for i in b for name in choice.pictures]
            if extra:
                pieces += [{**place["C"], "band": i, "component": components.index("diffuse")} for i in b]
            groups.append(
                Group(
                    {"radiance": pieces},
                    {
                        "choice": [choice.method, choice.base, list(choice.pictures)],
                        "names": list(choice.pictures),
                        "diffuse_constant": extra,
                        "shape": [height, width],
                        "correct": correct,
                    },
                )
            )
    sizes = {"tracking": len(sets), "band": 1 if fused else len(bands), "xyz": 3, "y": height, "x": width}
    labels: dict[str, tuple[tuple[str, ...], Sequence[Any]]] = {
        "tracking": (("tracking",), [frame for frame, _, _ in sets]),
        "band": (("band",), [0.0] if fused else bands),
        "xyz": (("xyz",), list("xyz")),
    }
    outputs = {"normal", "albedo", "norm", "valid"}
    if modelled and correct != "lights":
        outputs |= {"depth_mm", "irradiance"}
    if correct in ("near+shadows", "full") and facts["light_ids"]:
        outputs |= {"visibility"}
        sizes["light"] = len(facts["light_ids"])
        labels["light"] = (("light",), facts["light_ids"])
    if "time_s" in stacked.labels:
        when = dict(zip(_frames(stacked), stacked.along("time_s"), strict=True))
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


STAGE = Stage(
    name="normals",
    version=1,
    summary="surface normals",
    params=NormalsParams,
    remarks=("method", "note", "distance_mm"),
    doubts={
        "distance_found": "the norm does not tell the distance in every tracking frame; the stage's centre was "
        "taken there, so check the lights and camera items"
    },
    inputs={
        "radiance": Input(
            "aligned",
            ("tracking", "member", "band", "component", "y", "x"),
            "group",
            instead=Input("radiance", ("illumination|frame", "band", "component", "y", "x"), "group"),
        )
    },
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
            attrs=quantised.ATTRS,
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
    prepare=_prepare,
    prepared=("choice", "names", "diffuse_constant", "lights", "view", "rig", "correct"),
    kernel=normals,
)

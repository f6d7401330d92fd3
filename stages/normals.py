"""normals: photometric surface normals from one set of illuminations.

The gradient methods (ratio, difference, minimal) with their QP correction and their specular form are in
`spherical_gradients.py`, one light at a time in `one_light.py`, the fusion of bands in `band_fusion.py`. This
file chooses the method that a session's frames support and says which.

`correct` takes out what the methods neglect. `lights` inverts the response of this rig with its lights taken as
distant; `near`, `near+shadows` and `full` (with bounced light) find depth and visibility together with the
normals (`rig_normals.py`, `self_consistent.py`) and give them as results of their own.

A static capture gives one normal map. A performance gives one at every tracking frame (C) whose window,
between the tracking frames before and after it, holds a full set; the pictures of the set are used as they
are, without alignment.

Must have run before: stack. Limits: without `correct` lights are taken as distant and unoccluded, so near
light, shadows and inter-reflection stay in the result (docs/accuracy.md measures them).

Sources: Ma et al. (2007), Wilson et al. (2010), Dutta (2010) chapter 3, Woodham (1980).
"""

import contextlib
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dag.stage import Arrangement, Grid, Group, Input, Items, Needs, Output, Params, Stage, StageError
from stages import one_light, rig_normals, spherical_gradients
from stages.band_fusion import fuse as fuse_bands
from stages.normal_filter import non_local_means
from stages.rig_normals import RIG_MODELS, VISIBILITY_STEPS
from stages.spherical_gradients import AXES, FILL, GRADIENTS, STEPS, table


class NormalsParams(Params):
    """Parameters of `normals`."""

    method: Literal["auto", "ratio", "difference", "minimal", "least_squares"] = Field(
        "auto", description="auto: the best that the session's frames support"
    )
    base: Literal["auto", "X", "Y", "Z"] = Field(
        "auto", description="the pair of a minimal set; auto: what is held"
    )
    correct: Literal["none", "qp", "lights", "near", "near+shadows", "full"] = Field(
        "none",
        description="qp: Dutta's correction, all seven pictures; lights: this rig's response inverted; near, "
        "near+shadows, full: with depth, shadows, bounced light estimated",
    )
    filter: Literal["none", "nlm", "surface"] = Field(
        "none",
        description="nlm: non-local means with the measured noise; surface: those of the integrated depth (with a "
        "model that has one); both cost some of the finest detail",
    )
    component: Literal["diffuse", "specular"] = Field("diffuse", description="which light the pictures show")
    fuse: Literal["none", "bands"] = Field("none", description="bands: one map from all bands, weighted by noise")


_BY_NOISE = ("difference", "minimal", "ratio", "least_squares")


class Choice(NamedTuple):
    """A method and the pictures that it reads."""

    method: str
    base: str
    pictures: tuple[str, ...]


def choose(have: Sequence[str], *, method: str = "auto", base: str = "auto", correct: str = "none") -> Choice:
    """The method for a set of illuminations.

    `auto` takes difference, then minimal, then ratio, then least squares: by noise (shot variance per axis
    4 r_c : 4 r_a + r_c : ...; design 8), the first that the set supports.

    Raises:
        StageError: the set does not support what was asked for; says what is missing and what would work.
    """
    present = set(have)
    if base != "auto" and method not in ("auto", "minimal"):
        raise StageError(f"base: {base} belongs to method: minimal; {method} has none, so set base: auto")
    if base != "auto":
        method = "minimal"
    lights = tuple(name for name in dict.fromkeys(have) if name.startswith("L"))
    supported = [name for name in _BY_NOISE if _supports(name, base, present)]
    chosen = (supported[0] if supported else None) if method == "auto" else method
    if chosen not in supported:
        works = f"method: {' or '.join(supported)} would work" if supported else "no method works with these"
        what = "any method" if method == "auto" else method + (f" with base {base}" if base != "auto" else "")
        raise StageError(
            f"{what} needs {_needs(method, base)}; the session has {', '.join(dict.fromkeys(have))}; {works}"
        )
    if chosen == "least_squares":
        if correct != "none":
            raise StageError(
                f"correct: {correct} belongs to the gradient methods; with least_squares set correct: none"
            )
        return Choice(chosen, "", lights)
    axis = (
        next(a for a in AXES if base in ("auto", a) and _supports("minimal", a, present))
        if chosen == "minimal"
        else ""
    )
    missing = [name for name in (*GRADIENTS, "C") if name not in present]
    if correct == "qp" and missing:
        raise StageError(
            f"correct: qp needs {', '.join((*GRADIENTS, 'C'))}; {', '.join(missing)} missing; "
            f"correct: none works with {chosen}"
        )
    wanted = table(str(chosen), axis, have, qp=correct == "qp").pictures
    return Choice(str(chosen), axis, wanted)


def _supports(method: str, base: str, present: set[str]) -> bool:
    if method == "least_squares":
        return sum(name.startswith("L") for name in present) >= 3
    if method == "difference":
        return present >= set(GRADIENTS)
    if method == "ratio":
        return present >= {"X", "Y", "Z", "C"}
    axes = AXES if base == "auto" else base
    return any(
        {a, a + "c"} <= present and all(b in present or b + "c" in present for b in AXES if b != a) for a in axes
    )


def _needs(method: str, base: str) -> str:
    pair = "the pair of one axis (X Xc, Y Yc or Z Zc)" if base == "auto" else f"{base} and {base}c"
    minimal = f"{pair} and one gradient of each other axis"
    needs = {
        "ratio": "X Y Z C",
        "difference": "X Y Z Xc Yc Zc",
        "minimal": minimal,
        "least_squares": "at least three one-light pictures (L00 ...)",
    }
    if method == "auto":
        return "; or ".join(needs.values())
    return needs[method]


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

    Returns:
        `normal` (xyz, y, x) int16 in steps of 1 / STEPS; `albedo` and `norm` (y, x) float32, NaN where not
        valid; `valid` (y, x). With a rig model all have a leading band, and `depth_mm`, `irradiance` (y, x) and
        `visibility` (light, y, x) come with them as far as the model has them.
    """
    count = len(names)
    bands = len(radiance) // (count + int(diffuse_constant))
    if rig is not None:
        by_band = [{name: radiance[b * count + i] for i, name in enumerate(names)} for b in range(bands)]
        return rig_normals.solve(by_band, rig, model=correct, as_one=fuse == "bands", filtered=filter)
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
        unit = np.where(normal == FILL, np.nan, normal / STEPS).transpose(1, 2, 0)
        normal = rig_normals.quantised(non_local_means(unit, 1 / np.sqrt(np.maximum(albedo, 1e-12)), result.valid))
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
    if params.correct in RIG_MODELS:
        rig = rig_normals.context_of(facts, items, params.correct)
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
    }


def _sets(
    illumination: Sequence[str], performance: bool, params: NormalsParams
) -> list[tuple[int, Choice, dict[str, int]]]:
    """Per tracking frame: its place, the method, and where each picture is."""
    ask = {"method": params.method, "base": params.base, "correct": params.correct}
    if not performance:
        choice = choose(illumination, **ask)
        place = {name: i for i, name in enumerate(illumination)}
        return [(place.get("C", 0), choice, place)]
    tracking = [i for i, name in enumerate(illumination) if name == "C"]
    found: list[tuple[int, Choice, dict[str, int]]] = []
    windows: list[list[str]] = []
    for k, frame in enumerate(tracking):
        first = tracking[k - 1] + 1 if k else 0
        last = tracking[k + 1] if k + 1 < len(tracking) else len(illumination)
        at: dict[str, int] = {}
        for i in sorted(range(first, last), key=lambda i: abs(i - frame)):
            at.setdefault(illumination[i], i)
        windows.append(list(at))
        with contextlib.suppress(StageError):
            found.append((frame, choose(list(at), **ask), at))
    if not found:
        works = [m for m in _BY_NOISE if any(_supports(m, "auto", set(window)) for window in windows)]
        hint = f"method: {' or '.join(works)} with base: auto would work" if works else "no method works with these"
        raise StageError(
            f"{params.method} needs {_needs(params.method, params.base)} between the tracking frames (C) before "
            f"and after one; the session has {' '.join(illumination[:24])} ({len(illumination)} frames); {hint}"
        )
    return found


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: NormalsParams) -> Arrangement:
    (stacked,) = grids
    performance = "frame" in stacked.sizes
    dim = "frame" if performance else "illumination"
    components = list(stacked.along("component"))
    notes: dict[str, Any] = {}
    component: str = params.component
    if component not in components:
        if component == "specular" or "total" not in components:
            why = stacked.attrs.get("cannot_be_made", f"it has {', '.join(components)}")
            raise StageError(f"component: {component} is not in this session ({why})")
        component = "total"
        notes["note"] = "the capture cannot be split: normals are of the total light"
    sets = _sets(list(stacked.along("illumination")), performance, params)
    bands = list(stacked.along("band"))
    fused = params.fuse == "bands" and len(bands) > 1
    modelled = params.correct in RIG_MODELS
    if modelled and component == "specular":
        raise StageError(f"correct: {params.correct} is a model of diffuse light; set component: diffuse")
    if params.filter == "surface" and params.correct not in RIG_MODELS[1:]:
        raise StageError("filter: surface needs a depth; set correct: near, near+shadows or full")
    height, width = stacked.sizes["y"], stacked.sizes["x"]
    frame_of = list(stacked.along("frame"))
    if performance:
        times = [stacked.along("time_s")[frame] for frame, _, _ in sets]
    groups = []
    for _, choice, place in sets:
        if component == "specular" and choice.method == "least_squares":
            raise StageError("component: specular needs a gradient method; least_squares is for diffuse light")
        for b in [list(range(len(bands)))] if fused or modelled else [[b] for b in range(len(bands))]:
            extra = component == "specular" and "C" in place
            seen = components.index(component)
            pieces = [{dim: place[name], "band": i, "component": seen} for i in b for name in choice.pictures]
            if extra:
                pieces += [{dim: place["C"], "band": i, "component": components.index("diffuse")} for i in b]
            groups.append(
                Group(
                    {"radiance": pieces},
                    {
                        "choice": [choice.method, choice.base, list(choice.pictures)],
                        "names": list(choice.pictures),
                        "diffuse_constant": extra,
                        "shape": [height, width],
                    },
                )
            )
    sizes = {"tracking": len(sets), "band": 1 if fused else len(bands), "xyz": 3, "y": height, "x": width}
    labels: dict[str, tuple[tuple[str, ...], Sequence[Any]]] = {
        "tracking": (("tracking",), [frame_of[frame] for frame, _, _ in sets]),
        "band": (("band",), [0.0] if fused else bands),
        "xyz": (("xyz",), list("xyz")),
    }
    outputs = {"normal", "albedo", "norm", "valid"}
    if modelled and params.correct != "lights":
        outputs |= {"depth_mm", "irradiance"}
    if params.correct in ("near+shadows", "full") and facts["light_ids"]:
        outputs |= {"visibility"}
        sizes["light"] = len(facts["light_ids"])
        labels["light"] = (("light",), facts["light_ids"])
    if performance:
        labels["time_s"] = (("tracking",), times)
    used = sorted({choice.method for _, choice, _ in sets})
    attrs = {
        "method": ", ".join(used),
        "base": ", ".join(sorted({choice.base for _, choice, _ in sets if choice.base})),
        "correct": params.correct,
        "component": component,
        "fuse": params.fuse,
        "filter": params.filter,
        "frame": "world: right-handed, x right, y up, z towards the camera",
        **notes,
    }
    return Arrangement(
        Grid(sizes, labels, attrs),
        tuple(groups),
        {"illumination|frame": dim},
        ("tracking",) if modelled else None,  # one geometry for all bands
        frozenset(outputs),
    )


STAGE = Stage(
    name="normals",
    version=1,
    summary="surface normals",
    params=NormalsParams,
    inputs={"radiance": Input("radiance", ("illumination|frame", "band", "component", "y", "x"), "group")},
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
            attrs={"scale_factor": 1 / STEPS, "_FillValue": FILL, "units": "unit vector"},
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
    prepared=("choice", "names", "diffuse_constant", "lights", "view", "rig"),
    kernel=normals,
)

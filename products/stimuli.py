"""A matched set of faces: brought to one frame, mixed if asked, made equal in light, and written as a folder.

A face's pictures are brought to the frame by its eyes (`kernels/faces/face_frame.py`), pictures between two faces
by the flow from one to the other (`face_flow.py`), and all are made equal by `matching.py`.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lightstage.formats.png import encode_png
from lightstage.kernels.appearance.colour import decode_srgb, encode_srgb
from lightstage.kernels.appearance.distant_lights import DistantLight, parse_lights
from lightstage.kernels.appearance.shading import shade
from lightstage.kernels.errors import KernelError
from lightstage.kernels.faces.face_flow import between, face_flow, mixed_normals, pulled, through_points
from lightstage.kernels.faces.face_frame import Frame, bring, similarity, turned
from lightstage.kernels.faces.matching import PROMISED_LEVELS as PROMISED_LEVELS
from lightstage.kernels.faces.matching import PROMISED_SPECTRUM as PROMISED_SPECTRUM
from lightstage.kernels.faces.matching import TOP, Encoding, Setting, apart, grey_setting, match
from lightstage.kernels.motion.flow_warp import unit
from lightstage.products import names
from lightstage.products.choices import NEAREST_EYES_PX
from lightstage.products.counts import LUMINANCE, counts_16
from lightstage.products.errors import ProductError
from lightstage.products.face_points import EYES, Points
from lightstage.products.figures import png_of, pyplot
from lightstage.products.stimulus_folder import Screen, sha256

Array = NDArray[np.float64]
Image = NDArray[np.float32]
FORMAT = "lightstage-stimuli/1"
GIVEN = "given"
"""How points were found: by a person."""
_AZIMUTHS, _ELEVATIONS = (-60, -40, -20, 0, 20, 40, 60), (45, 30, 15, 0, -15)
_INCHES = 1.5
"""Of a face on the sheet of lights."""
_ROLL_DEG = 3.0
"""A head may lean so far without a word."""
_WORTH_SAYING = 0.001
"""Part of the oval that may be filled without a word; the table has every part."""
_BLACK = 1e-3
"""Luminance below which colour is noise."""


@dataclass(frozen=True)
class SetOptions:
    """What decides a set beside its faces; the recipe has it in these words."""

    match: str
    """none, or methods of `choices.MATCHES` with commas between."""
    across: str
    """set or kind: what is made equal."""
    kinds: str
    """Of `choices.STIMULUS_KINDS`, with commas between."""
    mean: float | None
    contrast: float | None
    background: float | None
    """Luminance around the oval; None: the mean."""
    grey: bool
    encoding: str
    """Of the 8-bit pictures: srgb or linear."""
    morph: Sequence[str] | None
    levels: str
    vary: str
    """shape or texture: what a morph changes."""
    distance_cm: float
    pixels_per_cm: float

    @property
    def methods(self) -> list[str]:
        """Of matching."""
        return [] if self.match == "none" else self.match.split(",")


@dataclass(frozen=True)
class Subject:
    """One session, brought to the frame."""

    name: str
    normal: Image
    """(xyz, y, x)."""
    images: Mapping[str, Image]
    """(rgb, y, x) linear, by kind."""
    filled: float
    """Part of the oval where nothing was measured."""
    attrs: Mapping[str, Any]
    """Of the stimulus result."""


@dataclass(frozen=True)
class Source:
    """Where a subject comes from, and what brought it to the frame."""

    result: str
    """Folder of the stimulus result: its recipe and manifest."""
    found_by: str
    points: Points
    """In the session's pictures."""
    framed: Points
    """In the frame."""


@dataclass(frozen=True)
class Capture:
    """A session as it was captured: its results, opened, and its points."""

    pictures: Any
    """Of the stimulus node: `image(tracking, kind, rgb, y, x)`."""
    relief: Any
    """The normals that the pictures were made from, of the same tracking frames."""
    result: str
    """Folder of the stimulus result."""
    points: Points
    found_by: str
    """GIVEN, or how."""


@dataclass(frozen=True)
class MatchedSet:
    """Pictures made equal."""

    rows: list[dict[str, Any]]
    """What the table says, one a picture."""
    files: dict[str, bytes]
    """PNG, by name."""
    differences: list[dict[str, float]]
    """The largest between two pictures, of every group that was made equal."""


def framed(
    captures: Mapping[str, Capture], eyes_px: float | None, warn: Callable[[str], None]
) -> tuple[list[Subject], dict[str, Source], Frame]:
    """Every session in one frame.

    Args:
        captures: by session.
        eyes_px: how far apart the eyes are in the frame; None: as in the pictures, on average.
        warn: is told what a person should know.

    Raises:
        ProductError: the eyes are too near for a face.
    """
    eyes = {name: np.stack([capture.points[eye] for eye in EYES]) for name, capture in captures.items()}
    distance = float(np.mean([float(np.linalg.norm(pair[1] - pair[0])) for pair in eyes.values()]))
    if not eyes_px and distance < NEAREST_EYES_PX:
        raise ProductError(
            f"the eyes are {distance:.1f} pixels apart, too near for a face: mend the points, or set "
            "their distance in the frame"
        )
    frame = Frame(float(eyes_px or round(distance)))
    oval = frame.oval() > 0
    subjects, sources = [], {}
    for name, capture in captures.items():
        pictures, relief = capture.pictures, capture.relief
        if pictures.sizes["tracking"] > 1:
            warn(f"{name}: a performance; its first tracking frame is used")
        matrix = similarity(eyes[name], frame)
        roll = math.degrees(math.atan2(matrix[1, 0], matrix[0, 0]))
        if abs(roll) > _ROLL_DEG:
            warn(f"{name}: the head leans by {roll:.1f} degrees; the light turns with it when it is set upright")
        images: dict[str, Image] = {}
        there = None
        for k, kind in enumerate(str(kind) for kind in pictures.kind.values):
            images[kind], there = bring(pictures.image.values[0, k], matrix, frame.shape)
        assert there is not None
        filled = float(np.mean(~there[oval]))
        if filled > _WORTH_SAYING:
            warn(f"{name}: {100 * filled:.1f} % of the oval was not measured, and is filled from beside it")
        known = np.isfinite(pictures.image.values[0]).all(axis=(0, 1))
        # what the pictures fill is filled in the normals, so that a morph starts at the picture itself
        normal = np.where(known, relief.normal.values[0, 0].astype(np.float32), np.float32(np.nan))
        normal = unit(bring(normal, matrix, frame.shape)[0])
        back = np.linalg.inv(np.concatenate([matrix, [[0, 0, 1]]]))
        moved = {key: back[:2, :2] @ at + back[:2, 2] for key, at in capture.points.items()}
        sources[name] = Source(capture.result, capture.found_by, capture.points, moved)
        attrs = {k: v for k, v in pictures.attrs.items() if isinstance(v, str | int | float)}
        subjects.append(Subject(name, turned(normal, matrix), images, filled, attrs))
    return subjects, sources, frame


def morphed(
    subjects: Sequence[Subject],
    sources: Mapping[str, Source],
    frame: Frame,
    *,
    ends: Sequence[str],
    levels: Sequence[float],
    vary: str,
) -> list[Subject]:
    """Pictures between two subjects: one property goes from A to B, the other stays A's.

    Args:
        subjects, sources, frame: of `framed`.
        ends: the names of A and B.
        levels: 0 is A, 1 is B.
        vary: shape or texture.

    Raises:
        ProductError: the two cannot be mixed.
    """
    by_name = {subject.name: subject for subject in subjects}
    a, b = (by_name[name] for name in ends)
    if a.attrs["cast_shadows"] or b.attrs["cast_shadows"]:
        raise ProductError("between two faces there is no depth; leave stimulus.cast_shadows out")
    if a.images["texture"].shape != b.images["texture"].shape:
        raise ProductError("one session is in colour and one is not; set stimulus.colour=grey for both")
    flow = _flow_between(a, b, sources, frame)
    lights = parse_lights(str(a.attrs["lights"]))
    morphs = []
    for level in levels:
        if vary == "shape":
            to = between(flow, level)
            normal = mixed_normals(pulled(a.normal, to.first), pulled(b.normal, to.second), level)
            texture = pulled(a.images["texture"], to.first)
        else:
            normal = a.normal
            mixed = (1 - level) * a.images["texture"] + level * pulled(b.images["texture"], flow)
            texture = mixed.astype(np.float32)
        shape = np.broadcast_to(shade(normal, lights), texture.shape)
        images = {"shape": shape, "texture": texture, "both": shape * texture}
        name = names.morph(a.name, b.name, vary, level)
        morphs.append(Subject(name, normal, images, max(a.filled, b.filled), a.attrs))
    return morphs


def _flow_between(a: Subject, b: Subject, sources: Mapping[str, Source], frame: Frame) -> Image:
    """From a to b; it leads through the points that somebody gave for both."""
    flow = face_flow(a.normal, b.normal, frame.oval(), frame.eyes_px)
    ends = [sources[subject.name] for subject in (a, b)]
    if any(source.found_by != GIVEN for source in ends):
        return flow
    shared = sorted(set.intersection(*(set(source.framed) for source in ends)))
    try:
        return through_points(flow, *(np.stack([source.framed[name] for name in shared]) for source in ends))
    except KernelError as error:
        raise ProductError(f"the points of '{a.name}': {error}") from None


def _setting(
    pictures: Sequence[NDArray[Any]], frame: Frame, options: SetOptions
) -> tuple[Any, list[Array], list[Array]]:
    """What `matching` needs: the setting, luminance (y, x), and colour as a multiple of it (y, x, rgb)."""

    oval = frame.oval().astype(np.float64)
    linear = options.encoding == "linear"
    encoding = Encoding(np.asarray, np.asarray) if linear else Encoding(encode_srgb, decode_srgb)
    background = float("nan") if options.background is None else options.background
    weights = np.array(LUMINANCE)
    luminance, tint = [], []
    for picture in pictures:
        rgb = np.moveaxis(np.broadcast_to(picture, (3, *picture.shape[1:])), 0, 2).astype(np.float64)
        rgb = np.maximum(rgb, 0)  # cubic interpolation swings below black
        y = rgb @ weights
        luminance.append(y)
        # grey where it is black, and fading to grey towards the background
        tint.append(1 + oval[..., None] * ((rgb + _BLACK) / (y + _BLACK)[..., None] - 1))
    if options.grey or all(picture.shape[0] == 1 for picture in pictures):
        return grey_setting(oval, background, encoding), luminance, []
    return (
        Setting(
            oval,
            background,
            encoding,
            lambda i, y: np.floor(encoding.code(tint[i] * y[..., None]) + 0.5).astype(np.uint8),
            lambda codes: np.asarray(encoding.decode(codes / TOP) @ weights),
            lambda i, y: tint[i] * y[..., None],
        ),
        luminance,
        tint,
    )


def matched(subjects: Sequence[Subject], frame: Frame, options: SetOptions, recipe: str) -> MatchedSet:
    """The pictures of all subjects and kinds, made equal over the set or within each kind.

    Args:
        subjects: in one frame.
        frame: of `framed`.
        options: see there.
        recipe: the digest that the table names.

    Raises:
        KernelError: they cannot be made equal so.
    """
    kinds = options.kinds.split(",")
    entries = [(subject, kind) for kind in kinds for subject in subjects]
    groups = [entries] if options.across == "set" else [[e for e in entries if e[1] == kind] for kind in kinds]
    light: Literal["srgb", "linear"] = "srgb" if options.encoding == "srgb" else "linear"
    shown = Screen(options.distance_cm, options.pixels_per_cm)
    height, width = frame.shape
    rows: list[dict[str, Any]] = []
    files: dict[str, bytes] = {}
    differences = []
    for group in groups:
        setting, luminance, tint = _setting([subject.images[kind] for subject, kind in group], frame, options)
        equal = match(luminance, setting, options.methods, mean=options.mean, contrast=options.contrast)
        differences.append(apart(equal))
        for i, ((subject, kind), picture) in enumerate(zip(group, equal, strict=True)):
            coarse, fine = names.stimulus(subject.name, kind)
            files[coarse] = encode_png(setting.store(i, picture.luminance), light=light)
            linear = tint[i] * picture.luminance[..., None] if tint else picture.luminance
            files[fine] = encode_png(counts_16(linear), light="linear")
            figures = picture.figures
            rows.append(
                {
                    "subject": subject.name, "kind": kind, "file": coarse, "file_16bit": fine,
                    "lights": "" if kind == "texture" else subject.attrs["lights"],
                    "mean": figures.mean_code, "contrast": figures.contrast_code, "rms": figures.rms,
                    "mean_linear": figures.mean_linear, "contrast_linear": figures.contrast_linear,
                    "clipped": picture.clipped, "filled": subject.filled,
                    "width_px": width, "height_px": height,
                    "width_deg": shown.degrees(width), "height_deg": shown.degrees(height),
                    "distance_cm": shown.distance_cm, "pixels_per_cm": shown.pixels_per_cm,
                    "encoding": options.encoding, "digest": sha256(files[coarse]), "recipe": recipe,
                }
            )  # fmt: skip
    return MatchedSet(rows, files, differences)


def recipe(
    subjects: Sequence[Subject], sources: Mapping[str, Source], frame: Frame, options: SetOptions
) -> dict[str, Any]:
    """Everything that decides the pictures."""
    return {
        "format": FORMAT,
        "options": asdict(options),
        "eyes_px": frame.eyes_px,
        "sessions": {
            name: {
                "result": source.result,
                "points": source.found_by,
                **{key: [round(float(v), 3) for v in at] for key, at in sorted(source.points.items())},
            }
            for name, source in sources.items()
        },
        "subjects": {subject.name: dict(subject.attrs) for subject in subjects},
    }


def light_preview(name: str, normal: Image) -> bytes:
    """Shape under one light at a time, over azimuth and elevation, as a PNG.

    Args:
        name: of the session.
        normal: (xyz, y, x), NaN where there is none.
    """
    rows, columns = np.nonzero(np.isfinite(normal[0]))
    normal = normal[:, rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    size = (
        _INCHES * len(_AZIMUTHS),
        _INCHES * len(_ELEVATIONS) * normal.shape[1] / normal.shape[2] + 0.8,
    )
    figure, axes = pyplot().subplots(len(_ELEVATIONS), len(_AZIMUTHS), figsize=size, layout="constrained")
    for row, elevation in zip(axes, _ELEVATIONS, strict=True):
        for axis, azimuth in zip(row, _AZIMUTHS, strict=True):
            picture = encode_srgb(shade(normal, (DistantLight(azimuth, elevation, 1.0),)))
            axis.imshow(picture, cmap="gray", vmin=0, vmax=1)
            axis.set_title(f"{azimuth},{elevation},1", fontsize=8)
            axis.set_axis_off()
    figure.suptitle(f"{name}: one light at azimuth,elevation,strength; --set stimulus.lights='...' takes several")
    return png_of(figure)

"""stimuli: a matched set of face pictures of several sessions, with tables for experiments."""

import argparse
import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.cli.figures import pyplot
from lightstage.cli.run import add_run_options, pipeline_path, run_session, session_of
from lightstage.cli.show import Screen
from lightstage.cli.values import number
from lightstage.formats.whole_file import whole_file
from lightstage.store.errors import RequestError
from lightstage.store.root import Store

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lightstage.cli.face_points import Points

KINDS = ("shape", "texture", "both")
MATCHES = ("none", "mean-contrast", "histogram", "spectrum")
NODE = "stimulus"
_LUMINANCE = (0.2126, 0.7152, 0.0722)
_AZIMUTHS, _ELEVATIONS = (-60, -40, -20, 0, 20, 40, 60), (45, 30, 15, 0, -15)
_ROLL_DEG = 3.0
_LEAST_EYES_PX = 15.0
_WORTH_SAYING = 0.001
"""Part of the oval that may be filled without a word; the table has every part."""
_REMEDY = "; a smaller --contrast, or leaving out the picture that is most unlike the others, helps"
_BLACK = 1e-3
"""Luminance below which colour is noise."""


def configure(commands: Any) -> None:
    """Add the commands of this file."""
    stimuli = commands.add_parser("stimuli", help="a matched set of shape, texture and combined face pictures")
    stimuli.add_argument("sessions", nargs="+", metavar="SESSION", help="sessions or capture folders")
    stimuli.add_argument(
        "--to", type=Path, metavar="DIR", help="a new folder (default: stimuli/<recipe>-<manifest> of the store)"
    )
    stimuli.add_argument(
        "--match",
        default="mean-contrast",
        metavar="HOW[,HOW]",
        help=f"{', '.join(MATCHES)}; histogram,spectrum is possible (default: mean-contrast)",
    )
    stimuli.add_argument(
        "--across", choices=("set", "kind"), default="set", help="equal over the whole set, or within each kind"
    )
    stimuli.add_argument("--kinds", default=",".join(KINDS), metavar="KIND,...", help="default: %(default)s")
    stimuli.add_argument("--mean", type=number, metavar="L", help="mean luminance, 0 to 1 (default: the set's)")
    stimuli.add_argument("--contrast", type=number, metavar="L", help="its standard deviation (default: the set's)")
    stimuli.add_argument(
        "--background", type=number, metavar="L", help="luminance around the oval (default: the mean)"
    )
    stimuli.add_argument("--grey", action="store_true", help="grey pictures (default: colour)")
    stimuli.add_argument(
        "--encoding",
        choices=("srgb", "linear"),
        default="srgb",
        help="of the 8-bit pictures; linear needs a linear screen",
    )
    stimuli.add_argument(
        "--points", type=Path, metavar="FILE", help="YAML: session: {left_eye: [x, y], right_eye: ...}"
    )
    stimuli.add_argument(
        "--eyes-px", type=number, metavar="N", help="eye distance in the pictures (default: the set's mean)"
    )
    stimuli.add_argument(
        "--distance-cm", type=number, default=57.0, metavar="CM", help="eye to screen (default: 57)"
    )
    stimuli.add_argument(
        "--pixels-per-cm", type=number, default=37.8, metavar="N", help="of the screen (default: 37.8)"
    )
    stimuli.add_argument(
        "--morph", nargs=2, metavar=("A", "B"), help="pictures between two of the sessions instead"
    )
    stimuli.add_argument("--levels", default="0,0.25,0.5,0.75,1", metavar="T,...", help="of a morph; 0 is A")
    stimuli.add_argument("--vary", choices=("shape", "texture"), default="shape", help="what a morph changes")
    stimuli.add_argument(
        "--jspsych", type=Path, metavar="DIR", help="a folder with a copy of jsPsych, for a page without network"
    )
    stimuli.add_argument(
        "--preview-lights", action="store_true", help="a sheet of shape under single lights instead"
    )
    add_run_options(stimuli)
    stimuli.set_defaults(handler=handle_stimuli, computes=True)


@dataclass(frozen=True)
class Subject:
    """One session, brought to the frame."""

    name: str
    normal: "NDArray[np.float32]"
    """(xyz, y, x)."""
    images: "Mapping[str, NDArray[np.float32]]"
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
    points: "Points"
    """In the session's pictures."""
    framed: "Points"
    """In the frame."""


def handle_stimuli(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage stimuli."""
    _check(options)
    store = Store(options.store)
    names = [session_of(given, store, screen) for given in options.sessions]
    if len(set(names)) < len(names):
        raise RequestError("a session is named twice; a set holds each once")
    lacking = [name for name in options.morph or () if name not in names]
    if lacking:
        raise RequestError(f"--morph: '{lacking[0]}' is not among the sessions named ({', '.join(names)})")
    if options.morph and options.morph[0] == options.morph[1]:
        raise RequestError(f"--morph: '{options.morph[0]}' is named twice; between a face and itself is nothing")
    if options.morph:
        names = list(options.morph)  # others would only change the size of the pictures
    opened = {name: _computed(name, options, store, screen) for name in names}
    if options.preview_lights:
        return _preview(opened, options, store, screen)
    points = _points(opened, options, screen)
    subjects, sources, frame = _framed(opened, points, options, screen)
    if options.morph:
        subjects = _morphed(subjects, sources, frame, options)
    return _written(subjects, sources, frame, options, store, screen)


def _check(options: argparse.Namespace) -> None:
    from lightstage.store.document import nearest

    for what, given, known in (("--match", options.match, MATCHES), ("--kinds", options.kinds, KINDS)):
        for word in given.split(","):
            if word not in known:
                raise RequestError(f"{what} {given}: '{word}' is not known{nearest(word, known)}")
        if len(set(given.split(","))) < len(given.split(",")):
            raise RequestError(f"{what} {given}: a word stands twice; each counts once")
    if "none" in options.match.split(",") and options.match != "none":
        raise RequestError(f"--match {options.match}: none stands alone")
    ranges = (
        ("--mean", options.mean, 0, 1),
        ("--contrast", options.contrast, 0, 0.5),
        ("--background", options.background, 0, 1),
        ("--eyes-px", options.eyes_px, _LEAST_EYES_PX, 2000),
        ("--distance-cm", options.distance_cm, 1, 10000),
        ("--pixels-per-cm", options.pixels_per_cm, 1, 10000),
    )
    for name, value, least, most in ranges:
        if value is not None and not least < value <= most:  # also for NaN
            raise RequestError(f"{name} {value:g}: expected a number above {least:g} and up to {most:g}")
    if options.match == "none" and (options.mean is not None or options.contrast is not None):
        raise RequestError("--mean and --contrast are met by matching; leave --match none out")
    _levels(options.levels)


def _levels(text: str) -> list[float]:
    try:
        levels = [float(word) for word in text.split(",")]
    except ValueError:
        levels = [float("nan")]
    # files are named by hundredths
    if not all(0 <= level <= 1 for level in levels) or len({round(100 * level) for level in levels}) < len(levels):
        raise RequestError(f"--levels {text}: expected numbers from 0 to 1 that differ by 0.01, such as 0,0.5,1")
    return levels


def _computed(name: str, options: argparse.Namespace, store: Store, screen: Screen) -> tuple[Any, Any, str]:
    """The stimulus result and the normals that it was made from, opened, and the result's folder."""
    from lightstage.dag.graph import load_graph
    from lightstage.stages import TABLE
    from lightstage.store.grid import open_dataset

    graph = load_graph(pipeline_path(options.pipeline), TABLE, overrides=options.overrides)
    node = graph.nodes.get(NODE)
    if node is None:
        raise RequestError(f"{pipeline_path(options.pipeline)} has no node '{NODE}', which stimuli are made from")
    one = copy.copy(options)
    one.session = name
    screen.say(f"{name}:")
    done = run_session(one, store, screen, (NODE,))["nodes"]
    paths = [done[n]["path"] for n in (NODE, node.above[0])]
    if None in paths:
        raise RequestError(f"session '{name}': --frames leaves nothing to make stimuli of")
    pictures, relief = (open_dataset(Path(path)) for path in paths)
    # not every tracking frame that has normals has a reflectance
    return pictures, relief.sel(tracking=pictures.tracking.values), Path(paths[0]).name


def _points(
    opened: Mapping[str, tuple[Any, Any, str]], options: argparse.Namespace, screen: Screen
) -> "dict[str, tuple[Points, str]]":
    """Points in each picture, and how they were found."""
    from lightstage.cli.face_points import find_points, read_points

    given = read_points(options.points, list(opened)) if options.points else {}
    found: dict[str, tuple[Points, str]] = {}
    for name, (_, relief, _) in opened.items():
        if name in given:
            height, width = relief.sizes["y"], relief.sizes["x"]
            for point, (x, y) in given[name].items():
                if not (0 <= x <= width - 1 and 0 <= y <= height - 1):
                    raise RequestError(
                        f"{options.points}: '{name}', {point}: ({x:g}, {y:g}) is outside the picture of "
                        f"{width} x {height} pixels"
                    )
            found[name] = given[name], "given"
            continue
        points, fit = find_points(relief.normal.values[0, 0], name)
        found[name] = points, "mean head"
        left, right = (points[eye] for eye in ("left_eye", "right_eye"))
        screen.warn(
            f"{name}: eyes at ({left[0]:.1f}, {left[1]:.1f}) and ({right[0]:.1f}, {right[1]:.1f}), found with a "
            f"mean head laid over the normals (fit {fit:.2f}); --points FILE gives them by hand"
        )
    return found


def _framed(
    opened: Mapping[str, tuple[Any, Any, str]],
    points: "Mapping[str, tuple[Points, str]]",
    options: argparse.Namespace,
    screen: Screen,
) -> tuple[list[Subject], dict[str, Source], Any]:
    """Every session in one frame."""
    import math

    import numpy as np

    from lightstage.cli.face_points import EYES
    from lightstage.kernels.faces.face_frame import Frame, bring, similarity, turned
    from lightstage.kernels.motion.flow_warp import unit

    eyes = {name: np.stack([found[eye] for eye in EYES]) for name, (found, _) in points.items()}
    apart = [float(np.linalg.norm(pair[1] - pair[0])) for pair in eyes.values()]
    if not options.eyes_px and np.mean(apart) < _LEAST_EYES_PX:
        raise RequestError(
            f"the eyes are {np.mean(apart):.1f} pixels apart, too near for a face: mend the points, or say with "
            "--eyes-px how far apart they shall be"
        )
    frame = Frame(float(options.eyes_px or round(float(np.mean(apart)))))
    oval = frame.oval() > 0
    subjects, sources = [], {}
    for name, (pictures, relief, folder) in opened.items():
        if pictures.sizes["tracking"] > 1:
            screen.warn(f"{name}: a performance; its first tracking frame is used")
        matrix = similarity(eyes[name], frame)
        roll = math.degrees(math.atan2(matrix[1, 0], matrix[0, 0]))
        if abs(roll) > _ROLL_DEG:
            screen.warn(
                f"{name}: the head leans by {roll:.1f} degrees; the light turns with it when it is set upright"
            )
        images, there = {}, None
        for k, kind in enumerate(str(kind) for kind in pictures.kind.values):
            images[kind], there = bring(pictures.image.values[0, k], matrix, frame.shape)
        assert there is not None
        filled = float(np.mean(~there[oval]))
        if filled > _WORTH_SAYING:
            screen.warn(f"{name}: {100 * filled:.1f} % of the oval was not measured, and is filled from beside it")
        known = np.isfinite(pictures.image.values[0]).all(axis=(0, 1))
        # what the pictures fill is filled in the normals, so that a morph starts at the picture itself
        normal = np.where(known, relief.normal.values[0, 0].astype(np.float32), np.float32(np.nan))
        normal = unit(bring(normal, matrix, frame.shape)[0])
        back = np.linalg.inv(np.concatenate([matrix, [[0, 0, 1]]]))
        own, found_by = points[name]
        framed = {key: back[:2, :2] @ at + back[:2, 2] for key, at in own.items()}
        sources[name] = Source(folder, found_by, own, framed)
        attrs = {k: v for k, v in pictures.attrs.items() if isinstance(v, str | int | float)}
        subjects.append(Subject(name, turned(normal, matrix), images, filled, attrs))
    return subjects, sources, frame


def _morphed(
    subjects: Sequence[Subject], sources: Mapping[str, Source], frame: Any, options: argparse.Namespace
) -> list[Subject]:
    """Pictures between two subjects: one property goes from A to B, the other stays A's."""
    import numpy as np

    from lightstage.kernels.appearance.distant_lights import parse_lights
    from lightstage.kernels.appearance.shading import shade
    from lightstage.kernels.faces.face_flow import between, mixed_normals, pulled

    by_name = {subject.name: subject for subject in subjects}
    a, b = (by_name[name] for name in options.morph)
    if a.attrs["cast_shadows"] or b.attrs["cast_shadows"]:
        raise RequestError("--morph: between two faces there is no depth; leave stimulus.cast_shadows out")
    if a.images["texture"].shape != b.images["texture"].shape:
        raise RequestError("--morph: one session is in colour and one is not; set stimulus.colour=grey for both")
    flow = _flow_between(a, b, sources, frame)
    lights = parse_lights(str(a.attrs["lights"]))
    made = []
    for level in _levels(options.levels):
        if options.vary == "shape":
            to = between(flow, level)
            normal = mixed_normals(pulled(a.normal, to.first), pulled(b.normal, to.second), level)
            texture = pulled(a.images["texture"], to.first)
        else:
            normal = a.normal
            mixed = (1 - level) * a.images["texture"] + level * pulled(b.images["texture"], flow)
            texture = mixed.astype(np.float32)
        shape = np.broadcast_to(shade(normal, lights), texture.shape)
        images = {"shape": shape, "texture": texture, "both": shape * texture}
        name = f"{a.name}-{b.name}-{options.vary}-{round(100 * level):03d}"
        made.append(Subject(name, normal, images, max(a.filled, b.filled), a.attrs))
    return made


def _flow_between(a: Subject, b: Subject, sources: Mapping[str, Source], frame: Any) -> "NDArray[np.float32]":
    """From a to b; it leads through the points that somebody gave for both."""
    import numpy as np

    from lightstage.kernels.errors import KernelError
    from lightstage.kernels.faces.face_flow import face_flow, through_points

    flow = face_flow(a.normal, b.normal, frame.oval(), frame.eyes_px)
    given = [sources[one.name] for one in (a, b)]
    names = sorted(set.intersection(*(set(one.framed) for one in given)))
    if any(one.found_by != "given" for one in given):
        return flow
    try:
        return through_points(flow, *(np.stack([one.framed[name] for name in names]) for one in given))
    except KernelError as error:
        raise RequestError(f"--points: '{a.name}': {error}") from None


def _setting(
    pictures: "Sequence[NDArray[Any]]", frame: Any, options: argparse.Namespace
) -> tuple[Any, "list[NDArray[Any]]", "list[NDArray[Any]]"]:
    """What `matching` needs: the setting, luminance (y, x), and colour as a multiple of it (y, x, rgb)."""
    import numpy as np

    from lightstage.kernels.appearance.colour import decode_srgb, encode_srgb
    from lightstage.kernels.faces.matching import TOP, Encoding, Setting, grey_setting

    oval = frame.oval().astype(np.float64)
    linear = options.encoding == "linear"
    encoding = Encoding(np.asarray, np.asarray) if linear else Encoding(encode_srgb, decode_srgb)
    background = float("nan") if options.background is None else options.background
    weights = np.array(_LUMINANCE)
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


def _written(
    subjects: Sequence[Subject],
    sources: Mapping[str, Source],
    frame: Any,
    options: argparse.Namespace,
    store: Store,
    screen: Screen,
) -> int:
    """Match, write, and say what came out."""
    import numpy as np

    from lightstage.cli import stimulus_files as files
    from lightstage.cli.face_points import as_yaml
    from lightstage.kernels.errors import KernelError
    from lightstage.kernels.faces.matching import apart, match
    from lightstage.store.digest import SHORT, digest_value

    kinds = options.kinds.split(",")
    entries = [(subject, kind) for kind in kinds for subject in subjects]
    methods = [] if options.match == "none" else options.match.split(",")
    groups = [entries] if options.across == "set" else [[e for e in entries if e[1] == kind] for kind in kinds]
    recipe = _recipe(subjects, sources, frame, options)
    recipe["digest"] = digest_value(recipe)[:SHORT]
    shown = files.Screen(options.distance_cm, options.pixels_per_cm)
    rows, data, differences = [], {}, []
    for group in groups:
        setting, luminance, tint = _setting([one.images[kind] for one, kind in group], frame, options)
        try:
            matched = match(luminance, setting, methods, mean=options.mean, contrast=options.contrast)
        except KernelError as error:
            raise RequestError(str(error)) from None
        differences.append(apart(matched))
        for i, ((subject, kind), one) in enumerate(zip(group, matched, strict=True)):
            name = f"{subject.name}_{kind}.png"
            data[name] = files.png(setting.store(i, one.luminance), srgb=options.encoding == "srgb")
            fine = tint[i] * one.luminance[..., None] if tint else one.luminance
            counts = np.floor(np.clip(fine, 0, 1) * 65535 + 0.5).astype(np.uint16)
            data[f"16bit/{name}"] = files.png(counts, srgb=False)
            height, width = frame.shape
            rows.append(
                {
                    "subject": subject.name, "kind": kind, "file": name, "file_16bit": f"16bit/{name}",
                    "lights": "" if kind == "texture" else subject.attrs["lights"],
                    "mean": one.figures.mean_code, "contrast": one.figures.contrast_code, "rms": one.figures.rms,
                    "mean_linear": one.figures.mean_linear, "contrast_linear": one.figures.contrast_linear,
                    "clipped": one.clipped, "filled": subject.filled,
                    "width_px": width, "height_px": height,
                    "width_deg": shown.degrees(width), "height_deg": shown.degrees(height),
                    "distance_cm": shown.distance_cm, "pixels_per_cm": shown.pixels_per_cm,
                    "encoding": options.encoding, "digest": files.sha256(data[name]), "recipe": recipe["digest"],
                }
            )  # fmt: skip
    clipped = [f"{row['file']} ({100 * row['clipped']:.2g} %)" for row in rows if row["clipped"] > 0]
    if clipped:
        screen.warn(
            f"clipped to black or white, of the oval: {', '.join(clipped)}; a smaller --contrast or another --mean "
            "avoids it"
        )
    points = as_yaml({name: source.points for name, source in sources.items()})
    content = files.assemble(rows, data, recipe, points, jspsych=options.jspsych)
    folder = options.to or store.root / "stimuli" / f"{recipe['digest']}-{files.manifest(content)}"
    new = files.write_set(folder.absolute(), content)
    called = kinds if options.across == "kind" else ["the set"]
    for off, what in zip(differences, called, strict=True):
        if len(rows) > len(called):  # one picture is equal to itself
            _say_how_equal(off, what, methods, screen)
    people = f"{len(subjects)} subject{'s' if len(subjects) > 1 else ''}"
    screen.say(f"{len(rows)} stimuli of {people} {'are' if new else 'were already'} in {folder}")
    screen.document(
        {"folder": str(folder), "stimuli": rows, "largest_difference": differences, "recipe": recipe["digest"]}
    )
    return 0


def _say_how_equal(off: Mapping[str, float], what: str, methods: Sequence[str], screen: Screen) -> None:
    from lightstage.kernels.faces.matching import PROMISED_LEVELS, PROMISED_SPECTRUM

    screen.say(
        f"{what}, largest difference between two, in grey levels: of luminance mean {off['mean_linear']:.2f}, "
        f"contrast {off['contrast_linear']:.2f}; of code values mean {off['mean_code']:.2f}, "
        f"contrast {off['contrast_code']:.2f}; spectra from their mean {100 * off['spectrum']:.1f} %"
    )
    levels = max(value for name, value in off.items() if name != "spectrum")
    if methods and levels > PROMISED_LEVELS:
        screen.warn(f"{what} is matched to {levels:.2f} grey levels only, not to {PROMISED_LEVELS:g}{_REMEDY}")
    if "spectrum" in methods and off["spectrum"] > PROMISED_SPECTRUM:
        screen.warn(f"spectra of {what} are matched to {100 * off['spectrum']:.1f} % only, not to 1 %{_REMEDY}")


def _recipe(
    subjects: Sequence[Subject], sources: Mapping[str, Source], frame: Any, options: argparse.Namespace
) -> dict[str, Any]:
    """Everything that decides the pictures."""
    same = (
        "match", "across", "kinds", "mean", "contrast", "background", "grey", "encoding", "morph", "levels", "vary",
        "distance_cm", "pixels_per_cm",
    )  # fmt: skip
    return {
        "format": "lightstage-stimuli/1",
        "options": {name: getattr(options, name) for name in same},
        "eyes_px": frame.eyes_px,
        "sessions": {
            name: {
                "result": one.result,
                "points": one.found_by,
                **{key: [round(float(v), 3) for v in at] for key, at in sorted(one.points.items())},
            }
            for name, one in sources.items()
        },
        "subjects": {one.name: dict(one.attrs) for one in subjects},
    }


def _preview(
    opened: Mapping[str, tuple[Any, Any, str]], options: argparse.Namespace, store: Store, screen: Screen
) -> int:
    """Shape under one light at a time, over azimuth and elevation."""
    plt = pyplot()
    import numpy as np

    from lightstage.kernels.appearance.colour import encode_srgb
    from lightstage.kernels.appearance.distant_lights import DistantLight
    from lightstage.kernels.appearance.shading import shade

    if options.to is not None and options.to.exists() and not options.to.is_dir():
        raise RequestError(f"--to {options.to}: is a file; name a folder")
    folder = options.to or store.root / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, (_, relief, _) in opened.items():
        normal = relief.normal.values[0, 0].astype(np.float32)
        rows, columns = np.nonzero(np.isfinite(normal[0]))
        normal = normal[:, rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
        size = (1.5 * len(_AZIMUTHS), 1.5 * len(_ELEVATIONS) * normal.shape[1] / normal.shape[2] + 0.8)
        figure, axes = plt.subplots(len(_ELEVATIONS), len(_AZIMUTHS), figsize=size, layout="constrained")
        for row, elevation in zip(axes, _ELEVATIONS, strict=True):
            for axis, azimuth in zip(row, _AZIMUTHS, strict=True):
                picture = encode_srgb(shade(normal, (DistantLight(azimuth, elevation, 1.0),)))
                axis.imshow(picture, cmap="gray", vmin=0, vmax=1)
                axis.set_title(f"{azimuth},{elevation},1", fontsize=8)
                axis.set_axis_off()
        figure.suptitle(
            f"{name}: one light at azimuth,elevation,strength; --set stimulus.lights='...' takes several"
        )
        path = folder / f"{name}-lights.png"
        try:
            with whole_file(path) as beside:
                figure.savefig(beside, format="png", dpi=110)
        finally:
            plt.close(figure)
        screen.say(f"picture: {path}")
        written.append(str(path))
    screen.document({"pictures": written})
    return 0

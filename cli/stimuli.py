"""stimuli: a matched set of face pictures of several sessions, with tables for experiments."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from lightstage.api.refusals import refusals
from lightstage.api.requests import pipeline_path
from lightstage.api.stores import OpenStore, open_store
from lightstage.cli.run import answered, request_of, say_answer, session_given
from lightstage.cli.show import Screen
from lightstage.cli.stimulus_options import add_options, check, levels_of
from lightstage.products import names
from lightstage.store.errors import RequestError

if TYPE_CHECKING:
    from lightstage.products.face_points import Points
    from lightstage.products.stimuli import Capture

NODE = "stimulus"
_REMEDY = "; a smaller --contrast, or leaving out the picture that is most unlike the others, helps"


def configure(commands: Any) -> None:
    """Add the commands of this file."""
    stimuli = commands.add_parser("stimuli", help="a matched set of shape, texture and combined face pictures")
    add_options(stimuli)
    stimuli.set_defaults(handler=handle_stimuli, computes=True)


def handle_stimuli(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage stimuli."""
    check(options)
    store = open_store(options.store)
    sessions = [session_given(given, store, screen).name for given in options.sessions]
    if len(set(sessions)) < len(sessions):
        raise RequestError("a session is named twice; a set holds each once")
    lacking = [name for name in options.morph or () if name not in sessions]
    if lacking:
        raise RequestError(f"--morph: '{lacking[0]}' is not among the sessions named ({', '.join(sessions)})")
    if options.morph and options.morph[0] == options.morph[1]:
        raise RequestError(f"--morph: '{options.morph[0]}' is named twice; between a face and itself is nothing")
    if options.morph:
        sessions = list(options.morph)  # others would only change the size of the pictures
    opened = {name: _computed(name, options, store, screen) for name in sessions}
    if options.preview_lights:
        return _preview({name: relief for name, (_, relief, _) in opened.items()}, options, store, screen)
    return _make_set(_captures(opened, options, screen), options, store, screen)


def _computed(name: str, options: argparse.Namespace, store: OpenStore, screen: Screen) -> tuple[Any, Any, str]:
    """The stimulus result and the normals that it was made from, opened, and the result's folder."""
    from lightstage.api.pipelines import read_pipeline
    from lightstage.api.subjects import face_of

    node = read_pipeline(options.pipeline, changes=options.overrides).nodes.get(NODE)
    if node is None:
        raise RequestError(f"{pipeline_path(options.pipeline)} has no node '{NODE}', which stimuli are made from")
    screen.say(f"{name}:")
    answer = answered(store, request_of(options, name, (NODE,)), options, screen)
    say_answer(answer, screen)
    return face_of(answer, NODE, node.above[0])


def _captures(
    opened: Mapping[str, tuple[Any, Any, str]], options: argparse.Namespace, screen: Screen
) -> "dict[str, Capture]":
    """The sessions with their points: those given, or found."""
    from lightstage.cli.face_points import read_points
    from lightstage.products.face_points import find_points
    from lightstage.products.stimuli import GIVEN, Capture

    given = read_points(options.points, list(opened)) if options.points else {}
    captures = {}
    for name, (pictures, relief, result) in opened.items():
        if name in given:
            _check_inside(given[name], relief.sizes["y"], relief.sizes["x"], f"{options.points}: '{name}'")
            captures[name] = Capture(pictures, relief, result, given[name], GIVEN)
            continue
        with refusals(f"session '{name}': ", "; give the eyes by hand with --points FILE"):
            points, fit = find_points(relief.normal.values[0, 0])
        captures[name] = Capture(pictures, relief, result, points, "mean head")
        left, right = (points[eye] for eye in ("left_eye", "right_eye"))
        screen.warn(
            f"{name}: eyes at ({left[0]:.1f}, {left[1]:.1f}) and ({right[0]:.1f}, {right[1]:.1f}), found with a "
            f"mean head laid over the normals (fit {fit:.2f}); --points FILE gives them by hand"
        )
    return captures


def _check_inside(points: "Points", height: int, width: int, where: str) -> None:
    for point, (x, y) in points.items():
        if not (0 <= x <= width - 1 and 0 <= y <= height - 1):
            raise RequestError(
                f"{where}, {point}: ({x:g}, {y:g}) is outside the picture of {width} x {height} pixels"
            )


def _make_set(
    captures: "Mapping[str, Capture]", options: argparse.Namespace, store: OpenStore, screen: Screen
) -> int:
    """Bring to one frame, mix, match, write, and say what came out."""
    from lightstage.api.subjects import recipe_digest
    from lightstage.formats.whole_set import write_folder
    from lightstage.products import stimuli
    from lightstage.products.face_points import as_yaml
    from lightstage.products.stimulus_folder import assemble, jspsych_files, manifest

    wanted = stimuli.SetOptions(
        **{field.name: getattr(options, field.name) for field in fields(stimuli.SetOptions)}
    )
    jspsych = {}
    if options.jspsych:
        with refusals("--jspsych "):
            jspsych = jspsych_files(options.jspsych)
    with refusals(remedy=" with --eyes-px"):
        subjects, sources, frame = stimuli.framed(captures, options.eyes_px, screen.warn)
    if options.morph:
        with refusals("--morph: "):
            subjects = stimuli.morphed(
                subjects, sources, frame, ends=options.morph, levels=levels_of(options.levels), vary=options.vary
            )
    recipe = stimuli.recipe(subjects, sources, frame, wanted)
    recipe["digest"] = recipe_digest(recipe)
    with refusals():
        made = stimuli.matched(subjects, frame, wanted, recipe["digest"])
    clipped = [f"{row['file']} ({100 * row['clipped']:.2g} %)" for row in made.rows if row["clipped"] > 0]
    if clipped:
        screen.warn(
            f"clipped to black or white, of the oval: {', '.join(clipped)}; a smaller --contrast or another --mean "
            "avoids it"
        )
    points = as_yaml({name: source.points for name, source in sources.items()})
    content = assemble(made.rows, made.files, recipe, points, jspsych=jspsych)
    folder = options.to or store.root / "stimuli" / f"{recipe['digest']}-{recipe_digest(manifest(content))}"
    with refusals():
        new = write_folder(folder.absolute(), content)
    called = options.kinds.split(",") if options.across == "kind" else ["the set"]
    for off, what in zip(made.differences, called, strict=True):
        if len(made.rows) > len(called):  # one picture is equal to itself
            _say_how_equal(off, what, wanted.methods, screen)
    people = f"{len(subjects)} subject{'s' if len(subjects) > 1 else ''}"
    screen.say(f"{len(made.rows)} stimuli of {people} {'are' if new else 'were already'} in {folder}")
    screen.document(
        {
            "folder": str(folder),
            "stimuli": made.rows,
            "largest_difference": made.differences,
            "recipe": recipe["digest"],
        }
    )
    return 0


def _say_how_equal(off: Mapping[str, float], what: str, methods: Sequence[str], screen: Screen) -> None:
    from lightstage.products.stimuli import PROMISED_LEVELS, PROMISED_SPECTRUM

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


def _preview(reliefs: Mapping[str, Any], options: argparse.Namespace, store: OpenStore, screen: Screen) -> int:
    """Shape under one light at a time."""
    from lightstage.formats.whole_file import write_whole
    from lightstage.products.stimuli import light_preview

    if options.to is not None and options.to.exists() and not options.to.is_dir():
        raise RequestError(f"--to {options.to}: is a file; name a folder")
    folder = options.to or store.root / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, relief in reliefs.items():
        path = folder / names.light_preview(name)
        write_whole(path, light_preview(name, relief.normal.values[0, 0].astype("float32")))
        screen.say(f"picture: {path}")
        written.append(str(path))
    screen.document({"pictures": written})
    return 0

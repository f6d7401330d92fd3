"""stimuli: a matched set of face pictures of several sessions, with tables for experiments."""

import argparse
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from lightstage.api.errors import RequestError
from lightstage.api.requests import pipeline_path
from lightstage.api.stores import OpenStore, open_store
from lightstage.cli.run import answered, request_of, say_answer, session_given
from lightstage.cli.show import Screen
from lightstage.cli.stimulus_options import SET_OPTIONS, add_options, check, levels_of

if TYPE_CHECKING:
    from lightstage.api.stimulus_sets import Face

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
    faces = {name: _computed(name, options, store, screen) for name in sessions}
    return (_preview if options.preview_lights else _make_set)(faces, options, store, screen)


def _computed(name: str, options: argparse.Namespace, store: OpenStore, screen: Screen) -> "Face":
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


def _make_set(faces: "Mapping[str, Face]", options: argparse.Namespace, store: OpenStore, screen: Screen) -> int:
    """Find the eyes, make the set, and say what came out."""
    from lightstage.api.stimulus_sets import captures, write_set

    stimuli = write_set(
        captures(faces, options.points, screen.warn),
        store.opened,
        {name: getattr(options, name) for name in SET_OPTIONS},
        levels=levels_of(options.levels),
        eyes_px=options.eyes_px,
        jspsych=options.jspsych,
        folder=options.to,
        warn=screen.warn,
    )
    groups = options.kinds.split(",") if options.across == "kind" else ["the set"]
    for difference, group in zip(stimuli.differences, groups, strict=True):
        if len(stimuli.rows) > len(groups):  # one picture is equal to itself
            _say_how_equal(difference, group, options.match, screen)
    people = f"{stimuli.subjects} subject{'s' if stimuli.subjects > 1 else ''}"
    state = "are" if stimuli.new else "were already"
    screen.say(f"{len(stimuli.rows)} stimuli of {people} {state} in {stimuli.folder}")
    screen.document(
        {
            "folder": str(stimuli.folder),
            "stimuli": stimuli.rows,
            "largest_difference": stimuli.differences,
            "recipe": stimuli.recipe,
        }
    )
    return 0


def _say_how_equal(off: Mapping[str, float], what: str, match: str, screen: Screen) -> None:
    from lightstage.api.stimulus_sets import shortfalls

    screen.say(
        f"{what}, largest difference between two, in grey levels: of luminance mean {off['mean_linear']:.2f}, "
        f"contrast {off['contrast_linear']:.2f}; of code values mean {off['mean_code']:.2f}, "
        f"contrast {off['contrast_code']:.2f}; spectra from their mean {100 * off['spectrum']:.1f} %"
    )
    for sentence in shortfalls(what, off, match):
        screen.warn(sentence + _REMEDY)


def _preview(faces: "Mapping[str, Face]", options: argparse.Namespace, store: OpenStore, screen: Screen) -> int:
    """Shape under one light at a time."""
    from lightstage.api.pages import light_previews

    files = light_previews({name: relief for name, (_, relief, _) in faces.items()}, store.opened, options.to)
    for file in files:
        screen.say(f"picture: {file}")
    screen.document({"pictures": [str(file) for file in files]})
    return 0

"""A matched set of face pictures of several sessions: brought to one frame, mixed, made equal, written."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.api.face_points import read_points
from lightstage.api.refusals import refusals
from lightstage.api.subjects import recipe_digest
from lightstage.store.errors import RequestError
from lightstage.store.root import Store

if TYPE_CHECKING:
    from lightstage.products.face_points import Points
    from lightstage.products.stimuli import Capture

Face = tuple[Any, Any, str]
"""The pictures of a session's stimulus node, the normals that they were made from, and the result's folder; see
`subjects.face_of`."""


@dataclass(frozen=True)
class StimulusSet:
    """A set that was written."""

    folder: Path
    new: bool
    """False: the same was there."""
    subjects: int
    rows: list[dict[str, Any]]
    """What the table says, one a picture."""
    differences: list[dict[str, float]]
    """The largest between two pictures, of every group that was made equal."""
    recipe: str
    """Its digest."""


def captures(
    faces: Mapping[str, Face], points_file: Path | None, warn: Callable[[str], None]
) -> "dict[str, Capture]":
    """The sessions with their points: those given in a file, or found.

    Args:
        faces: by session.
        warn: is told where the eyes were found.

    Raises:
        RequestError: the file does not fit, a point is outside its picture, or no face is found.
    """
    from lightstage.products.face_points import find_points
    from lightstage.products.stimuli import GIVEN, Capture

    given = read_points(points_file, list(faces)) if points_file else {}
    captured = {}
    for name, (pictures, relief, result) in faces.items():
        if name in given:
            _check_inside(given[name], relief.sizes["y"], relief.sizes["x"], f"{points_file}: '{name}'")
            captured[name] = Capture(pictures, relief, result, given[name], GIVEN)
            continue
        with refusals(f"session '{name}': ", "; give the eyes by hand with --points FILE"):
            points, fit = find_points(relief.normal.values[0, 0])
        captured[name] = Capture(pictures, relief, result, points, "mean head")
        left, right = (points[eye] for eye in ("left_eye", "right_eye"))
        warn(
            f"{name}: eyes at ({left[0]:.1f}, {left[1]:.1f}) and ({right[0]:.1f}, {right[1]:.1f}), found with a "
            f"mean head laid over the normals (fit {fit:.2f}); --points FILE gives them by hand"
        )
    return captured


def _check_inside(points: "Points", height: int, width: int, where: str) -> None:
    for point, (x, y) in points.items():
        if not (0 <= x <= width - 1 and 0 <= y <= height - 1):
            raise RequestError(
                f"{where}, {point}: ({x:g}, {y:g}) is outside the picture of {width} x {height} pixels"
            )


def write_set(
    captured: "Mapping[str, Capture]",
    store: Store,
    options: Mapping[str, Any],
    *,
    levels: Sequence[float] = (),
    eyes_px: float | None = None,
    jspsych: Path | None = None,
    folder: Path | None = None,
    warn: Callable[[str], None],
) -> StimulusSet:
    """Bring to one frame, mix, match and write.

    Args:
        captured: by session.
        options: of `products.stimuli.SetOptions`, by name.
        levels: of a morph.
        eyes_px: between the eyes; None: the set's mean.
        jspsych: a folder with a copy of jsPsych.
        folder: a new one; None: by recipe and content, in the store.
        warn: is told what a person should know.

    Raises:
        RequestError: the faces do not go together, or something else is in the folder's place.
    """
    from lightstage.formats.whole_set import write_folder
    from lightstage.products import stimuli
    from lightstage.products.face_points import as_yaml
    from lightstage.products.stimulus_folder import assemble, jspsych_files, manifest

    wanted = stimuli.SetOptions(**options)
    with refusals("--jspsych "):
        beside = jspsych_files(jspsych) if jspsych else {}
    with refusals(remedy=" with --eyes-px"):
        subjects, sources, frame = stimuli.framed(captured, eyes_px, warn)
    if wanted.morph:
        with refusals("--morph: "):
            subjects = stimuli.morphed(subjects, sources, frame, ends=wanted.morph, levels=levels, vary=wanted.vary)
    recipe = stimuli.recipe(subjects, sources, frame, wanted)
    recipe["digest"] = recipe_digest(recipe)
    with refusals():
        matched = stimuli.matched(subjects, frame, wanted, recipe["digest"])
    clipped = [f"{row['file']} ({100 * row['clipped']:.2g} %)" for row in matched.rows if row["clipped"] > 0]
    if clipped:
        warn(
            f"clipped to black or white, of the oval: {', '.join(clipped)}; a smaller --contrast or another --mean "
            "avoids it"
        )
    points = as_yaml({name: source.points for name, source in sources.items()})
    content = assemble(matched.rows, matched.files, recipe, points, jspsych=beside)
    place = folder or store.root / "stimuli" / f"{recipe['digest']}-{recipe_digest(manifest(content))}"
    with refusals():
        new = write_folder(place.absolute(), content)
    return StimulusSet(place, new, len(subjects), matched.rows, matched.differences, recipe["digest"])


def shortfalls(what: str, difference: Mapping[str, float], match: str) -> list[str]:
    """What matching promised and could not keep, a sentence each.

    Args:
        what: the pictures that were made equal.
        difference: the largest between two of them.
        match: as in the options.
    """
    from lightstage.products.stimuli import PROMISED_LEVELS, PROMISED_SPECTRUM

    sentences = []
    levels = max(value for name, value in difference.items() if name != "spectrum")
    if match != "none" and levels > PROMISED_LEVELS:
        sentences.append(f"{what} is matched to {levels:.2f} grey levels only, not to {PROMISED_LEVELS:g}")
    if "spectrum" in match.split(",") and difference["spectrum"] > PROMISED_SPECTRUM:
        sentences.append(
            f"spectra of {what} are matched to {100 * difference['spectrum']:.1f} % only, "
            f"not to {100 * PROMISED_SPECTRUM:g} %"
        )
    return sentences

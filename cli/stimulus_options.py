"""What `stimuli` lets one choose, and what of it can be refused without looking at anything."""

import argparse
from pathlib import Path

from lightstage.api.errors import RequestError
from lightstage.cli.run import add_run_options
from lightstage.cli.values import number
from lightstage.products import choices

SET_OPTIONS = (
    "match", "across", "kinds", "mean", "contrast", "background", "grey", "encoding", "morph", "levels", "vary",
    "distance_cm", "pixels_per_cm",
)  # fmt: skip
"""Those that the set's recipe has."""


def add_options(stimuli: argparse.ArgumentParser) -> None:
    """Add them to the command's parser."""
    stimuli.add_argument("sessions", nargs="+", metavar="SESSION", help="sessions or capture folders")
    stimuli.add_argument(
        "--to", type=Path, metavar="DIR", help="a new folder (default: stimuli/<recipe>-<manifest> of the store)"
    )
    stimuli.add_argument(
        "--match",
        default="mean-contrast",
        metavar="HOW[,HOW]",
        help=f"{', '.join(choices.MATCHES)}; histogram,spectrum is possible (default: mean-contrast)",
    )
    stimuli.add_argument(
        "--across", choices=("set", "kind"), default="set", help="equal over the whole set, or within each kind"
    )
    stimuli.add_argument(
        "--kinds", default=",".join(choices.STIMULUS_KINDS), metavar="KIND,...", help="default: %(default)s"
    )
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


def check(options: argparse.Namespace) -> None:
    """Refuse what cannot be meant.

    Raises:
        RequestError: a word is not known, a number is out of range, or two options do not go together.
    """
    from lightstage.store.document import nearest

    for what, given, known in (
        ("--match", options.match, choices.MATCHES),
        ("--kinds", options.kinds, choices.STIMULUS_KINDS),
    ):
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
        ("--eyes-px", options.eyes_px, choices.NEAREST_EYES_PX, 2000),
        ("--distance-cm", options.distance_cm, 1, 10000),
        ("--pixels-per-cm", options.pixels_per_cm, 1, 10000),
    )
    for name, value, least, most in ranges:
        if value is not None and not least < value <= most:  # also for NaN
            raise RequestError(f"{name} {value:g}: expected a number above {least:g} and up to {most:g}")
    if options.match == "none" and (options.mean is not None or options.contrast is not None):
        raise RequestError("--mean and --contrast are met by matching; leave --match none out")
    levels_of(options.levels)


def levels_of(text: str) -> list[float]:
    """The levels of a morph.

    Raises:
        RequestError: they are not from 0 to 1, or two have one name.
    """
    try:
        levels = [float(word) for word in text.split(",")]
    except ValueError:
        levels = [float("nan")]
    # files are named by hundredths
    if not all(0 <= level <= 1 for level in levels) or len({round(100 * level) for level in levels}) < len(levels):
        raise RequestError(f"--levels {text}: expected numbers from 0 to 1 that differ by 0.01, such as 0,0.5,1")
    return levels

"""Where the eyes of a session are, given by hand: the file of --points."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lightstage.store.errors import RequestError

if TYPE_CHECKING:
    from lightstage.products.face_points import Points


def read_points(path: Path, sessions: Sequence[str]) -> "dict[str, Points]":
    """Points by session and name from a YAML file: `session: {left_eye: [x, y], right_eye: [x, y], ...}`, pixels.

    Raises:
        RequestError: no such file, a session without eyes, or a point that is no pair of numbers.
    """
    from lightstage.products.face_points import EYES, points_of_numbers
    from lightstage.store.document import load

    plain = load(path, what="a file of points").value
    if not isinstance(plain, Mapping):
        raise RequestError(
            f"{path}: expected sessions with their points, such as `s1: {{left_eye: [120, 90], ...}}`"
        )
    if not any(name in plain for name in sessions):
        listed = ", ".join(map(str, plain)) or "none"
        raise RequestError(f"{path}: has points of {listed}, and of none of the sessions ({', '.join(sessions)})")
    points_of: dict[str, Points] = {}
    by_name = {str(name): given for name, given in plain.items()}
    for name in sessions:
        if name not in by_name:
            continue
        given = by_name[name]
        if not isinstance(given, Mapping) or any(eye not in given for eye in EYES):
            raise RequestError(f"{path}: '{name}' needs left_eye and right_eye, each [x, y] in pixels")
        for key, value in given.items():
            if not isinstance(value, Sequence) or len(value) != 2 or not all(_is_number(v) for v in value):
                raise RequestError(f"{path}: '{name}', {key}: expected [x, y] in pixels, found {value!r}")
        points = points_of_numbers(given)
        if points["left_eye"][0] >= points["right_eye"][0]:
            raise RequestError(
                f"{path}: '{name}': left_eye is the one at the left of the picture, so its x must be smaller"
            )
        points_of[name] = points
    return points_of


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)

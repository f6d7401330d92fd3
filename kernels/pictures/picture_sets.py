"""Which pictures belong together: the sets that a method needs, and the windows of a performance.

The window of a tracking frame (C) are the pictures between the tracking frame before it and the one after it, or
the ends of the sequence. Of an illumination that stands in it twice the nearest in time counts. Pure Python: stages
declare with it what they read.

Sources: Ma et al. (2007), Wilson et al. (2010), Dutta (2010) chapters 4 and 5.
"""

import contextlib
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from lightstage.hw import illuminations
from lightstage.hw.illuminations import AXES, CONSTANT, GRADIENTS, complement, is_light
from lightstage.kernels.errors import KernelError
from lightstage.kernels.normals.gradient_methods import table

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
        KernelError: the set does not support what was asked for; says what is missing and what would work.
    """
    present = set(have)
    if base != "auto" and method not in ("auto", "minimal"):
        raise KernelError(f"base: {base} belongs to method: minimal; {method} has none, so set base: auto")
    if base != "auto":
        method = "minimal"
    lights = tuple(name for name in dict.fromkeys(have) if is_light(name))
    supported = [name for name in _BY_NOISE if _supports(name, base, present)]
    chosen = (supported[0] if supported else None) if method == "auto" else method
    if chosen not in supported:
        works = f"method: {' or '.join(supported)} would work" if supported else "no method works with these"
        what = "any method" if method == "auto" else method + (f" with base {base}" if base != "auto" else "")
        raise KernelError(
            f"{what} needs {_needs(method, base)}; the session has {', '.join(dict.fromkeys(have))}; {works}"
        )
    if chosen == "least_squares":
        if correct != "none":
            raise KernelError(
                f"correct: {correct} belongs to the gradient methods; with least_squares set correct: none"
            )
        return Choice(chosen, "", lights)
    axis = (
        next(a for a in AXES if base in ("auto", a) and _supports("minimal", a, present))
        if chosen == "minimal"
        else ""
    )
    missing = [name for name in (*GRADIENTS, CONSTANT) if name not in present]
    if correct == "qp" and missing:
        raise KernelError(
            f"correct: qp needs {', '.join((*GRADIENTS, CONSTANT))}; {', '.join(missing)} missing; "
            f"correct: none works with {chosen}"
        )
    wanted = table(str(chosen), axis, have, qp=correct == "qp").pictures
    return Choice(str(chosen), axis, wanted)


def _supports(method: str, base: str, present: set[str]) -> bool:
    if method == "least_squares":
        return sum(is_light(name) for name in present) >= 3
    if method == "difference":
        return present >= set(GRADIENTS)
    if method == "ratio":
        return present >= {*AXES, CONSTANT}
    all_axes = all(axis in present or complement(axis) in present for axis in AXES)
    return all_axes and any(base in ("auto", axis) for axis, _ in illuminations.pairs(present))


def _needs(method: str, base: str) -> str:
    pair = "the pair of one axis (X Xc, Y Yc or Z Zc)" if base == "auto" else f"{base} and {complement(base)}"
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


class Window(NamedTuple):
    """A tracking frame and the pictures around it."""

    frame: int
    """Its index in the session."""
    at: dict[str, int]
    """Illumination -> index of its picture, nearest first; the tracking frame itself is C."""


def windows(illumination: Sequence[str]) -> list[Window]:
    """The window of every tracking frame, in order."""
    tracking = [i for i, name in enumerate(illumination) if name == CONSTANT]
    out = []
    for k, frame in enumerate(tracking):
        first = tracking[k - 1] + 1 if k else 0
        last = tracking[k + 1] if k + 1 < len(tracking) else len(illumination)
        at: dict[str, int] = {}
        for i in sorted(range(first, last), key=lambda i: abs(i - frame)):
            at.setdefault(illumination[i], i)
        out.append(Window(frame, at))
    return out


def chosen_sets(
    candidates: Sequence[Window], *, method: str, base: str, correct: str, whole: str
) -> list[tuple[Window, Choice]]:
    """The windows that hold a full set, and the method for each.

    Args:
        whole: all illuminations, for the error.

    Raises:
        KernelError: none does; says what is missing and what would work.
    """
    out: list[tuple[Window, Choice]] = []
    for window in candidates:
        with contextlib.suppress(KernelError):
            out.append((window, choose(list(window.at), method=method, base=base, correct=correct)))
    if not out:
        works = [m for m in _BY_NOISE if any(_supports(m, "auto", set(window.at)) for window in candidates)]
        hint = f"method: {' or '.join(works)} with base: auto would work" if works else "no method works with these"
        raise KernelError(
            f"{method} needs {_needs(method, base)} between the tracking frames (C) before and after one; "
            f"the session has {whole}; {hint}"
        )
    return out


def pairs(names: Sequence[str]) -> list[tuple[int, int]]:
    """Places of each gradient and its complement."""
    return [(names.index(gradient), names.index(opposite)) for gradient, opposite in illuminations.pairs(names)]


def picture_times(facts: Mapping[str, Any]) -> list[float]:
    """When each picture of a session was taken, in seconds; by the frame rate where the capture does not say."""
    times = list(facts["time_s"])
    if all(time is not None and math.isfinite(time) for time in times) and len(set(times)) == len(times):
        return [float(time) for time in times]
    rate = facts["frame_rate_hz"] or 1.0
    return [i / rate for i in range(len(facts["illumination"]))]

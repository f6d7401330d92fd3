"""Whether every picture shows the illumination that it should, and only that (Dutta 2010, 3.1.3).

Per picture, drive w of the lights from the highlights s on a mirror ball, with R the highlights of one light at a
time (columns: lights):

    s = R w,  w >= 0        w = (1 - e - l) P_now + e P_before + l P_after

P are the known patterns. Which step of the sequence a picture shows is the cheapest alignment of what was found
with what was meant: neighbours swapped, a picture dropped, one repeated or too many, one of another kind (Damerau
1964, doi:10.1145/363958.363994). Patterns that repeat every n steps cannot tell a shift by n from none.

Must have run before: photometry.highlight_sums on the pictures and on the one-light pictures.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from lightstage.kernels.errors import KernelError

Array = NDArray[np.float64]
_SWAP, _GAP, _WRONG = 1.0, 1.2, 1.5
"""Costs of an alignment: a shift of the rest (two gaps at most) is cheaper than two wrong pictures."""
_AS_NEIGHBOUR = -2


@dataclass(frozen=True)
class Event:
    """One thing that is out of order."""

    kind: Literal["swapped", "dropped", "repeated", "extra", "shifted", "wrong"]
    frames: tuple[int, ...]
    """The pictures concerned; for `dropped`, the picture before which it is missing."""
    says: str


@dataclass(frozen=True)
class Synchronisation:
    """What the pictures of a test show."""

    shown: tuple[str, ...]
    """(frame,): the illumination that lit most of it."""
    step: NDArray[np.int64]
    """(frame,): the step of the sequence that it shows; -1 where it fits none."""
    wrong: NDArray[np.bool_]
    """(frame,): not what was meant at this place."""
    drive: Array
    """(frame, light): NaN for lights that are not seen."""
    leak_before_percent: Array
    """(frame,): of the exposure, under the illumination before; NaN where it cannot be told."""
    leak_after_percent: Array
    leak_se_percent: Array
    unexplained_percent: Array
    """(frame,): light that belongs to none of the three."""
    events: tuple[Event, ...]


def check(
    sums: Array,
    one_light: Array,
    declared: Sequence[str],
    patterns: Mapping[str, Array],
    *,
    variance: Array | None = None,
    dark_below: float = 0.02,
) -> Synchronisation:
    """Judge a test sequence.

    Args:
        sums: (frame, light), highlight sums; NaN where saturated or not seen.
        one_light: (light that is on, highlight), the same from one-light pictures.
        declared: (frame,), the illumination meant.
        patterns: illumination to drive (light,), from 0 to 1.
        variance: (frame, light) of `sums`, for the standard errors.
        dark_below: a picture with less drive than this share of one pattern shows no light, `O`.

    Raises:
        KernelError: shapes disagree, an illumination has no pattern, or no light of a pattern is seen.
    """
    frames, lights = sums.shape
    if one_light.shape != (lights, lights) or len(declared) != frames:
        raise KernelError(
            f"{frames} frames of {lights} highlights need {frames} names and ({lights}, {lights}) one-light "
            f"highlights, not {len(declared)} and {one_light.shape}"
        )
    unknown = sorted(set(declared) - set(patterns))
    if unknown:
        raise KernelError(
            f"the illumination '{unknown[0]}' has no pattern; known are {', '.join(sorted(patterns))}"
        )
    strength = np.diag(one_light)
    seen = np.isfinite(strength) & (strength > 0.05 * np.nanmedian(strength))
    names = list(dict.fromkeys(declared))
    for name in names:
        if patterns[name].any() and not patterns[name][seen].any():
            raise KernelError(f"no light of {name} is seen on the ball; place the ball so that each pattern shows")
    crossed = _neighbours(one_light, strength, seen)
    drive = np.full(sums.shape, np.nan)
    spread = np.full(sums.shape, np.nan)
    for i in range(frames):
        pick = seen & np.isfinite(sums[i])
        drive[i, pick] = nnls(crossed[np.ix_(pick, pick)], sums[i, pick] / strength[pick])[0]
        if variance is not None:
            spread[i, pick] = variance[i, pick] / strength[pick] ** 2
    shown = tuple(_nearest(row, names, patterns, dark_below) for row in drive)
    step, events = align(shown, declared)
    wrong = np.array([f != d for f, d in zip(shown, declared, strict=True)])
    leaks = np.array(
        [
            _leak(sums[i] / strength, spread[i], crossed, seen, int(step[i]), declared, patterns)
            for i in range(frames)
        ]
    )
    before, after, error, rest = leaks.T
    return Synchronisation(shown, step, wrong, drive, before, after, error, rest, tuple(events))


def _neighbours(one_light: Array, strength: Array, seen: NDArray[np.bool_]) -> Array:
    """R (highlight, light), each row over its own highlight. Entries within the noise of all, which lights far from
    one another show, are 0: else every light would add its noise to every other."""
    crossed = one_light.T / np.where(seen, strength, np.nan)[:, None]
    away = ~np.eye(len(crossed), dtype=bool) & np.isfinite(crossed) & seen
    noise = 1.4826 * float(np.median(np.abs(crossed[away]))) if away.any() else 0.0
    return np.where(away & (np.abs(crossed) < 4 * noise), 0, crossed)


def _nearest(drive: Array, names: Sequence[str], patterns: Mapping[str, Array], dark_below: float) -> str:
    known = np.isfinite(drive)
    w = drive[known]
    best, name = 0.0, "O"
    for other in names:
        p = patterns[other][known]
        size = float(np.linalg.norm(p))
        if size == 0 or w @ p < dark_below * size**2:
            continue
        cosine = float(w @ p) / (size * float(np.linalg.norm(w)))
        if cosine > best:
            best, name = cosine, other
    return name


def _leak(
    highlights: Array,
    spread: Array,
    crossed: Array,
    seen: NDArray[np.bool_],
    step: int,
    declared: Sequence[str],
    patterns: Mapping[str, Array],
) -> tuple[float, float, float, float]:
    """Before, after, standard error, unexplained; percent. From the highlights themselves: the drive of single
    lights is never negative, so that its mean over dark lights is above zero."""
    nothing = (np.nan, np.nan, np.nan, np.nan)
    if step < 0 or not patterns[declared[step]].any():
        return nothing
    known = seen & np.isfinite(highlights)
    sides = [j for j in (step - 1, step + 1) if 0 <= j < len(declared) and patterns[declared[j]][known].any()]
    basis = np.stack([patterns[declared[j]][known] for j in (step, *sides)], axis=1)
    if np.linalg.matrix_rank(basis, tol=1e-6) < basis.shape[1]:
        return nothing
    design = crossed[np.ix_(known, known)] @ basis
    share, _ = nnls(design, highlights[known])
    total = float(share.sum())
    percent = {j: 100 * float(v) / total for j, v in zip(sides, share[1:], strict=True)}
    errors = np.sqrt(np.sum(np.linalg.pinv(design) ** 2 * spread[known], axis=1))
    rest = np.abs(highlights[known] - design @ share).sum() / (design @ share).sum()
    worst = 100 * float(errors[1:].max()) / total if sides else np.nan
    return percent.get(step - 1, np.nan), percent.get(step + 1, np.nan), worst, 100 * float(rest)


def align(shown: Sequence[str], declared: Sequence[str]) -> tuple[NDArray[np.int64], list[Event]]:
    """Step of each picture and what is out of order, by the cheapest edit of `declared` into `shown`."""
    n, m = len(shown), len(declared)
    cost = np.full((n + 1, m + 1), np.inf)
    back: dict[tuple[int, int], str] = {}
    cost[0, 0] = 0
    for i in range(n + 1):
        for j in range(m + 1):
            options = []
            if i and j:
                same = shown[i - 1] == declared[j - 1]
                options.append((cost[i - 1, j - 1] + (0 if same else _WRONG), "same" if same else "wrong"))
            if (
                i > 1
                and j > 1
                and tuple(shown[i - 2 : i]) == (declared[j - 1], declared[j - 2])
                and shown[i - 2] != shown[i - 1]
            ):
                options.append((cost[i - 2, j - 2] + _SWAP, "swap"))
            if i:
                options.append((cost[i - 1, j] + _GAP, "extra"))
            if j:
                options.append((cost[i, j - 1] + _GAP, "drop"))
            if options:
                cost[i, j], back[i, j] = min(options, key=lambda o: o[0])
    step = np.full(n, -1, np.int64)
    events: list[Event] = []
    odd: list[tuple[int, int]] = []
    i, j = n, m
    while i or j:
        move = back[i, j]
        if move == "swap":
            step[i - 2 : i] = j - 1, j - 2
            events.append(_swapped(i - 2, i - 1))
            i, j = i - 2, j - 2
        elif move == "extra":
            i -= 1
            # of two pictures alike, either may be the one too many: name the later
            later = i + 1 if i + 1 < n and shown[i + 1] == shown[i] else i
            if later and shown[later] == shown[later - 1]:
                step[i] = _AS_NEIGHBOUR
                events.append(Event("repeated", (later,), f"frame {later} ({shown[later]}) repeats the one before"))
            else:
                events.append(Event("extra", (i,), f"frame {i} ({shown[i]}) has no step"))
        elif move == "drop":
            j -= 1
            where = f"before frame {i}" if i < n else "at the end"
            events.append(Event("dropped", (i,), f"step {j} ({declared[j]}) is missing {where}"))
        else:
            i, j = i - 1, j - 1
            if move == "wrong":
                odd.append((i, j))
            else:
                step[i] = j
    for i in (k for k in range(n) if step[k] == _AS_NEIGHBOUR):
        step[i] = step[i + 1] if i + 1 < n and shown[i + 1] == shown[i] else step[i - 1]
    odd.reverse()
    while odd:
        i, j = odd.pop(0)
        partner = next((p for p in odd if shown[i] == declared[p[1]] and shown[p[0]] == declared[j]), None)
        if partner is None:
            events.append(Event("wrong", (i,), f"frame {i} shows {shown[i]} where {declared[j]} was meant"))
        else:
            odd.remove(partner)
            step[i], step[partner[0]] = partner[1], j
            events.append(_swapped(i, partner[0]))
    return step, sorted(events + _shifts(step, events), key=lambda e: e.frames)


def _swapped(i: int, j: int) -> Event:
    return Event("swapped", (i, j), f"frames {i} and {j} are swapped")


def _shifts(step: NDArray[np.int64], events: Sequence[Event]) -> list[Event]:
    """Runs of pictures that all show a step too late or too early."""
    swapped = {f for e in events if e.kind == "swapped" for f in e.frames}
    lag = {i: int(s) - i for i, s in enumerate(step) if s >= 0 and i not in swapped}
    out, run = [], list[int]()
    for i in [*lag, -1]:
        if run and (i < 0 or lag[i] != lag[run[0]]):
            by = lag[run[0]]
            if by:
                far = f"{abs(by)} step{'s' if abs(by) > 1 else ''} {'later' if by > 0 else 'earlier'}"
                says = f"frames {run[0]} to {run[-1]} are shifted: each shows the illumination {far}"
                out.append(Event("shifted", tuple(run), says))
            run = []
        if i >= 0:
            run.append(i)
    return out

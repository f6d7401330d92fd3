"""Capture sequences: which illumination comes when, and what each tracking frame can then be made from.

    static          C X Y Z Xc Yc Zc
    multispectral   the same under every filter of the wheel
    wilson          X Y Z C Xc Yc Zc C ...           4n + 3 images for n tracking frames (Wilson et al. 2010)
    minimal         X Z C Y Xc C Zc Yc C ...         3n + 2 (Dutta 2010)

The minimal sequence is not written down here but found from its three rules (Dutta 2010, "The New Image Capture
Sequence"):

1. the base pair, a gradient and its complement, stands farthest from the tracking frame;
2. exactly two gradients stand between two tracking frames;
3. a tracking frame is flanked by two gradients that are near enough in time for the subject to move linearly, so
   that half of the base pair's flow brings them to it: they belong to the two other axes.

So the window of a tracking frame is a p C q a' with p and q of the two axes that a does not have, and windows
overlap by one gap. A *pure* set has p and q both gradients or both complements, as the thesis has it; a *mixed* one
may take one of each, which its equations hold for as well.

Sources: Ma et al. 2007 (ratio), Wilson et al. 2010, ACM TOG 29(2) (difference, sequence), Dutta 2010.
"""

import re
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations, product
from typing import Literal, NamedTuple

from lightstage.hw.errors import RigError
from lightstage.hw.illuminations import AXES, EXPECTED, GRADIENTS, complement, is_complement, is_known

MOST_TRACKING, MOST_PICTURES = 5000, 20_000
"""Of a sequence: minutes at the fastest that cameras are."""
_START = ("X", "Z")
"""Any two gradients of different axes will do; these are the thesis'."""
Sets = Literal["pure", "mixed"]
_Gap = tuple[str, str]
"""The two gradients between two tracking frames."""


class Exposure(NamedTuple):
    """One picture of a multispectral set."""

    illumination: str
    band_nm: float


@dataclass(frozen=True)
class TrackingFrame:
    """What one constant picture of a sequence can be made into normals with."""

    frame: int
    """Its place in the sequence, from 0."""
    before: tuple[str, ...]
    """The pictures since the tracking frame before, in order."""
    after: tuple[str, ...]
    """The pictures up to the tracking frame after, in order."""
    sets: tuple[str, ...]
    """Names of SETS that its window holds."""
    missing: Mapping[str, tuple[str, ...]]
    """For every other set, the illuminations that the window lacks."""
    flanked: tuple[str, ...]
    """Axes whose pair stands with one picture on each side, which joint photometric alignment needs."""


def _minimal_sets() -> Iterator[tuple[str, tuple[str, ...]]]:
    for base in AXES:
        first, second = (axis for axis in AXES if axis != base)
        for p, q in product((first, complement(first)), (second, complement(second))):
            yield f"minimal {base}: {p} {q}", (base, complement(base), p, q)


SETS: Mapping[str, tuple[str, ...]] = {
    "difference": GRADIENTS,
    "ratio": ("X", "Y", "Z", "C"),
    **dict(_minimal_sets()),
}
"""Every set of pictures that normals can be made from; a minimal one is named by its base and the two others."""


def static() -> tuple[str, ...]:
    """Everything that a still subject needs, for every method."""
    return ("C", "X", "Y", "Z", "Xc", "Yc", "Zc")


def multispectral(bands_nm: Sequence[float]) -> tuple[Exposure, ...]:
    """The static set under each filter, in the order of the wheel.

    All seven pictures of a band are taken before the wheel turns. With b bands it turns b - 1 times, the least
    there can be because each filter must come once; lights switch in 23 ms, a motor wheel takes 650 (the thesis).
    It also keeps the seven pictures of a band next to each other in time: normals come from differences within a
    band and suffer at once when the subject moves, while bands can still be aligned to each other afterwards.

    Args:
        bands_nm: wavelengths in the order in which they sit in the wheel; 0 for no filter.

    Raises:
        RigError: there is no band, or one stands twice.
    """
    if not bands_nm:
        raise RigError("a multispectral set needs at least one band, such as 576")
    twice = sorted(band for band, count in Counter(bands_nm).items() if count > 1)
    if twice:
        raise RigError(f"the band {twice[0]:g} nm stands twice; name each filter once")
    return tuple(Exposure(name, band) for band in bands_nm for name in static())


def wilson(tracking: int) -> tuple[str, ...]:
    """X Y Z C Xc Yc Zc C X Y Z ...: 4n + 3 images for n tracking frames, each between three gradients and the
    complements of all three.

    Raises:
        RigError: there is no tracking frame.
    """
    _check_count(tracking)
    gaps = (GRADIENTS[:3], GRADIENTS[3:])
    return _joined([gaps[i % 2] for i in range(tracking + 1)])


def minimal(tracking: int, *, sets: Sets = "pure") -> tuple[str, ...]:
    """The sequence by the thesis' three rules: 3n + 2 images for n tracking frames.

    It repeats the shortest cycle of the rules. With pure sets each gap follows from the one before, and the cycle
    has 12 tracking frames; with mixed sets there is a choice, and the shortest has 3.

    Args:
        tracking: tracking frames, n.
        sets: pure keeps to the thesis' sets (all gradients or all complements beside the base); mixed may take one
            of each, which shortens the cycle.

    Raises:
        RigError: there is no tracking frame, or `sets` is neither.
    """
    _check_count(tracking)
    gaps = _shortest_cycle(sets)
    return _joined([gaps[i % len(gaps)] for i in range(tracking + 1)])


def cycle(kind: Literal["wilson", "minimal"], *, sets: Sets = "pure") -> tuple[str, ...]:
    """The part of a performance's sequence that repeats, from its first gap to the last tracking frame.

    Raises:
        RigError: `sets` is neither pure nor mixed.
    """
    if kind == "wilson":
        return wilson(2)[:8]
    gaps = _shortest_cycle(sets)
    return tuple(name for gap in gaps for name in (*gap, "C"))


def period(sequence: Sequence[str]) -> int:
    """The fewest pictures after which a sequence goes on as it began, two at least; else its length."""
    # the longest beginning that is also an end, for every beginning in turn (Knuth, Morris, Pratt 1977)
    borders = [0] * len(sequence)
    for i in range(1, len(sequence)):
        border = borders[i - 1]
        while border and sequence[border] != sequence[i]:
            border = borders[border - 1]
        borders[i] = border + (sequence[border] == sequence[i])
    step = len(sequence) - borders[-1] if sequence else 0
    return step if step < len(sequence) - 1 else len(sequence)


def parse(text: str) -> tuple[str, ...]:
    """The illuminations of `X Z C Y Xc C`; commas will do too.

    Raises:
        RigError: one is not known, or there is none.
    """
    names = tuple(re.findall(r"[^\s,]+", text))
    _check_names(names)
    return names


def supported(sequence: Sequence[str]) -> tuple[TrackingFrame, ...]:
    """For every tracking frame the sets of pictures that normals can be made from.

    The window of a tracking frame are the pictures between the tracking frame before it and the one after it, or
    the ends of the sequence. Illuminations other than C and the gradients are in the window but in no set.

    Returns:
        One record per C, in order; none when there is no C.

    Raises:
        RigError: an illumination is not known, or there is none.
    """
    _check_names(sequence)
    places = [i for i, name in enumerate(sequence) if name == "C"]
    records = []
    for left, place, right in zip([-1, *places], places, [*places[1:], len(sequence)], strict=False):
        before, after = tuple(sequence[left + 1 : place]), tuple(sequence[place + 1 : right])
        window = {*before, "C", *after}
        lacks = {
            name: tuple(picture for picture in images if picture not in window) for name, images in SETS.items()
        }
        flanked = tuple(
            axis
            for axis in AXES
            if (axis in before and complement(axis) in after) or (complement(axis) in before and axis in after)
        )
        records.append(
            TrackingFrame(
                frame=place,
                before=before,
                after=after,
                sets=tuple(name for name, images in lacks.items() if not images),
                missing={name: images for name, images in lacks.items() if images},
                flanked=flanked,
            )
        )
    return tuple(records)


def _joined(gaps: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Gaps with a tracking frame between each two."""
    out = list(gaps[0])
    for gap in gaps[1:]:
        out += ["C", *gap]
    return tuple(out)


def _shortest_cycle(sets: Sets) -> tuple[_Gap, ...]:
    """The shortest round of gaps from _START back to it, breadth first; pure windows are tried first."""
    if sets not in ("pure", "mixed"):
        raise RigError(f"the sets '{sets}' are not known; expected pure or mixed")
    waiting: deque[tuple[_Gap, ...]] = deque([(_START,)])
    seen = set()
    while waiting:
        path = waiting.popleft()
        for gap in _successors(path[-1], sets):
            if gap == _START:
                return path
            if gap not in seen:
                seen.add(gap)
                waiting.append((*path, gap))
    raise AssertionError("the rules lead back to every gap that they start from")


def _successors(gap: _Gap, sets: Sets) -> list[_Gap]:
    """Gaps that may follow the next tracking frame, those that make a pure set first."""
    allowed = [after for after in permutations(GRADIENTS, 2) if _by_the_rules(gap, after)]
    pure = [after for after in allowed if _same_kind(gap[1], after[0])]
    return pure if sets == "pure" else pure + [after for after in allowed if after not in pure]


def _by_the_rules(before: _Gap, after: _Gap) -> bool:
    """Rule 2 is in the type of a gap."""
    base_is_farthest = after[1] == complement(before[0])
    neighbours_are_the_other_axes = {before[0][0], before[1][0], after[0][0]} == set(AXES)
    return base_is_farthest and neighbours_are_the_other_axes


def _same_kind(a: str, b: str) -> bool:
    return is_complement(a) == is_complement(b)


def _check_count(tracking: int) -> None:
    if not 1 <= tracking <= MOST_TRACKING:
        raise RigError(f"{tracking} tracking frames: a performance has 1 to {MOST_TRACKING}")


def _check_names(sequence: Sequence[str]) -> None:
    if not sequence:
        raise RigError("the sequence is empty; expected illuminations such as X Z C Y Xc C")
    if len(sequence) > MOST_PICTURES:
        raise RigError(f"the sequence has {len(sequence)} pictures; {MOST_PICTURES} are the most")
    for i, name in enumerate(sequence):
        if not is_known(name):
            raise RigError(f"frame {i}: the illumination '{name}' is not known; expected {EXPECTED}")

"""The gradient methods as tables: which pictures each reads, and with which factors. Pure Python.

`spherical_gradients.py` has the equations and the loop that a table drives.
"""

from collections.abc import Sequence
from typing import NamedTuple

from lightstage.hw.illuminations import AXES, CONSTANT, GRADIENTS, complement

_SLOTS = tuple(name for axis in AXES for name in (axis, complement(axis)))
"""The loop's gradients in its order: x, x', y, y', z, z'."""


class Table(NamedTuple):
    """A method: which picture goes to which slot of the loop, and with which factors."""

    pictures: tuple[str, ...]
    """What the method reads, each once."""
    slots: tuple[int, ...]
    """Index into `pictures` for x, x', y, y', z, z', c, b, b'. A slot that is not used names any picture."""
    direction: tuple[tuple[float, float, float, float], ...]
    """(xyz, 4): factors of r_a, r_a', r_c and r_b + r_b' in g."""
    constant: tuple[float, float, float]
    """Factors of r_c, r_b + r_b' and the sum of all six gradients in the constant picture."""
    qp: bool
    """Whether the direction is corrected afterwards."""


def table(method: str, base: str, have: Sequence[str], *, qp: bool = False) -> Table:
    """The table of a method.

    Args:
        method: ratio, difference or minimal.
        base: the axis whose pair a minimal set is built on; ignored by the others.
        have: the illuminations at hand, at least those that the method needs. Only those that it uses are
            named in the result; C is used for r_c where it is there.
        qp: correct the direction, which needs all six gradients and C.
    """
    direction: list[tuple[float, float, float, float]] = []
    used: list[str] = [CONSTANT] if CONSTANT in have else []
    slots: dict[str, str] = {}
    for axis in AXES:
        opposite = complement(axis)
        if method == "difference" or (method == "minimal" and axis == base):
            direction.append((1, -1, 0, 0))
            names = (axis, opposite)
        elif method == "ratio":
            direction.append((2, 0, -1, 0))
            names = (axis, axis)
        else:
            direct = axis in have
            direction.append((2, 0, 0, -1) if direct else (0, -2, 0, 1))
            names = (axis, axis) if direct else (opposite, opposite)
        slots[axis], slots[opposite] = names
        used += [name for name in dict.fromkeys(names) if name not in used]
    constant: tuple[float, float, float]
    if CONSTANT in have:
        constant = (1, 0, 0)
    else:
        constant = (0, 0, 1 / 3) if method == "difference" else (0, 1, 0)
    pair = (base, complement(base)) if method == "minimal" else (used[0], used[0])
    if qp:
        slots = {name: name for name in GRADIENTS}
        used += [name for name in _SLOTS if name not in used]
    order = [slots[name] for name in _SLOTS] + [CONSTANT if CONSTANT in have else used[0], *pair]
    return Table(tuple(used), tuple(used.index(name) for name in order), tuple(direction), constant, qp)

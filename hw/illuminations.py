"""What illuminations are called, and which of them belong together. Facts: pure Python, for whoever reads names.

C           constant light, all lights full on
X Y Z       gradients: brighter the farther a light lies along the axis
Xc Yc Zc    their complements; a gradient and its complement add up to C
L<n>        one light, by its number: L00, L345
T<k>        the lights whose number leaves k when divided by 4: T0 to T3, which test synchronisation
O           all lights off
"""

import re
from collections.abc import Collection, Sequence

CONSTANT, DARK = "C", "O"
AXES = ("X", "Y", "Z")
GRADIENTS = ("X", "Y", "Z", "Xc", "Yc", "Zc")
TEST_PATTERNS = 4
EXPECTED = "C, X Y Z Xc Yc Zc, L.., T0..T3 or O"
"""The grammar in the words of an error."""
_KNOWN = re.compile(r"C|[XYZ]c?|L[0-9]{1,6}|T[0-3]|O")


def is_known(name: str) -> bool:
    """Whether an illumination can be called so."""
    return _KNOWN.fullmatch(name) is not None


def is_gradient(name: str) -> bool:
    """Whether it is a gradient or a complement."""
    return name in GRADIENTS


def is_complement(name: str) -> bool:
    """Whether it is the complement of a gradient."""
    return name in GRADIENTS and name.endswith("c")


def complement(gradient: str) -> str:
    """X -> Xc, Xc -> X."""
    return gradient[0] if gradient.endswith("c") else gradient + "c"


def axis_number(gradient: str) -> int:
    """0, 1, 2 for x, y, z, of a gradient or a complement."""
    return AXES.index(gradient[0])


def pairs(names: Collection[str]) -> list[tuple[str, str]]:
    """Every gradient that is there with its complement, axis by axis."""
    return [(axis, complement(axis)) for axis in AXES if axis in names and complement(axis) in names]


def is_light(name: str) -> bool:
    """Whether it is one light alone."""
    return name.startswith("L")


def light_number(name: str) -> int:
    """L07 -> 7."""
    return int(name[1:])


def light_name(number: int) -> str:
    """7 -> L07."""
    return f"L{number:02d}"


def is_test(name: str) -> bool:
    """Whether it is a pattern that tests synchronisation."""
    return name.startswith("T")


def test_number(name: str) -> int:
    """T2 -> 2: what is left of the numbers of its lights when they are divided by TEST_PATTERNS."""
    return int(name[1:])


def relative_exposures(exposure_s: Sequence[float]) -> list[float]:
    """Exposures in units of the one that most pictures have; of several that are as frequent, the longest."""
    usual = max(sorted(set(exposure_s), reverse=True), key=exposure_s.count)
    return [exposure / usual for exposure in exposure_s]

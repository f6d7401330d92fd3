"""The tables of the gradient methods, carried out by hand on ideal light: r_a = r_c (1/2 + n_a / 3)."""

from collections.abc import Sequence
from itertools import product

import numpy as np
import pytest

from lightstage.hw.illuminations import GRADIENTS
from lightstage.kernels.normals.gradient_methods import Table, table
from tests.scenes import STATIC

NORMAL = np.array([0.36, -0.48, 0.8])
R_C = 7.0
IDEAL = {
    "C": R_C,
    **{a: R_C * (0.5 + n / 3) for a, n in zip("XYZ", NORMAL, strict=True)},
    **{a + "c": R_C * (0.5 - n / 3) for a, n in zip("XYZ", NORMAL, strict=True)},
}
MINIMAL = [
    (base, (base, base + "c", *others))
    for base in "XYZ"
    for others in product(*((axis, axis + "c") for axis in "XYZ" if axis != base))
]
"""All twelve sets of Dutta (2010), pure and mixed."""


def carried_out(how: Table) -> tuple[np.ndarray, float]:
    """The direction and the constant picture that a table makes of ideal light."""
    x, xc, y, yc, z, zc, c, b, bc = (IDEAL[how.pictures[k]] for k in how.slots)
    pairs = ((x, xc), (y, yc), (z, zc))
    g = np.array([np.dot(f, (r, rc, c, b + bc)) for f, (r, rc) in zip(how.direction, pairs, strict=True)])
    return g, float(np.dot(how.constant, (c, b + bc, x + xc + y + yc + z + zc)))


@pytest.mark.parametrize(
    ("method", "base", "have"),
    [
        ("ratio", "", ("C", "X", "Y", "Z")),
        ("difference", "", STATIC),
        ("difference", "", GRADIENTS),
        *(("minimal", base, names) for base, names in MINIMAL),
        *(("minimal", base, ("C", *names)) for base, names in MINIMAL),
    ],
)
def test_ideal_light_gives_the_normal_and_the_albedo(method: str, base: str, have: Sequence[str]) -> None:
    how = table(method, base, have)
    direction, constant = carried_out(how)
    # r_a - r_a' and 2 r_a - r_c are both 2/3 r_c n_a
    np.testing.assert_allclose(direction, 2 / 3 * R_C * NORMAL)
    assert constant == pytest.approx(R_C)
    assert set(how.pictures) <= set(have)
    assert len(set(how.pictures)) == len(how.pictures)


def test_the_table_reads_only_what_it_uses() -> None:
    assert set(table("ratio", "", STATIC).pictures) == {"C", "X", "Y", "Z"}
    assert set(table("minimal", "Z", [*GRADIENTS]).pictures) == {"X", "Y", "Z", "Zc"}


def test_a_correction_reads_all_seven() -> None:
    how = table("ratio", "", STATIC, qp=True)
    assert set(how.pictures) == set(STATIC)
    assert [how.pictures[k] for k in how.slots[:7]] == ["X", "Xc", "Y", "Yc", "Z", "Zc", "C"]
    direction, _ = carried_out(how)
    np.testing.assert_allclose(direction, 2 / 3 * R_C * NORMAL)

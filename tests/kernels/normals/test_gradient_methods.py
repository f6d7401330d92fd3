"""The tables of the gradient methods."""

from lightstage.hw.illuminations import GRADIENTS
from lightstage.kernels.normals.gradient_methods import table
from tests.scenes import STATIC


def test_the_table_reads_only_what_it_uses() -> None:
    assert set(table("ratio", "", STATIC).pictures) == {"C", "X", "Y", "Z"}
    assert set(table("minimal", "Z", [*GRADIENTS]).pictures) == {"X", "Y", "Z", "Zc"}

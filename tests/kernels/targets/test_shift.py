"""The shift between two homographies, by hand and over all pixels."""

import numpy as np
import pytest

from lightstage.kernels.targets.shift import shift_px

UNIT = [[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]


def test_a_translation_is_its_length() -> None:
    moved = [[1.0, 0, 3], [0, 1, -4], [0, 0, 1]]
    assert shift_px(UNIT, moved, (20, 30)) == pytest.approx(5)


def test_a_shift_is_measured_over_the_whole_picture() -> None:
    """A scale of 1.001 about the corner moves far pixels more than near ones."""
    scaled = [[1.001, 0, 0], [0, 1.001, 0], [0, 0, 1]]
    y, x = np.mgrid[0:1236, 0:1624]
    # 9 x 7 points stand for all pixels
    assert shift_px(UNIT, scaled, (1236, 1624)) == pytest.approx(0.001 * np.hypot(x, y).mean(), rel=0.03)

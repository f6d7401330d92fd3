"""Counts as items hold them, and back."""

import numpy as np
import pytest

from lightstage.dag.stage import CalibrationPicture
from lightstage.kernels.targets.item_pictures import SCALE, counts_of, listed, mask_of, stored


def test_counts_come_back_to_half_a_step() -> None:
    counts = np.array([[0.0, 16.02], [1023.0, 3.999]])
    kept = {"picture": CalibrationPicture("", lambda: stored(counts)), "scale": SCALE}
    back = counts_of(kept)
    assert back is not None
    assert back.dtype == np.float64
    np.testing.assert_allclose(back, counts, atol=0.5 / SCALE)


def test_what_does_not_fit_ends_at_the_largest_value() -> None:
    np.testing.assert_array_equal(stored(np.array([[-3.0, 5000.0]])), [[0, 65535]])


def test_pixels_are_x_y() -> None:
    mask = np.zeros((3, 4), np.bool_)
    mask[2, 1] = mask[0, 3] = True
    assert listed(mask) == [[3, 0], [1, 2]]


@pytest.mark.parametrize("nothing", [counts_of, mask_of])
def test_without_an_item_there_is_nothing(nothing: object) -> None:
    assert nothing(None) is None  # type: ignore[operator]

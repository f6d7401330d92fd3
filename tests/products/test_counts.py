"""Counts by hand."""

import numpy as np

from lightstage.products.counts import counts_8, counts_16, shown_8, shown_16, srgb_8, srgb_16


def test_black_white_and_beyond() -> None:
    unit = np.array([-1, 0, 0.5, 1, 2, np.nan, np.inf])
    assert counts_8(unit).tolist() == [0, 0, 128, 255, 255, 0, 255]
    assert counts_16(unit).tolist() == [0, 0, 32768, 65535, 65535, 0, 65535]
    assert shown_8(unit).tolist() == [0, 0, 128, 255, 255, 0, 255]
    assert shown_16(unit).tolist() == [0, 0, 32768, 65535, 65535, 0, 65535]


def test_halves_go_up_in_counts_and_to_even_in_what_is_shown() -> None:
    halves = np.array([0.5, 1.5, 2.5]) / 255
    assert counts_8(halves).tolist() == [1, 2, 3]
    assert shown_8(halves).tolist() == [0, 2, 2]


def test_srgb() -> None:
    """The code of linear 0.5 is 0.735357 (IEC 61966-2-1)."""
    linear = np.array([0, 0.5, 1])
    assert srgb_8(linear).tolist() == [0, 188, 255]
    assert srgb_16(linear).tolist() == [0, round(0.735357 * 65535), 65535]

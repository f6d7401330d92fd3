"""What is not known takes its nearest neighbour's value."""

import numpy as np
import pytest

from lightstage.kernels.pictures.nearest_fill import nearest_fill


def test_by_hand() -> None:
    nan = np.nan
    picture = np.array([[1.0, nan, nan, 4.0], [nan, nan, nan, nan]])
    before = picture.copy()
    np.testing.assert_array_equal(nearest_fill(picture, np.isfinite(picture)), [[1, 1, 4, 4]] * 2)
    np.testing.assert_array_equal(picture, before)


def test_all_channels_come_from_one_pixel() -> None:
    picture = np.random.default_rng(0).normal(size=(3, 8, 9))
    known = np.zeros((8, 9), bool)
    known[2, 3] = known[6, 7] = True
    filled = nearest_fill(picture, known)
    assert {tuple(pixel) for pixel in filled.reshape(3, -1).T} == {tuple(picture[:, 2, 3]), tuple(picture[:, 6, 7])}
    np.testing.assert_array_equal(filled[:, 2, 3], picture[:, 2, 3])


def test_every_pixel_has_the_value_of_a_nearest_one() -> None:
    rng = np.random.default_rng(1)
    known = rng.random((12, 15)) < 0.1
    label = np.arange(known.size).reshape(known.shape)
    at = np.argwhere(known)
    filled = nearest_fill(label, known)
    for (y, x), value in np.ndenumerate(filled):
        distance = np.hypot(*(at - (y, x)).T)
        assert np.hypot(value // 15 - y, value % 15 - x) == pytest.approx(distance.min())


def test_nothing_to_fill_and_nothing_to_fill_from() -> None:
    picture = np.arange(6.0).reshape(2, 3)
    np.testing.assert_array_equal(nearest_fill(picture, np.ones((2, 3), bool)), picture)
    with pytest.raises(ValueError, match="no pixel is known"):
        nearest_fill(picture, np.zeros((2, 3), bool))

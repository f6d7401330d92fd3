"""Boards found in drawn pictures, their order, their colour, and what is said of others."""

import numpy as np
import pytest

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.board_corners import find_corners, undo_mount, undo_mount_points
from tests.kernels.targets.drawn_board import board, tilted

INNER = (6, 4)
SHAPE = (150, 180)


@pytest.mark.parametrize("first_black", [True, False])
def test_a_drawn_board(first_black: bool) -> None:
    picture, true = board(tilted(), INNER, SHAPE, first_black=first_black)
    picture.flags.writeable = False
    found = find_corners(picture, inner_corners=INNER)
    assert found.points.shape == (4, 6, 2)
    assert np.abs(found.points - true).max() < 0.02
    assert found.first_is_black == first_black
    np.testing.assert_allclose(found.blur_px, 0.7, rtol=0.15)


def test_the_sides_may_be_named_either_way_round() -> None:
    picture, true = board(tilted(), INNER, SHAPE)
    found = find_corners(picture, inner_corners=(4, 6))
    assert found.points.shape[:2] == (6, 4)
    # the same corners, and x then y turn as in the picture
    order = np.lexsort(found.points.reshape(-1, 2).T.round(1))
    expected = np.lexsort(true.reshape(-1, 2).T.round(1))
    np.testing.assert_allclose(found.points.reshape(-1, 2)[order], true.reshape(-1, 2)[expected], atol=0.02)
    along, down = found.points[0, 1] - found.points[0, 0], found.points[1, 0] - found.points[0, 0]
    assert along[0] * down[1] - along[1] * down[0] > 0


@pytest.mark.parametrize("rotate", [0, 90, 180, 270])
@pytest.mark.parametrize("mirror", [False, True])
def test_points_go_where_their_pixels_go(rotate: int, mirror: bool) -> None:
    picture = np.zeros((5, 7))
    picture[1, 4] = 1
    undone = undo_mount(picture, rotate=rotate, mirror=mirror)
    (y,), (x,) = np.nonzero(undone)
    found = undo_mount_points(np.array([4.0, 1.0]), (5, 7), rotate=rotate, mirror=mirror)
    np.testing.assert_array_equal(found, [x, y])


def test_refusals() -> None:
    picture, _ = board(tilted(), INNER, SHAPE)
    with pytest.raises(KernelError, match="3 x 3 are the least"):
        find_corners(picture, inner_corners=(2, 9))
    noise = np.random.default_rng(0).normal(100, 5, SHAPE)
    with pytest.raises(KernelError, match=r"CAM1: no checkerboard was found \(one with 6 x 4 inner corners"):
        find_corners(noise, inner_corners=INNER, camera="CAM1")
    with pytest.raises(KernelError, match="shows 6 x 4 inner corners where 5 x 4 are declared"):
        find_corners(picture, inner_corners=(5, 4))
    with pytest.raises(KernelError, match="white squares saturate"):
        find_corners(picture, inner_corners=INNER, white_level=780)

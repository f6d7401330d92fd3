"""Mounts: boards whose corners the test turns and mirrors itself."""

import numpy as np
import pytest
from numpy.typing import NDArray

from lightstage.kernels.targets.board_corners import Corners
from lightstage.kernels.targets.mount_check import check_mount, pair_corners

Array = NDArray[np.float64]
SHAPE = (300, 400)


def lattice(columns: int, rows: int, at: tuple[float, float] = (90.0, 60.0)) -> Array:
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    return np.asarray(np.array(at) + 20.0 * np.stack([x, y], axis=-1))


def corners(points: Array, first_is_black: bool = True) -> Corners:
    rows, columns = points.shape[:2]
    return Corners(
        points, np.broadcast_to(np.eye(2), (rows, columns, 2, 2)), np.ones((rows, columns)), first_is_black
    )


def seen_mirrored(points: Array, width: int) -> Array:
    """What a camera sees of them whose picture is mirrored, in an order that runs to the right again."""
    return np.asarray((np.array([width - 1, 0]) + np.array([-1, 1]) * points)[:, ::-1])


def test_the_right_mount_is_right() -> None:
    points = lattice(5, 3)
    found = check_mount(
        [corners(points + np.array([2.0, 1.0]))], [corners(points)], shape=SHAPE, rotate=0, mirror=False
    )
    assert found.right
    assert found.distance_px == pytest.approx(np.hypot(2, 1))
    assert found.determinant == pytest.approx(1)
    assert "the mount of CAM0 is right: its corners lie 2.2 px" in found.sentence


def test_a_forgotten_mirror_is_told_by_the_colours() -> None:
    # both numbers odd: mirroring swaps the colours of no square, but their order runs the other way
    points = lattice(5, 3)
    first = corners(seen_mirrored(points, SHAPE[1]), first_is_black=False)
    found = check_mount([first], [corners(points)], shape=SHAPE, rotate=0, mirror=False, camera="LEFT")
    assert not found.right
    assert (found.rotate, found.mirror) == (0, True)
    assert found.distance_px == pytest.approx(0)
    assert "the mount of LEFT is wrong" in found.sentence
    assert "with rotate: 0, mirror: true 0.0 px" in found.sentence


def test_half_a_turn_is_told_by_where_the_board_is() -> None:
    points = lattice(5, 3)
    turned = (np.array(SHAPE[::-1]) - 1 - points)[::-1, ::-1]
    found = check_mount([corners(turned)], [corners(points)], shape=SHAPE, rotate=90, mirror=False)
    assert not found.right
    assert (found.rotate, found.mirror) == (270, False)


def test_pairs_come_in_one_order() -> None:
    points = lattice(5, 4)
    shuffled = corners((points + np.array([1.0, 0.0]))[::-1, ::-1])
    first, second, _, _, board = pair_corners([shuffled, corners(points)], [corners(points), corners(points)])
    np.testing.assert_allclose(first[:20] - second[:20], np.broadcast_to([1.0, 0.0], (20, 2)))
    np.testing.assert_allclose(first[20:], second[20:])
    np.testing.assert_array_equal(board, np.repeat([0, 1], 20))

"""Balls drawn with soft edges, found where they were drawn."""

import numpy as np
import pytest
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.ball_outline import find_outline

Array = NDArray[np.float64]


def drawn(*balls: tuple[float, float, float], shape: tuple[int, int] = (180, 220), seed: int | None = 0) -> Array:
    """Counts: discs (x, y, radius) that are brighter than the room, with highlights inside and shot noise."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    picture = np.full(shape, 40.0)
    for cx, cy, r in balls:
        away = np.hypot(x - cx, y - cy)
        picture += 60 / (1 + np.exp((away - r) / 0.4))
        for angle in (0.3, 2.0, 4.1):
            sx, sy = cx + 0.6 * r * np.cos(angle), cy + 0.6 * r * np.sin(angle)
            picture += 700 * np.exp(-((x - sx) ** 2 + (y - sy) ** 2) / 3)
    if seed is None:
        return picture
    return np.asarray(np.random.default_rng(seed).poisson(picture * 10) / 10)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("ball", [(110.0, 90.0, 60.0), (81.3, 97.6, 41.7)])
def test_a_drawn_ball(ball: tuple[float, float, float], seed: int) -> None:
    picture = drawn(ball, seed=seed)
    picture.flags.writeable = False
    found = find_outline(picture)
    np.testing.assert_allclose(found.centre_px, ball[:2], atol=0.1)
    assert found.radius_px == pytest.approx(ball[2], abs=0.15)
    assert found.seen > 0.8


def test_more_light_changes_nothing_much_and_a_moved_picture_moves_it() -> None:
    picture = drawn((100.0, 90.0, 50.0))
    plain, bright = find_outline(picture), find_outline(7 * picture)
    np.testing.assert_allclose(bright.centre_px, plain.centre_px, atol=1e-3)
    moved = find_outline(np.roll(picture, (4, 6), axis=(0, 1)))
    np.testing.assert_allclose(moved.centre_px - plain.centre_px, [6, 4], atol=0.05)


def test_a_mask_says_which_ball_and_the_picture_says_where() -> None:
    picture = drawn((60.0, 90.0, 40.0), (165.0, 90.0, 40.0))
    y, x = np.mgrid[:180, :220]
    mask = np.hypot(x - 61, y - 90.5) < 40
    found = find_outline(picture, mask=mask)
    np.testing.assert_allclose(found.centre_px, [60, 90], atol=0.1)
    # where the picture shows nothing, the mask's edge counts
    dark = find_outline(np.zeros((180, 220)), mask=mask)
    np.testing.assert_allclose(dark.centre_px, [61, 90.5], atol=0.1)


def test_refusals() -> None:
    with pytest.raises(KernelError, match="the picture is empty; give a mask or points"):
        find_outline(np.zeros((100, 120)))
    with pytest.raises(KernelError, match="no ball found"):
        find_outline(np.random.default_rng(0).normal(100, 5, (100, 120)))
    with pytest.raises(KernelError, match="is cut by the frame"):
        find_outline(drawn((200.0, 90.0, 60.0)))
    with pytest.raises(KernelError, match="two balls: one at"):
        find_outline(drawn((60.0, 90.0, 40.0), (165.0, 90.0, 40.0)))
    with pytest.raises(KernelError, match="the mask is empty"):
        find_outline(drawn((100.0, 90.0, 50.0)), mask=np.zeros((180, 220), bool))
    two = np.zeros((180, 220), bool)
    two[20:60, 20:60] = two[100:140, 100:140] = True
    with pytest.raises(KernelError, match="two balls: the mask has several regions"):
        find_outline(drawn((100.0, 90.0, 50.0)), mask=two)

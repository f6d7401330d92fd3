"""Reference flows: known motion of pictures that are formulas, light that changes, holes, and residuals."""

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from lightstage.kernels.motion.picture_flow import Method, alternating, direct, plain, rounds, warped

Array = NDArray[Any]
METHODS: tuple[Method, ...] = ("dis", "tvl1", "farneback")
SHAPE = (72, 96)
SHIFT = (1.6, -0.7)
"""x and y, pixels."""
INNER = (slice(10, -10), slice(10, -10))


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    cv2.setNumThreads(1)


def texture(dx: float = 0.0, dy: float = 0.0) -> Array:
    """Waves of 7 to 20 px, 0.4 to 1.6: a formula, so that a shift by a part of a pixel is exact."""
    y, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(float)
    x, y = x - dx, y - dy
    waves = (
        np.sin(0.9 * x + 0.2 * y)
        + np.cos(0.8 * y - 0.3 * x)
        + np.sin(0.4 * x + 0.5 * y)
        + np.cos(0.33 * x - 0.6 * y)
    )
    return (1 + 0.15 * waves).astype(np.float32)


def light(dx: float = 0.0, dy: float = 0.0) -> Array:
    """The share of the light that the gradient holds, 0.3 to 0.7 across the picture; it moves with the surface."""
    y, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(float)
    return (0.5 + 0.2 * np.sin(0.03 * (x - dx) + 0.02 * (y - dy))).astype(np.float32)


def moved_pair() -> tuple[Array, Array, Array]:
    """c, r moved by SHIFT, r' moved by -SHIFT."""
    dx, dy = SHIFT
    return texture(), texture(dx, dy) * light(dx, dy), texture(-dx, -dy) * (1 - light(-dx, -dy))


def error(flow: Array, dx: float, dy: float) -> float:
    """Mean endpoint error away from the border, pixels."""
    return float(np.hypot(flow[0] - dx, flow[1] - dy)[INNER].mean())


def test_warped_by_hand() -> None:
    """A whole pixel to the right takes the right neighbour; the last column lies outside."""
    picture = np.array([[1, 2, 3], [4, 5, 6], [7, 8, 9]], np.float32)
    flow = np.zeros((2, 3, 3), np.float32)
    flow[0] = 1
    np.testing.assert_array_equal(warped(picture, flow)[:, 0], [2, 5, 8])
    assert np.isnan(warped(picture, flow)[:, 2]).all()


def test_warped_takes_x_first() -> None:
    flow = np.stack([np.full(SHAPE, SHIFT[0], np.float32), np.full(SHAPE, SHIFT[1], np.float32)])
    # positions are rounded to 1/32 px, and slopes are 0.4 per px at most
    np.testing.assert_allclose(warped(texture(*SHIFT), flow)[INNER], texture()[INNER], atol=0.03)


@pytest.mark.parametrize("flow", METHODS)
def test_known_shift_of_equal_light(flow: Method) -> None:
    """A fifth of the shift's length at most; the picture's own errors are far smaller."""
    assert error(plain(texture(), texture(*SHIFT), flow=flow), *SHIFT) < 0.2


@pytest.mark.parametrize("flow", METHODS)
def test_known_shifts_of_a_pair(flow: Method) -> None:
    """Both flows are nearer to the truth than half of their length, whichever engine."""
    found = alternating(*moved_pair(), flow=flow, iterations=4)
    length = float(np.hypot(*SHIFT))
    assert error(found.u, *SHIFT) < length / 2
    assert error(found.v, -SHIFT[0], -SHIFT[1]) < length / 2


def test_direct_finds_the_shift_under_another_light() -> None:
    dx, dy = SHIFT
    picture = 40 * texture(dx, dy) * light(dx, dy)
    assert error(direct(texture(), picture), dx, dy) < 0.1


@pytest.mark.parametrize("flow", METHODS)
def test_no_motion(flow: Method) -> None:
    """The first flow sees equal pictures but for rounding; TV-L1 strays from that at the border only."""
    c, part = texture(), light()
    found = alternating(c, c * part, c * (1 - part), flow=flow, iterations=2)
    assert error(found.u, 0, 0) < 0.02
    assert error(found.v, 0, 0) < 0.02
    # the pair adds up to c but for rounding, before anything is done
    assert found.residuals[0] < 1e-6


def test_no_motion_directly() -> None:
    assert np.hypot(*direct(texture(), 0.3 * texture())).max() < 0.05


@pytest.mark.parametrize("flow", METHODS)
def test_residuals(flow: Method) -> None:
    """One more than iterations; the first is the plain gap; they fall."""
    c, r, rc = moved_pair()
    residuals = alternating(c, r, rc, flow=flow, iterations=3).residuals
    assert len(residuals) == 4
    assert residuals[0] == pytest.approx(np.abs(c - r - rc).mean(), rel=1e-5)
    assert residuals[-1] < 0.6 * residuals[0]


def test_rounds_are_the_iterations() -> None:
    steps = rounds(*moved_pair(), flow="dis")
    some = [next(steps) for _ in range(3)]
    found = alternating(*moved_pair(), flow="dis", iterations=2)
    np.testing.assert_array_equal(some[-1].u, found.u)
    assert tuple(one.residual for one in some) == found.residuals
    assert not some[0].u.any()


@pytest.mark.parametrize("flow", METHODS)
def test_scale_of_the_pictures_changes_nothing(flow: Method) -> None:
    """A power of two, so that the division by the brightest level is exact."""
    pictures = moved_pair()
    one = alternating(*pictures, flow=flow, iterations=1)
    other = alternating(*(p * np.float32(1024) for p in pictures), flow=flow, iterations=1)
    np.testing.assert_array_equal(one.u, other.u)
    assert other.residuals[-1] == pytest.approx(1024 * one.residuals[-1], rel=1e-5)


@pytest.mark.parametrize("flow", METHODS)
def test_a_hole_does_not_spoil_its_surroundings(flow: Method) -> None:
    c, r, rc = moved_pair()
    whole = alternating(c, r, rc, flow=flow, iterations=2)
    c, r = c.copy(), r.copy()
    c[30:34, 40:44] = np.nan
    r[:, :3] = np.nan
    found = alternating(c, r, rc, flow=flow, iterations=2)
    assert np.isfinite(found.u).all()
    assert np.isfinite(found.v).all()
    assert np.isfinite(found.residuals).all()
    assert error(found.u, *SHIFT) < error(whole.u, *SHIFT) + 0.1
    assert error(direct(c, r), *SHIFT) < 0.2


@pytest.mark.parametrize("flow", METHODS)
def test_pictures_without_texture_do_not_move(flow: Method) -> None:
    flat = np.full(SHAPE, 3.0, np.float32)
    found = alternating(flat, flat / 2, flat / 2, flow=flow, iterations=1)
    np.testing.assert_allclose(found.u, 0, atol=1e-3)
    np.testing.assert_allclose(direct(flat, flat / 2), 0, atol=1e-3)


@pytest.mark.parametrize("flow", METHODS)
def test_pictures_without_light_do_not_move(flow: Method) -> None:
    dark = np.zeros(SHAPE, np.float32)
    found = alternating(dark, dark, dark, flow=flow, iterations=1)
    np.testing.assert_array_equal(found.u, 0)
    assert found.residuals == (0, 0)
    np.testing.assert_array_equal(direct(dark, dark), 0)


@pytest.mark.parametrize("flow", METHODS)
def test_inputs_stay_as_they_are(flow: Method) -> None:
    pictures = moved_pair()
    pictures[0][5, 5] = np.nan
    before = [p.copy() for p in pictures]
    for picture in pictures:
        picture.flags.writeable = False
    alternating(*pictures, flow=flow, iterations=1)
    direct(pictures[0], pictures[1])
    for picture, kept in zip(pictures, before, strict=True):
        np.testing.assert_array_equal(picture, kept)


def test_errors() -> None:
    c, r, rc = moved_pair()
    with pytest.raises(ValueError, match=r"complement is \(72, 95\), constant is \(72, 96\)"):
        alternating(c, r, rc[:, 1:], flow="dis", iterations=1)
    with pytest.raises(ValueError, match="gradient has no finite pixel"):
        alternating(c, np.full_like(r, np.nan), rc, flow="dis", iterations=1)
    with pytest.raises(ValueError, match="iterations is -1"):
        alternating(c, r, rc, flow="dis", iterations=-1)
    with pytest.raises(ValueError, match="sigma_px is 0"):
        direct(c, r, sigma_px=0)

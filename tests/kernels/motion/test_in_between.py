"""Normals between tracking frames: weights by hand, an analytic moving and turning surface, hidden points."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lightstage.kernels.motion.in_between import Side, blend, carry, nearness
from tests.scenes import angle_deg

Array = NDArray[Any]
SHAPE = (48, 60)
Y, X = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(float)
NAN = np.float32(np.nan)


def tilted(degrees: float, confidence: float = 1.0) -> Side:
    """One pixel whose normal is tilted from z towards x."""
    angle = np.radians(degrees)
    normal = np.array([np.sin(angle), 0, np.cos(angle)], np.float32).reshape(3, 1, 1)
    return Side(normal, np.full((1, 1), confidence, np.float32))


def nothing() -> Side:
    return Side(np.full((3, 1, 1), NAN), np.zeros((1, 1), np.float32))


def tilt(side: Side) -> float:
    return float(np.degrees(np.arctan2(side.normal[0, 0, 0], side.normal[2, 0, 0])))


def test_weights_by_hand() -> None:
    """Frame 5 between 3 and 6: two frames from one and one from the other."""
    np.testing.assert_allclose(nearness(5, [3, 6]), [1 / 3, 2 / 3])
    np.testing.assert_allclose(nearness(5, [4, 8]), [3 / 4, 1 / 4])
    np.testing.assert_array_equal(nearness(3, [3, 6]), [1, 0])
    np.testing.assert_array_equal(nearness(0, [2]), [1])


@pytest.mark.parametrize("tracking", [[], [3, 3], [1, 2, 3]])
def test_frames_that_do_not_flank_are_refused(tracking: list[float]) -> None:
    with pytest.raises(ValueError, match="one or two different ones must flank a frame"):
        nearness(5, tracking)


def test_the_mean_lies_between_by_hand() -> None:
    """Equal weights: halfway. For small angles a third of the weight is a third of the way."""
    assert tilt(blend([tilted(10), tilted(30)], [0.5, 0.5])) == pytest.approx(20, abs=1e-4)
    assert tilt(blend([tilted(0), tilted(3)], nearness(4, [3, 6]))) == pytest.approx(1, abs=1e-3)
    out = blend([tilted(10), tilted(30)], [0.5, 0.5])
    assert np.linalg.norm(out.normal) == pytest.approx(1, abs=1e-6)


def test_confidence_counts_as_weight_does() -> None:
    doubted = blend([tilted(0, 0.25), tilted(4, 0.75)], [0.5, 0.5])
    assert tilt(doubted) == pytest.approx(3, abs=1e-2)
    assert doubted.confidence[0, 0] == pytest.approx(0.5)


def test_a_hidden_side_is_filled_from_the_other() -> None:
    for sides in ([nothing(), tilted(7)], [tilted(7), nothing()]):
        for weights in ([0.5, 0.5], [1.0, 0.0], [0.0, 1.0]):
            assert tilt(blend(sides, weights)) == pytest.approx(7, abs=1e-4)
    both = blend([nothing(), nothing()], [0.5, 0.5])
    assert np.isnan(both.normal).all()
    assert both.confidence[0, 0] == 0


def test_opposite_normals_have_no_mean() -> None:
    ahead = tilted(0)
    out = blend([ahead, Side(-ahead.normal, ahead.confidence)], [0.5, 0.5])
    assert np.isnan(out.normal).all()
    assert out.confidence[0, 0] == 0


def test_each_side_needs_its_weight() -> None:
    with pytest.raises(ValueError, match="2 sides and 1 weights"):
        blend([tilted(0), tilted(1)], [1.0])


def surface(time: float, x: Array, y: Array) -> Array:
    """Normals of a rippled sheet that slides by (3, 1) pixels and turns by 2 degrees about y in a unit of time."""
    u, v = x - 3 * time, y - 1 * time
    slope = np.stack([-0.3 * np.cos(u / 6), -0.3 * np.sin(v / 7), np.ones_like(u)])
    slope /= np.linalg.norm(slope, axis=0)
    a = np.radians(2 * time)
    turn = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    return np.asarray(np.einsum("ij,jyx->iyx", turn, slope))


def side_at(time: float, tracking: float) -> Side:
    flow = np.stack(np.broadcast_arrays(3 * (time - tracking), 1 * (time - tracking), X)[:2]).astype(np.float32)
    return carry(surface(tracking, X, Y).astype(np.float32), flow)


def test_two_sides_follow_motion_and_turn() -> None:
    """Time 1 between 0 and 3. One side alone lacks its own turn; nearness restores it, other weights do not."""
    sides = [side_at(1, 0), side_at(1, 3)]
    truth = surface(1, X, Y)

    def error(weights: Any) -> float:
        return float(angle_deg(blend(sides, weights).normal, truth)[6:-6, 10:-10].max())

    # Keys' convolution of ripples of 38 pixels is good to 1e-4; so is the chord of 6 degrees
    assert error(nearness(1, [0, 3])) < 0.02
    # a third of 6 degrees too far, seen at normals up to 23 degrees from the axis's normal plane
    assert error(nearness(1, [0, 3])[::-1]) > 1.8


def test_the_end_has_one_side() -> None:
    """Only the turn of 2 degrees that a warp does not know is left."""
    out = blend([side_at(-1, 0)], nearness(-1, [0]))
    assert angle_deg(out.normal, surface(-1, X, Y))[6:-6, 10:-10].max() < 2.01


def test_confidence_travels_and_zero_is_unknown() -> None:
    flow = np.stack(np.broadcast_arrays(4.0, 0.0, X)[:2]).astype(np.float32)
    confidence = np.full(SHAPE, 0.5, np.float32)
    confidence[:, 30:] = 0
    side = carry(surface(0, X, Y).astype(np.float32), flow, confidence)
    np.testing.assert_allclose(side.confidence[:, 4:34], 0.5)
    assert (side.confidence[:, 35:] == 0).all()
    np.testing.assert_array_equal(np.isnan(side.normal[0]), side.confidence == 0)


def test_inputs_are_not_written() -> None:
    normal = surface(0, X, Y).astype(np.float32)
    normal[:, 3, 3] = np.nan
    flow = np.zeros((2, *SHAPE), np.float32)
    copies = normal.copy(), flow.copy()
    normal.setflags(write=False)
    flow.setflags(write=False)
    blend([carry(normal, flow)] * 2, [0.5, 0.5])
    np.testing.assert_array_equal(normal, copies[0])
    np.testing.assert_array_equal(flow, copies[1])

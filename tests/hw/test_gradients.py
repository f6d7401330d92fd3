"""What lights are driven with: levels worked out by hand, and pairs that add up wherever a light is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.hw.errors import RigError
from lightstage.hw.gradients import FULL, levels, weights

# the six ends of the axes, and one at 3-4-5
AXES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [0.6, 0, 0.8]], float)


def anywhere(seed: int, count: int) -> np.ndarray:
    points = np.random.default_rng(seed).standard_normal((count, 3))
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))


def test_by_hand() -> None:
    # (p + 1) / 2 x 4095: 1 -> 4095, -1 -> 0, 0 -> 2047.5, which goes up; 0.6 -> 3276; 0.8 -> 3685.5, which goes up
    assert levels("X", AXES).tolist() == [4095, 0, 2048, 2048, 2048, 2048, 3276]
    assert levels("Z", AXES).tolist() == [2048, 2048, 2048, 2048, 4095, 0, 3686]
    assert levels("Xc", AXES).tolist() == [0, 4095, 2047, 2047, 2047, 2047, 819]
    np.testing.assert_allclose(weights("X", AXES)[[0, 1, 6]], [1, 0, 0.8])


@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.sampled_from("XYZ"))
def test_a_pair_adds_up_exactly(seed: int, count: int, axis: str) -> None:
    positions = anywhere(seed, count)
    assert (levels(axis, positions) + levels(axis + "c", positions) == FULL).all()
    share = (positions[:, "XYZ".index(axis)] + 1) / 2
    assert np.abs(weights(axis, positions) - share).max() <= 0.5001 / FULL


def test_the_other_illuminations() -> None:
    positions = anywhere(0, 41)
    assert (levels("C", positions) == FULL).all()
    assert (levels("O", positions) == 0).all()
    assert np.flatnonzero(levels("L07", positions)).tolist() == [7]
    assert np.flatnonzero(levels("T2", positions)).tolist() == list(range(2, 41, 4))
    assert sum(levels(f"T{k}", positions) for k in range(4)).tolist() == [FULL] * 41


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("L41", "L41: this rig has lights L00 to L40"),
        ("W", "the illumination 'W' is not known; expected C, X Y Z"),
        ("Xx", "the illumination 'Xx' is not known"),
    ],
)
def test_what_is_not_there_is_named(name: str, sentence: str) -> None:
    with pytest.raises(RigError, match=sentence):
        levels(name, anywhere(0, 41))

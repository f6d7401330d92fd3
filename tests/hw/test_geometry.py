"""The geodesic sphere and what its lights are driven with."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.hw.errors import RigError
from lightstage.hw.geodesic import light_positions
from lightstage.hw.gradients import FULL, levels, weights


@pytest.mark.parametrize(("frequency", "count"), [(1, 12), (2, 42), (3, 92), (4, 162)])
def test_counts_are_ten_f_squared_plus_two(frequency: int, count: int) -> None:
    positions = light_positions(frequency, left_out=())
    assert positions.shape == (count, 3)
    np.testing.assert_allclose(np.linalg.norm(positions, axis=1), 1)
    np.testing.assert_allclose(positions.mean(axis=0), 0, atol=1e-9)
    np.testing.assert_allclose(positions[0], [0, 1, 0], atol=1e-9)


def test_the_thesis_rig_lacks_the_lowest_light() -> None:
    positions = light_positions()
    assert len(positions) == 41
    assert positions[:, 1].min() > -0.9
    # by falling height, then by azimuth from the camera towards +x (icosahedron: sqrt(1 - 0.85065^2) = 0.52573)
    np.testing.assert_allclose(positions[1], [0, 0.85065081, 0.52573111], atol=1e-7)
    assert positions[2][0] > 0
    heights = np.round(positions[:, 1], 6)
    assert (np.diff(heights) <= 0).all()


def test_any_light_can_be_left_out_and_no_other() -> None:
    assert len(light_positions(2, left_out=[0, 41])) == 40
    with pytest.raises(RigError, match="lights 0 to 41"):
        light_positions(2, left_out=[42])
    with pytest.raises(RigError, match="does not exist"):
        light_positions(0)


@given(st.integers(1, 4), st.sampled_from("XYZ"))
def test_a_pair_adds_up_exactly(frequency: int, axis: str) -> None:
    positions = light_positions(frequency)
    assert (levels(axis, positions) + levels(axis + "c", positions) == FULL).all()
    expected = (positions[:, "XYZ".index(axis)] + 1) / 2
    assert np.abs(weights(axis, positions) - expected).max() <= 0.5001 / FULL


def test_the_other_illuminations() -> None:
    positions = light_positions()
    assert (levels("C", positions) == FULL).all()
    assert (levels("O", positions) == 0).all()
    assert np.flatnonzero(levels("L07", positions)).tolist() == [7]
    assert np.flatnonzero(levels("T2", positions)).tolist() == list(range(2, 41, 4))
    assert sum(levels(f"T{k}", positions) for k in range(4)).tolist() == [FULL] * 41
    for wrong in ("L41", "W", "Xx"):
        with pytest.raises(RigError):
            levels(wrong, positions)

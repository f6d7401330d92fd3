"""Counts to radiance: means by hand, and how much of a number is kept."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.kernels.encodings import RADIANCE_BITS
from lightstage.kernels.pictures.radiance import stack

NAN = np.nan


def picture(*values: float) -> np.ndarray:
    out = np.array([[values]], np.float32)
    out.flags.writeable = False
    return out


def test_one_picture_is_scaled_and_several_are_averaged_where_they_are_valid() -> None:
    pictures = {0: picture(2, 4, NAN), 7: picture(4, NAN, NAN)}
    out = stack(pictures, counts_per_radiance=2.0)["radiance"]
    np.testing.assert_array_equal(out, np.array([[[1.5, 2.0, NAN]]], np.float32))
    assert out.dtype == np.float32
    np.testing.assert_array_equal(stack({3: pictures[0]}, counts_per_radiance=2.0)["radiance"][0, 0], [1, 2, NAN])


def test_exposures_by_hand_where_one_is_clipped_the_other_counts_alone() -> None:
    """(10 + 40) / (1 + 4) = 10 and (10 + nan) / 1; alone, 40 counts of four exposures are 10."""
    pictures = {0: picture(10, 10, NAN), 1: picture(40, NAN, 40)}
    out = stack(pictures, counts_per_radiance=1.0, exposure=[1.0, 4.0])["radiance"]
    np.testing.assert_array_equal(out[0, 0], [10, 10, 10])
    out = stack({1: pictures[1]}, counts_per_radiance=2.0, exposure=[4.0])["radiance"]
    np.testing.assert_array_equal(out[0, 0], [5, NAN, 5])


def test_the_mean_of_exposures_has_the_least_noise() -> None:
    """Of sums weighted otherwise none varies less, under shot noise: 20,000 points tell a variance to 1 %."""
    generator = np.random.default_rng(1)
    short, long = generator.poisson(100, 20000), generator.poisson(400, 20000)
    joined = stack({0: picture(*short), 1: picture(*long)}, counts_per_radiance=1.0, exposure=[1.0, 4.0])[
        "radiance"
    ]
    for weight in (0.1, 0.5, 0.9):
        assert joined.var() < 1.02 * (weight * short + (1 - weight) * long / 4).var()
    assert joined.var() == pytest.approx(100 / 5, rel=0.05)


@given(st.permutations(range(4)))
def test_the_order_of_pictures_does_not_count(order: list[int]) -> None:
    pictures = {i: picture(i, 10 * i, NAN if i == 2 else 3) for i in range(4)}
    whole = stack(pictures, counts_per_radiance=0.5)["radiance"]
    np.testing.assert_array_equal(whole[0, 0], [3, 30, 6])
    np.testing.assert_array_equal(
        stack({i: pictures[i] for i in order}, counts_per_radiance=0.5)["radiance"], whole
    )


def test_sixteen_bits_of_a_mantissa_are_kept_and_halves_go_up() -> None:
    assert RADIANCE_BITS == 16
    step = 2.0**-16
    for value, stored in (
        (1.0, 1.0),
        (1 + step, 1 + step),
        (1 + 0.49 * step, 1.0),
        (1 + 0.5 * step, 1 + step),
        (2 - 0.4 * step, 2.0),  # into the next power of two
        (-1 - 0.5 * step, -1 - step),
        (0.0, 0.0),
    ):
        rounded = stack({0: picture(value)}, counts_per_radiance=1.0)["radiance"][0, 0, 0]
        assert rounded == np.float32(stored), value


@given(st.floats(1e-30, 1e30), st.floats(1e-3, 1e3))
def test_it_is_the_quotient_to_half_a_step(counts: float, scale: float) -> None:
    out = stack({0: picture(counts)}, counts_per_radiance=scale)["radiance"][0, 0, 0]
    # half of a step of 2^-16, and float32's own rounding of counts, scale and product
    assert out == pytest.approx(float(np.float32(counts)) / scale, rel=2.0**-17 + 3 * 2.0**-24)


def test_pictures_are_read_one_at_a_time() -> None:
    asked = []

    class Read(dict[int, np.ndarray]):
        def __getitem__(self, frame: int) -> np.ndarray:
            asked.append(frame)
            return super().__getitem__(frame)

    stack(Read({4: picture(1), 9: picture(3)}), counts_per_radiance=1.0)
    assert asked[-2:] == [4, 9]
    assert set(asked) == {4, 9}

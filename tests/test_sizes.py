"""Sizes in powers of 1000."""

import pytest

from lightstage.sizes import human_size


@pytest.mark.parametrize(
    ("count", "text"),
    [(0, "0 B"), (999, "999 B"), (1000, "1.0 kB"), (1.5e9, "1.5 GB"), (2e12, "2.0 TB"), (5e15, "5000.0 TB")],
)
def test_a_size_has_one_digit_and_the_largest_unit_below_it(count: float, text: str) -> None:
    assert human_size(count) == text

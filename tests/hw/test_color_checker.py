"""The chart's facts, against what is printed of it elsewhere."""

import pytest

from lightstage.hw.color_checker import BANDS_NM, COLUMNS, NAMES, REFLECTANCE, ROWS


def patch(name: str) -> tuple[float, ...]:
    return REFLECTANCE[NAMES.index(name)]


def test_every_patch_has_every_band() -> None:
    assert len(NAMES) == len(REFLECTANCE) == ROWS * COLUMNS == len(set(NAMES)) == 24
    assert BANDS_NM == (407, 434, 445, 497, 576, 655)
    assert {len(row) for row in REFLECTANCE} == {6}
    assert all(0 < value < 1 for row in REFLECTANCE for value in row)


@pytest.mark.parametrize(
    ("name", "luminance"),
    # Y of the chart under daylight, percent, as printed by McCamy et al. (1976): the grey series
    [("white", 90.0), ("neutral 8", 59.1), ("neutral 6.5", 36.2), ("neutral 5", 19.8), ("neutral 3.5", 9.0),
     ("black", 3.1)],
)  # fmt: skip
def test_greys_are_as_bright_as_printed_and_flat(name: str, luminance: float) -> None:
    """Charts differ by a few per cent; black by more of its little."""
    for value in patch(name)[3:]:
        assert 100 * value == pytest.approx(luminance, rel=0.04, abs=0.6)


def test_colours_are_where_their_names_say() -> None:
    blue, middle, red = (BANDS_NM.index(nm) for nm in (445, 497, 655))
    assert patch("red")[red] > 10 * patch("red")[blue]
    assert patch("blue")[blue] > 3 * patch("blue")[red]
    assert patch("green")[middle] > max(patch("green")[blue], patch("green")[red])
    assert patch("yellow")[red] > 0.6 > 0.1 > patch("yellow")[blue]
    assert patch("magenta")[middle] < min(patch("magenta")[blue], patch("magenta")[red])
    assert patch("cyan")[red] < min(patch("cyan")[blue], patch("cyan")[middle])

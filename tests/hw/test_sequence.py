"""Sequences against the literals of the thesis and of the captures, and the sets against linear algebra."""

from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.hw import virtual_rig
from lightstage.hw.errors import RigError
from lightstage.hw.sequence import (
    SETS,
    Exposure,
    cycle,
    minimal,
    multispectral,
    parse,
    period,
    static,
    supported,
    wilson,
)

PURE = parse("X Z C Y Xc C Zc Yc C Xc Z C Y X C Z Yc C Xc Zc C Yc X C Z Y C X Zc C Yc Xc C Zc Y C")
MIXED = parse("X Z C Y Xc C Zc Yc C")
OTHERS = {"X": "YZ", "Y": "XZ", "Z": "XY"}


def windows(sequence: tuple[str, ...]) -> list[list[str]]:
    """The two gradients before and after each C of a minimal sequence, by counting."""
    return [[sequence[i] for i in (c - 2, c - 1, c + 1, c + 2)] for c in range(2, len(sequence), 3)]


def test_the_static_set_is_the_virtual_rigs() -> None:
    assert " ".join(static()) == "C X Y Z Xc Yc Zc"
    assert virtual_rig.Shot().sequence == static()


def test_wilsons_sequence() -> None:
    assert " ".join(wilson(1)) == "X Y Z C Xc Yc Zc"
    assert " ".join(wilson(3)) == "X Y Z C Xc Yc Zc C X Y Z C Xc Yc Zc"
    assert cycle("wilson") == parse("X Y Z C Xc Yc Zc C")


def test_the_rules_find_the_sequences_that_are_known() -> None:
    assert cycle("minimal") == PURE
    assert cycle("minimal", sets="mixed") == MIXED
    assert minimal(24) == (PURE * 3)[: 3 * 24 + 2]
    assert minimal(24, sets="mixed") == (MIXED * 9)[: 3 * 24 + 2]


@given(st.integers(1, 200))
def test_how_many_images_they_need(n: int) -> None:
    assert len(wilson(n)) == 4 * n + 3
    for sets in ("pure", "mixed"):
        sequence = minimal(n, sets=sets)
        assert len(sequence) == 3 * n + 2
        assert sequence.count("C") == n
        assert minimal(n + 1, sets=sets)[: len(sequence)] == sequence


@pytest.mark.parametrize("sets", ["pure", "mixed"])
def test_the_three_rules_hold_in_every_window(sets: str) -> None:
    sequence = minimal(40, sets=sets)  # type: ignore[arg-type]
    assert [i for i, name in enumerate(sequence) if name == "C"] == list(range(2, 122, 3))
    mixed = 0
    for first, before, after, last in windows(sequence):
        assert {first, last} == {first[0], first[0] + "c"}
        assert sorted(before[0] + after[0]) == list(OTHERS[first[0]])
        mixed += len(before) != len(after)
    assert mixed == (0 if sets == "pure" else 13)


def test_the_sets_are_all_that_determine_a_normal() -> None:
    """A picture is r_c / 2 +- n_a / 2, so four gradients tell r_c and n when their equations have rank 4."""
    rows = {"C": [1, 0, 0, 0]}
    for i, axis in enumerate("XYZ"):
        for name, sign in ((axis, 1), (axis + "c", -1)):
            rows[name] = [0.5, *(0.5 * sign * (j == i) for j in range(3))]
    for images in SETS.values():
        assert np.linalg.matrix_rank(np.array([rows[name] for name in images])) == 4
    enough = {
        frozenset(four)
        for four in combinations([name for name in rows if name != "C"], 4)
        if np.linalg.matrix_rank(np.array([rows[name] for name in four])) == 4
    }
    found = [frozenset(images) for name, images in SETS.items() if name.startswith("minimal")]
    assert len(found) == 12
    assert set(found) == enough


def test_what_a_window_supports_and_lacks() -> None:
    (record,) = supported(parse("X Z C Y Xc"))
    assert record.frame == 2
    assert (record.before, record.after) == (("X", "Z"), ("Y", "Xc"))
    assert record.sets == ("ratio", "minimal X: Y Z")
    assert record.missing["difference"] == ("Yc", "Zc")
    assert record.missing["minimal X: Yc Z"] == ("Yc",)
    assert len(record.sets) + len(record.missing) == 14
    assert record.flanked == ("X",)


def test_wilsons_windows_support_everything_and_end_at_the_next_tracking_frame() -> None:
    for record in supported(wilson(5)):
        assert len(record.sets) == 14
        assert not record.missing
        assert record.flanked == ("X", "Y", "Z")
    alone, last = supported(["C", "C", "X", "Y", "Z"])
    assert (alone.frame, alone.before, alone.after, alone.sets) == (0, (), (), ())
    assert alone.missing["ratio"] == ("X", "Y", "Z")
    assert (last.sets, last.flanked) == (("ratio",), ())
    assert supported(["X", "Xc", "L07"]) == ()


def test_minimal_windows_support_one_minimal_set_each() -> None:
    for record in supported(minimal(12)):
        (name,) = (name for name in record.sets if name.startswith("minimal"))
        base, _, others = name.removeprefix("minimal ").partition(": ")
        assert record.flanked == (base,)
        assert others.count("c") in (0, 2)
    third = supported(minimal(3, sets="mixed"))[2]
    assert third.sets == ("minimal Z: X Yc",)


def test_the_pure_cycle_goes_through_the_thesis_unit_sequences() -> None:
    """(s_x, s_y', s_z'), (s_x, s_y, s_z'), (s_x', s_y, s_z), (s_x', s_y', s_z), as the thesis lists them."""
    units = ["X", "Yc", "Zc", "X", "Y", "Zc", "Xc", "Y", "Z", "Xc", "Yc", "Z"]
    found = []
    for first, before, after, _ in windows(minimal(12)):
        assert len(before) == len(after)
        found.append(first[0] + before[1:])
    assert found == units


@given(st.lists(st.sampled_from(["C", "X", "Y", "Z", "Xc", "Yc", "Zc", "L03", "O"]), min_size=1, max_size=24))
def test_adding_pictures_never_takes_a_set_away(sequence: list[str]) -> None:
    records = supported(sequence)
    assert [record.frame for record in records] == [i for i, name in enumerate(sequence) if name == "C"]
    richer = supported([*sequence, "X", "Y"])
    for record, more in zip(records, richer, strict=True):
        assert set(record.sets) <= set(more.sets)


@pytest.mark.parametrize("bands", [(576,), (407, 434, 445, 497, 576, 655), (655, 407)])
def test_multispectral_turns_the_wheel_least(bands: tuple[int, ...]) -> None:
    exposures = multispectral(bands)
    assert len(exposures) == 7 * len(bands)
    turns = sum(a.band_nm != b.band_nm for a, b in pairwise(exposures))
    assert turns == len(bands) - 1
    assert list(dict.fromkeys(one.band_nm for one in exposures)) == list(bands)
    for i, band in enumerate(bands):
        assert exposures[7 * i : 7 * i + 7] == tuple(Exposure(name, band) for name in static())


@pytest.mark.parametrize(
    ("sequence", "length"),
    [
        (PURE * 2, 36),
        (MIXED + MIXED[:2], 9),
        (list(static()), 7),
        (["X"], 1),
        (["C"] * 5, 1),
        (parse("X C Z C"), 4),
    ],
)
def test_the_part_that_repeats(sequence: tuple[str, ...], length: int) -> None:
    assert period(sequence) == length


def test_what_is_refused() -> None:
    for call in (lambda: wilson(0), lambda: minimal(-1)):
        with pytest.raises(RigError, match="a performance has 1 to"):
            call()
    with pytest.raises(RigError, match="pure or mixed"):
        minimal(3, sets="some")  # type: ignore[arg-type]
    with pytest.raises(RigError, match="at least one band"):
        multispectral(())
    with pytest.raises(RigError, match="576 nm stands twice"):
        multispectral((576, 407, 576))
    with pytest.raises(RigError, match="frame 1: the illumination 'W' is not known"):
        parse("X, W, C")
    with pytest.raises(RigError, match="empty"):
        supported(())

"""Windows, pairs, methods and times by hand."""

import pytest

from lightstage.kernels.errors import KernelError
from lightstage.kernels.pictures.picture_sets import choose, chosen_sets, pairs, picture_times, windows
from tests.scenes import MINIMAL

SIX = ("X", "Y", "Z", "Xc", "Yc", "Zc")


def test_windows_by_hand() -> None:
    found = windows(MINIMAL)
    assert [w.frame for w in found] == [2, 5, 8, 11]
    assert found[0].at == {"C": 2, "Z": 1, "Y": 3, "X": 0, "Xc": 4}
    assert found[1].at == {"C": 5, "Xc": 4, "Zc": 6, "Y": 3, "Yc": 7}
    assert found[3].at == {"C": 11, "Z": 10, "X": 9}
    assert windows(["X", "Y"]) == []


def test_of_a_picture_that_stands_twice_the_nearest_counts() -> None:
    (window,) = windows(["X", "Y", "C", "X"])
    assert window.at["X"] == 3


def test_pairs_and_complements_by_hand() -> None:
    assert pairs(["Xc", "Y", "X", "Z", "Zc", "C"]) == [(2, 0), (3, 4)]


@pytest.mark.parametrize(
    ("have", "method"),
    [
        ((*SIX, "C"), "difference"),
        (("X", "Xc", "Y", "Zc"), "minimal"),
        (("X", "Y", "Z", "C"), "ratio"),
        (("L00", "L01", "L02"), "least_squares"),
    ],
)
def test_the_method_of_a_set(have: tuple[str, ...], method: str) -> None:
    assert choose(have).method == method
    assert choose(have[::-1]).method == method


@pytest.mark.parametrize(
    ("have", "options", "part"),
    [
        (("X", "Y"), {}, "no method works with these"),
        (("X", "Y", "Z", "C"), {"method": "difference"}, "method: ratio would work"),
        (SIX, {"method": "difference", "base": "X"}, "base: X belongs to method: minimal"),
        (SIX, {"correct": "qp"}, "C missing"),
    ],
)
def test_what_is_missing_is_said(have: tuple[str, ...], options: dict[str, str], part: str) -> None:
    with pytest.raises(KernelError, match=part):
        choose(have, **options)


def test_only_windows_with_a_full_set_are_chosen() -> None:
    whole = " ".join(MINIMAL)
    found = chosen_sets(windows(MINIMAL), method="auto", base="auto", correct="none", whole=whole)
    assert [(w.frame, c.base) for w, c in found] == [(2, "X"), (5, "Y"), (8, "Z")]
    with pytest.raises(KernelError, match=r"between the tracking frames .* X Z C"):
        chosen_sets(windows(MINIMAL), method="difference", base="auto", correct="none", whole=whole)


@pytest.mark.parametrize("told", [[None, None], [1.0, 1.0], [0.0, float("nan")]])
def test_times_that_are_not_told_follow_from_the_rate(told: list[float | None]) -> None:
    facts = {"time_s": told, "frame_rate_hz": 50.0, "illumination": ["X", "C"]}
    assert picture_times(facts) == [0, 0.02]
    assert picture_times({**facts, "time_s": [3.0, 5.0]}) == [3, 5]


@pytest.mark.parametrize(
    ("have", "expected"),
    [
        ("C X Y Z Xc Yc Zc", ("difference", "")),
        ("X Y Z Xc Yc Zc", ("difference", "")),
        ("C X Y Z", ("ratio", "")),
        ("C X Y Z Yc", ("minimal", "Y")),
        ("X Z C Y Xc", ("minimal", "X")),
        ("L00 L01 L02 L03", ("least_squares", "")),
    ],
)
def test_auto_takes_the_best_that_the_frames_support(have: str, expected: tuple[str, str]) -> None:
    choice = choose(have.split())
    assert (choice.method, choice.base) == expected


@pytest.mark.parametrize(
    ("have", "ask", "parts"),
    [
        ("C X Y", {}, ["any method needs", "the session has C, X, Y", "no method works"]),
        ("C X Y Z", {"method": "difference"}, ["difference needs X Y Z Xc Yc Zc", "method: ratio would work"]),
        ("C X Y Z Xc", {"method": "minimal", "base": "Z"}, ["minimal with base Z needs Z and Zc", "ratio"]),
        ("C X Y Z", {"correct": "qp"}, ["Xc, Yc, Zc missing", "correct: none works with ratio"]),
        ("L00 L01 L02", {"correct": "qp"}, ["gradient methods"]),
        ("L00 L01", {}, ["at least three one-light pictures"]),
    ],
)
def test_a_missing_illumination_says_what_is_needed_what_there_is_and_what_would_work(
    have: str, ask: dict[str, str], parts: list[str]
) -> None:
    with pytest.raises(KernelError) as caught:
        choose(have.split(), **ask)
    assert all(part in str(caught.value) for part in parts), str(caught.value)

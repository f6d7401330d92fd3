"""Test sequences played wrongly on purpose."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.sync_check import align, check

Array = NDArray[np.float64]
LIGHTS = 12
PATTERNS = {f"T{k}": (np.arange(LIGHTS) % 4 == k).astype(float) for k in range(4)}
SEQUENCE = ["T0", "T1", "T2", "T3"] * 3
STRENGTH = np.linspace(800, 1500, LIGHTS)


def crossed() -> Array:
    """(light, highlight): each its own, and a twentieth of it in the highlight of the next."""
    return np.diag(STRENGTH) + np.diag(0.05 * STRENGTH[:-1], 1)


def played(shown: list[str], before: float = 0.0, after: float = 0.0) -> Array:
    """(frame, highlight) sums, with parts of the exposure under the neighbours' patterns."""
    rows = []
    for i, name in enumerate(shown):
        drive = (1 - before - after) * PATTERNS[name]
        drive = drive + before * PATTERNS[shown[i - 1]] + after * PATTERNS[shown[(i + 1) % len(shown)]]
        rows.append(drive @ crossed())
    return np.array(rows)


def test_as_it_was_meant() -> None:
    sums = played(SEQUENCE)
    sums.flags.writeable = False
    found = check(sums, crossed(), SEQUENCE, PATTERNS)
    assert list(found.shown) == SEQUENCE
    np.testing.assert_array_equal(found.step, np.arange(12))
    assert not found.wrong.any()
    assert found.events == ()
    for i, name in enumerate(SEQUENCE):
        np.testing.assert_allclose(found.drive[i], PATTERNS[name], atol=1e-9)
    np.testing.assert_allclose(found.leak_before_percent[1:], 0, atol=1e-6)


@given(st.floats(0, 0.2), st.floats(0, 0.2))
@settings(max_examples=15)
def test_leaks_are_told_in_percent_of_the_exposure(before: float, after: float) -> None:
    found = check(played(SEQUENCE, before, after), crossed(), SEQUENCE, PATTERNS)
    # the first and the last have a neighbour in what was played that the check does not know of
    np.testing.assert_allclose(found.leak_before_percent[1:-1], 100 * before, atol=1e-4)
    np.testing.assert_allclose(found.leak_after_percent[1:-1], 100 * after, atol=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_noise_ends_within_the_standard_error(seed: int) -> None:
    clean = played(SEQUENCE, 0.05)
    variance = clean / 10 + 50
    noisy = clean + np.random.default_rng(seed).normal(0, np.sqrt(variance))
    found = check(noisy, crossed(), SEQUENCE, PATTERNS, variance=variance)
    off = (found.leak_before_percent[1:] - 5) / found.leak_se_percent[1:]
    assert np.abs(off).max() < 4


def test_light_of_no_pattern_is_unexplained() -> None:
    sums = played(SEQUENCE)
    sums[4, 2] += 500.0
    found = check(sums, crossed(), SEQUENCE, PATTERNS)
    assert found.unexplained_percent[4] > 5
    np.testing.assert_allclose(found.unexplained_percent[:4], 0, atol=1e-6)


def test_a_picture_without_light_is_dark() -> None:
    sums = played(SEQUENCE)
    sums[5] = 0.1
    found = check(sums, crossed(), SEQUENCE, PATTERNS)
    assert found.shown[5] == "O"
    assert found.wrong[5]
    assert [event.kind for event in found.events] == ["wrong"]
    assert "frame 5 shows O where T1 was meant" in found.events[0].says


def test_sequences_out_of_order_by_hand() -> None:
    meant = ["A", "B", "C", "D", "E"]
    step, events = align(("A", "C", "B", "D", "E"), meant)
    assert step.tolist() == [0, 2, 1, 3, 4]
    assert [(e.kind, e.frames) for e in events] == [("swapped", (1, 2))]
    step, events = align(("A", "B", "D", "E"), meant)
    assert step.tolist() == [0, 1, 3, 4]
    assert [e.kind for e in events] == ["dropped", "shifted"]
    assert "step 2 (C) is missing before frame 2" in events[0].says
    step, events = align(("A", "B", "B", "C", "D", "E"), meant)
    assert [e.kind for e in events] == ["repeated", "shifted"]
    step, events = align(("A", "B", "X", "C", "D", "E"), meant)
    assert step.tolist() == [0, 1, -1, 2, 3, 4]
    assert [e.kind for e in events] == ["extra", "shifted"]
    step, events = align(("E", "B", "C", "D", "A"), meant)
    assert [(e.kind, e.frames) for e in events] == [("swapped", (0, 4))]


@given(st.lists(st.sampled_from("ABCD"), min_size=1, max_size=12))
@settings(max_examples=50)
def test_what_was_meant_fits_itself(meant: list[str]) -> None:
    step, events = align(tuple(meant), meant)
    assert step.tolist() == list(range(len(meant)))
    assert events == []


def test_refusals() -> None:
    with pytest.raises(KernelError, match="12 frames of 12 highlights need 12 names"):
        check(played(SEQUENCE), crossed(), SEQUENCE[:3], PATTERNS)
    with pytest.raises(KernelError, match="the illumination 'T9' has no pattern; known are T0, T1, T2, T3"):
        check(played(SEQUENCE), crossed(), ["T9", *SEQUENCE[1:]], PATTERNS)
    hidden = crossed()
    hidden[np.arange(0, 12, 4), np.arange(0, 12, 4)] = np.nan
    with pytest.raises(KernelError, match="no light of T0 is seen on the ball"):
        check(played(SEQUENCE), hidden, SEQUENCE, PATTERNS)

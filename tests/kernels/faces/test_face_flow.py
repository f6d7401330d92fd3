"""Flows from face to face: heads whose correspondence is known, what lies between them, and points by hand."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.kernels.errors import KernelError
from lightstage.kernels.faces.face_flow import between, face_flow, landed, mixed_normals, pulled, through_points
from lightstage.kernels.faces.face_frame import Frame
from tests.face_scenes import PARTS, framed, true_flow, view
from tests.scenes import angle_deg

FRAME = Frame(60)
OVAL = FRAME.oval()
SEEDS = (2, 6)
"""Two heads that are far from each other: one short and flat, one long with large eyes."""


@pytest.fixture(scope="module")
def heads() -> Any:
    return [framed(view(seed), FRAME) for seed in SEEDS]


@pytest.fixture(scope="module")
def flow(heads: Any) -> Any:
    return face_flow(heads[0].normal, heads[1].normal, OVAL, FRAME.eyes_px)


@pytest.mark.slow
def test_parts_of_one_head_come_to_those_of_another(heads: Any, flow: Any) -> None:
    """Without the flow the lips are 10 pixels off; with it all are within 3, 5 % of the eye distance.

    An ellipsoid's front is not quite the same slope on two heads, because the face around it is another.
    """
    wanted = heads[1].places
    before = np.linalg.norm(heads[0].places - wanted, axis=1)
    after = np.linalg.norm(landed(heads[0].places, flow) - wanted, axis=1)
    assert before.mean() > 5
    assert before[list(PARTS).index("lower lip")] > 10
    assert after.mean() < 1
    assert after.max() < 3


@pytest.mark.slow
def test_a_bent_head_is_followed_back_to_the_one_at_rest() -> None:
    """Every pixel is known: 4 pixels off on average without the flow, 1.5 with it (2.5 % of the eye distance).

    What is left lies on cheeks and forehead, where the skin has no slope of its own to be recognised by.
    """
    bent, rest = framed(view(0, bent=True), FRAME), framed(view(0), FRAME)
    found = face_flow(bent.normal, rest.normal, OVAL, FRAME.eyes_px)
    true = true_flow(FRAME)
    inside = (OVAL > 0.5) & np.isfinite(true[0])
    off = np.hypot(*(found - true))[inside]
    still = np.hypot(*true)[inside]
    assert still.mean() > 3.5
    assert off.mean() < 1.7
    assert np.percentile(off, 95) < 4


def test_a_face_is_its_own_place(heads: Any) -> None:
    assert np.abs(face_flow(heads[0].normal, heads[0].normal, OVAL, FRAME.eyes_px)).max() < 1e-6


def test_a_shifted_face_is_followed_to_a_twentieth_of_a_pixel(heads: Any) -> None:
    first = heads[0].normal
    second = np.roll(first, (2, -3), axis=(1, 2))
    found = face_flow(first, second, OVAL, FRAME.eyes_px)
    np.testing.assert_allclose(np.median(found[:, OVAL > 0.5], axis=1), [-3, 2], atol=0.05)


def test_larger_pictures_give_the_same_flow(heads: Any, flow: Any) -> None:
    """Faces are compared at one size, so twice the pixels give twice the flow, within a few percent."""
    large = Frame(120)
    faces = [framed(view(seed), large).normal for seed in SEEDS]
    found = face_flow(*faces, large.oval(), large.eyes_px)
    step = np.array([(s - 1) / 2 for s in FRAME.shape[::-1]]), np.array([(s - 1) / 2 for s in large.shape[::-1]])
    places = heads[0].places
    moves = landed(places, flow) - places
    there = (places - step[0]) * 2 + step[1]
    np.testing.assert_allclose(landed(there, found) - there, 2 * moves, atol=1.0)


def test_the_ends_of_a_morph_are_the_faces_themselves(heads: Any, flow: Any) -> None:
    """Level 0 to the last digits; level 1 within a degree, because the inverse of the flow is resampled."""
    first, second = (one.normal for one in heads)
    to = between(flow, 0.0)
    start = mixed_normals(pulled(first, to.first), pulled(second, to.second), 0)
    np.testing.assert_allclose(start, first, atol=1e-6)
    to = between(flow, 1.0)
    last = mixed_normals(pulled(first, to.first), pulled(second, to.second), 1.0)
    assert angle_deg(last, second)[OVAL > 0.5].max() < 1


def test_half_way_is_between_and_has_no_ghost(heads: Any, flow: Any) -> None:
    """At level 1/2 both faces, brought there, agree in slope: edges of lips and nose are there once, not twice."""
    first, second = (one.normal for one in heads)
    to = between(flow, 0.5)
    inner = OVAL > 0.9
    apart = angle_deg(first, second)[inner]
    brought = angle_deg(mixed_normals(pulled(first, to.first), first, 0), pulled(second, to.second))[inner]
    assert np.percentile(apart, 95) > 25
    assert np.percentile(brought, 95) < 0.5 * np.percentile(apart, 95)
    middle = (heads[0].places + landed(heads[0].places, flow)) / 2
    np.testing.assert_allclose(landed(middle, to.first), heads[0].places, atol=0.1)
    np.testing.assert_allclose(landed(middle, to.second), landed(heads[0].places, flow), atol=0.1)


def test_points_by_hand_are_met_and_the_border_holds(flow: Any) -> None:
    own = np.array([[60.0, 80], [105, 82], [84, 120], [84, 150]])
    wanted = landed(own, flow) + np.array([[2.0, 1], [-1, 3], [0, -4], [1, 0]])
    through = through_points(flow, own, wanted)
    # the spline is exact at points; between pixels the flow is read bilinearly
    np.testing.assert_allclose(landed(own, through), wanted, atol=0.05)
    np.testing.assert_allclose(through[:, 0, 0], flow[:, 0, 0], atol=1e-3)
    with pytest.raises(KernelError, match="the same"):
        through_points(flow, own[[0, 0]], wanted[:2])


@given(st.floats(0, 1))
def test_mixed_normals_are_unit_and_between(level: float) -> None:
    a = np.array([0, 0, 1], np.float32)[:, None, None]
    b = np.array([np.sin(1.0), 0, np.cos(1.0)], np.float32)[:, None, None]
    mixed: Any = mixed_normals(a, b, level)[:, 0, 0]
    assert np.linalg.norm(mixed) == pytest.approx(1, abs=1e-6)
    assert -1e-6 <= np.arctan2(mixed[0], mixed[2]) <= 1 + 1e-6
    np.testing.assert_allclose(mixed_normals(a, b, 0.5)[:, 0, 0], [np.sin(0.5), 0, np.cos(0.5)], atol=1e-6)
    np.testing.assert_array_equal(mixed_normals(a, -a, 0.5), a)


def test_inputs_may_be_read_only_and_stay(heads: Any) -> None:
    pair = [one.normal.copy() for one in heads]
    for normal in pair:
        normal.flags.writeable = False
    found = face_flow(*pair, OVAL, FRAME.eyes_px)
    found.flags.writeable = False
    pulled(pair[0], between(found, 0.3).first)
    for normal, one in zip(pair, heads, strict=True):
        np.testing.assert_array_equal(normal, one.normal)

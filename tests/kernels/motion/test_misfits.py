"""Pictures that do not belong to their set, one kind at a time, on pictures written here."""

from typing import Any

import numpy as np
import pytest

from lightstage.kernels.motion.misfits import (
    leave_out_contradicted,
    leave_out_foreign,
    leave_out_misplaced,
    same_scene,
)
from lightstage.kernels.motion.shots import Member, Shot
from lightstage.kernels.pictures import blurs

SIDE = 64


def textured(seed: int) -> Any:
    """A bright thing of fine texture in the dark."""
    noise = np.random.default_rng(seed).standard_normal((SIDE, SIDE)).astype(np.float32)
    picture = 1 + 2 * blurs.gaussian(noise, 1.0)
    y, x = np.mgrid[0:SIDE, 0:SIDE] - SIDE / 2
    return np.where(np.hypot(x, y) < 26, np.maximum(picture, 0.2), 0).astype(np.float32)


def members(**pictures: Any) -> list[Member]:
    """By illumination, the tracking frame first."""
    constant = {"C": textured(0), **pictures}
    return [
        Member.unmoved(place, Shot(10 + place, name, float(place)), [picture[None]], picture)
        for place, (name, picture) in enumerate(constant.items())
    ]


C = textured(0)


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (0 * C, "frame 12 (Y) is black beside frame 10 (C)"),
        (C, "frame 12 (Y) is as bright as frame 10 (C), so it shows constant light"),
        (np.full_like(C, np.nan), "frame 12 (Y) holds no valid pixel where frame 10 (C) shows the subject"),
        (C * np.float32(0.6), "frame 12 (Y) repeats frame 11 (X)"),
    ],
)
def test_what_cannot_be_what_it_is_called(wrong: Any, reason: str) -> None:
    constant, *others = members(X=C * np.float32(0.6), Y=wrong, Z=C * np.float32(0.5))
    (sentence,) = leave_out_misplaced(constant, others)
    assert [m.left_out for m in others] == [False, True, False]
    assert sentence.startswith(reason)


def test_a_tracking_frame_that_is_none_takes_its_set_with_it() -> None:
    for picture, reason in (
        (0 * C, "is black"),
        (C * np.float32(0.3), "is darker"),
        (C * np.float32(np.nan), "no"),
    ):
        constant, *others = members(C=picture, X=C * np.float32(0.6), Xc=C * np.float32(0.4))
        (sentence,) = leave_out_misplaced(constant, others)
        assert reason in sentence
        assert all(member.left_out for member in others)


def test_another_scene_is_foreign_and_a_thing_in_the_way_is_doubted() -> None:
    covered = C * np.float32(0.5)
    covered[20:44, 20:44] = textured(7)[20:44, 20:44] * np.float32(0.5)
    constant, *others = members(X=C * np.float32(0.6), Y=textured(1) * np.float32(0.5), Z=covered)
    (sentence,) = leave_out_foreign(constant, {m.place: m.picture for m in others}, others)
    assert sentence.startswith("frame 12 (Y) does not show what")
    assert [m.left_out for m in others] == [False, True, False]
    assert others[0].confidence.min() == 1
    assert others[2].confidence[28:36, 28:36].max() < 0.1


def test_a_pair_must_add_up() -> None:
    constant, *others = members(X=C * np.float32(0.6), Xc=C * np.float32(0.4), Y=C * np.float32(0.9), Yc=C / 2)
    (sentence,) = leave_out_contradicted(constant, {m.place: m.picture for m in others}, others)
    assert sentence.startswith("frame 13 (Y) and frame 14 (Yc) are 40 % off their sum")
    assert [m.left_out for m in others] == [False, False, True, True]
    np.testing.assert_allclose(others[0].confidence, 1)


def test_a_shifted_subject_is_the_same_scene_and_an_empty_one_is_not() -> None:
    assert same_scene(np.roll(C, 2, axis=1), C)
    assert not same_scene(0 * C, C)
    assert not same_scene(np.full_like(C, np.nan), C)

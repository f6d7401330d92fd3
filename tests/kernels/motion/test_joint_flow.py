"""Flows under different light: exact truth, one motion for a window, doubt, and pictures that tell nothing."""

from typing import Any

import cv2
import numpy as np
import pytest

from lightstage.kernels.motion.joint_flow import extended, follow, joint, joint_flows, nudge, subject_of
from tests.moving_scenes import Scene, scene
from tests.scenes import Performer, angle_deg

SEEDS = (0, 1, 2)


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    cv2.setNumThreads(1)


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    return [scene(seed, 298) for seed in SEEDS]


def error(flow: Any, truth: Any, inner: Any) -> float:
    return float(np.hypot(*(flow - truth))[inner].mean())


def sampled(picture: Any, flow: Any) -> Any:
    """picture(x + flow(x)) by OpenCV's cubic, not by the stages' own code."""
    y, x = np.indices(picture.shape, np.float32)
    return cv2.remap(picture, x + flow[0], y + flow[1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def test_the_subject_by_hand() -> None:
    """Below 0.03 of the bright end, and what is not known, is not the subject."""
    np.testing.assert_array_equal(subject_of(np.array([[100, 1], [np.nan, 100]], np.float32)), [[1, 0], [0, 1]])


def test_motion_is_doubted_only_beside_rim_and_border_by_hand() -> None:
    subject = np.ones((80, 406), bool)
    flow = np.zeros((1, 2, 80, 406), np.float32)
    flow[0, 0] = 3
    doubt = extended(flow, subject)[0]
    # 3 px beyond the right border: 2.1 x 3 x exp(0); 40 px inside: exp(-37 / 15) of that at most
    assert doubt[40, 405] == pytest.approx(6.3, rel=1e-3)
    assert doubt[40, 200] < 6.4 * np.exp(-37 / 15)
    assert not extended(0 * flow, subject).any()


@pytest.mark.parametrize("seed", SEEDS)
def test_a_pairs_flows(scenes: list[Scene], seed: int) -> None:
    """A tenth of a pixel; flows are 3 to 6 px at their peak. Normals hardly differ from the true flow's."""
    s = scenes[seed]
    u, v = joint(s.constant, s.gradient, s.complement)
    assert error(u, s.u, s.inner) < 0.12
    assert error(v, s.v, s.inner) < 0.12

    def normals(a: Any, b: Any) -> Any:
        vector = np.stack([r - rc for r, rc in s.still])
        vector[s.axis] = sampled(s.gradient, a) - sampled(s.complement, b)
        return vector[:, s.inner]

    still = np.stack([r - rc for r, rc in s.still])[:, s.inner]
    found, right = (angle_deg(n, still).mean() for n in (normals(u, v), normals(s.u, s.v)))
    assert abs(found - right) < 0.1


@pytest.mark.parametrize("seed", SEEDS)
def test_flows_that_have_nothing_in_common(seed: int) -> None:
    """The default prior expects v near -u; it may cost no more than a third of a pixel where that is wrong."""
    s = scene(seed, 298, "independent")
    u, v = joint(s.constant, s.gradient, s.complement)
    assert error(u, s.u, s.inner) < 0.3
    assert error(v, s.v, s.inner) < 0.3


def test_no_motion_is_no_flow(scenes: list[Scene]) -> None:
    s = scenes[0]
    # what the noise of 10-bit pictures moves
    for flow in joint(s.constant, *s.still[s.axis]):
        assert error(flow, 0, s.inner) < 0.1


@pytest.mark.parametrize("factor", [1024, 7.3, 1e-3])
def test_scale_changes_nothing(scenes: list[Scene], factor: float) -> None:
    s = scenes[0]
    pictures = s.constant, s.gradient, s.complement
    one, other = joint(*pictures), joint(*(np.float32(factor) * p for p in pictures))
    # float32 rounding, carried through 24 Gauss-Newton steps
    np.testing.assert_allclose(one, other, atol=1e-3)


def test_swapping_the_pair_swaps_the_flows(scenes: list[Scene]) -> None:
    s = scenes[1]
    u, v = joint(s.constant, s.gradient, s.complement, times=(-1, 2))
    w, x = joint(s.constant, s.complement, s.gradient, times=(2, -1))
    np.testing.assert_allclose(x, u, atol=1e-3)
    np.testing.assert_allclose(w, v, atol=1e-3)


@pytest.mark.parametrize("fill", [0.0, 0.5, np.nan])
def test_pictures_that_tell_nothing_do_not_move(fill: float) -> None:
    nothing = np.full((60, 80), fill, np.float32)
    flows = joint_flows(2 * nothing, [nothing, nothing], times=(-1, 1))
    np.testing.assert_array_equal(flows.flow, 0)
    np.testing.assert_array_equal(flows.doubt_px, 0)


@pytest.mark.parametrize("fill", [0.0, np.nan])
def test_a_picture_that_is_black_or_unknown_is_finite(scenes: list[Scene], fill: float) -> None:
    s = scenes[0]
    flows = joint_flows(s.constant, [np.full_like(s.gradient, fill), s.complement], times=(-1, 1))
    assert np.isfinite(flows.flow).all()
    assert np.isfinite(flows.doubt_px).all()


def test_a_hole_does_not_spoil_its_surroundings(scenes: list[Scene]) -> None:
    s = scenes[0]
    gradient = s.gradient.copy()
    gradient[80:90, 140:150] = np.nan
    u, v = joint(s.constant, gradient, s.complement)
    assert np.isfinite(u).all()
    assert error(u, s.u, s.inner) < 0.12
    assert error(v, s.v, s.inner) < 0.12


def test_one_motion_for_the_window_is_better_than_a_pair_alone() -> None:
    """Quadratic in time: what `follow` can be exact for, and `joint` sees two pictures of."""
    for seed in SEEDS:
        actor = Performer(seed=seed)
        names, times = ("X", "Z", "Y", "Xc", "C", "C"), (-2, -1, 1, 2, -3, 3)
        _, _, inner = actor.surface(0)
        pictures = [actor.picture(t, n).astype(np.float32) for t, n in zip(times, names, strict=True)]
        constant = actor.picture(0, "C").astype(np.float32)
        found = follow(constant, pictures, times=times, steady=[n == "C" for n in names], pairs=[(0, 3)])
        together = [error(found.flow[i], actor.flow(0, t), inner) for i, t in enumerate(times)]
        alone = joint(constant, pictures[0], pictures[3], times=(-2, 2))
        assert max(together) < 0.1
        assert together[0] + together[3] < sum(
            error(f, actor.flow(0, t), inner) for f, t in zip(alone, (-2, 2), strict=True)
        )


def test_a_nudge_ends_at_the_truth() -> None:
    actor = Performer()
    truth, inner = actor.flow(0, 1), actor.surface(0)[2]
    start = truth.astype(np.float32) + np.float32(0.7)
    constant, picture = (actor.picture(t, n).astype(np.float32) for t, n in ((0, "C"), (1, "Y")))
    assert error(nudge(constant, picture, start).flow[0], truth, inner) < 0.1


def test_inputs_stay_as_they_are(scenes: list[Scene]) -> None:
    pictures = [p.copy() for p in (scenes[0].constant, scenes[0].gradient, scenes[0].complement)]
    pictures[1][5, 5] = np.nan
    before = [p.copy() for p in pictures]
    for picture in pictures:
        picture.flags.writeable = False
    joint(*pictures)
    follow(pictures[0], pictures[1:], times=(-1, 1), steady=(False, False), pairs=[(0, 1)])
    for picture, kept in zip(pictures, before, strict=True):
        np.testing.assert_array_equal(picture, kept)

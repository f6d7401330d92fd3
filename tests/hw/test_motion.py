"""The moving head: what moves it is smooth, small enough to trace, and as fast as it says."""

import numpy as np
import pytest

from lightstage.hw import head, motion
from lightstage.hw.errors import RigError

EYE = np.array([0.0, 0.0, 890.0])
MOVING = ("slow", "fast")


def rays(width: int, height: int, step: float = 1.0) -> np.ndarray:
    """Through every `step`-th pixel of the camera of 406 x 309, (y, x, xyz)."""
    y, x = np.mgrid[0:height, 0:width] * step
    d = np.stack([(x - 203.2) / 1020, -(y - 153.4) / 1020, -np.ones_like(x)], axis=-1)
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


def seen_at_rest() -> np.ndarray:
    """Material points (point, xyz) that the camera sees of the resting head."""
    shape = head.parts(1)
    directions = rays(68, 51, 6.0).reshape(-1, 3)
    t = head.first_hit(shape, head.coarse_field(shape), None, directions, EYE)
    return (EYE + t[:, None] * directions)[t >= 0]


def test_it_starts_at_rest_and_still_stays_there() -> None:
    for name, time_s in (("slow", 0.0), ("fast", 0.0), ("still", 3.0)):
        pose = motion.pose(name, time_s)
        assert pose.warp is None
        np.testing.assert_array_equal(pose.leave(np.eye(3)), np.eye(3))
    with pytest.raises(RigError, match="expected still, slow, fast"):
        motion.pose("walk", 0.0)


def test_a_pose_is_rz_ry_rx_and_a_shift() -> None:
    """Against turning by hand about one axis after the other."""
    pose = motion.pose("fast", 0.4)
    p = np.array([10.0, -20.0, 80.0])
    for axis, (a, b) in (("x", (1, 2)), ("y", (2, 0)), ("z", (0, 1))):
        angle = np.radians(pose.channels[f"turn_{axis}"])
        assert abs(angle) > 1e-3
        p[a], p[b] = np.cos(angle) * p[a] - np.sin(angle) * p[b], np.sin(angle) * p[a] + np.cos(angle) * p[b]
    p += [pose.channels[f"shift_{axis}"] for axis in "xyz"]
    np.testing.assert_allclose(pose.leave(np.array([10.0, -20.0, 80.0])), p, atol=1e-9)
    np.testing.assert_allclose(pose.enter(p), [10, -20, 80], atol=1e-9)


@pytest.mark.parametrize("name", MOVING)
def test_it_moves_as_many_pixels_a_picture_as_it_says(name: str) -> None:
    """Over 5 s at 60 pictures a second and 406 x 309; the fastest of the skin that the camera sees."""
    points, before, peaks = seen_at_rest(), None, []
    for i in range(300):
        pose = motion.pose(name, i / 60)
        p = pose.leave(head.place(points, pose.warp))
        pixel = 1020 * p[:, :2] / (890 - p[:, 2:])
        if before is not None:
            peaks.append(np.linalg.norm(pixel - before, axis=1).max())
        before = pixel
    mean, least, most = np.mean(peaks), min(peaks), max(peaks)
    if name == "slow":
        assert 0.6 < mean < 1.0
        assert least > 0.25
        assert most < 1.4
    else:
        assert 3.0 < mean < 4.0
        assert least > 1.2
        assert most < 6.0


@pytest.mark.parametrize("name", MOVING)
def test_no_face_is_bent_more_than_rays_allow(name: str) -> None:
    """Singular values of dm/dq by finite differences: below STRETCH, and the inverse contracts."""
    points, h = seen_at_rest(), 1e-4
    changed = 0.0
    for i in range(1, 600, 7):
        warp = motion.pose(name, i / 60).warp
        columns = [(head.material(points + h * e, warp) - head.material(points - h * e, warp)) for e in np.eye(3)]
        jacobian = np.stack(columns, axis=-1) / (2 * h)
        values = np.linalg.svd(jacobian, compute_uv=False)
        assert values.max() < head.STRETCH
        assert np.linalg.norm(jacobian - np.eye(3), ord=2, axis=(1, 2)).max() < head.STRETCH - 1
        assert np.linalg.det(jacobian).min() > 0.5
        changed = max(changed, values.max())
        np.testing.assert_allclose(head.material(head.place(points, warp), warp), points, atol=1e-8)
    assert changed > 1.1  # it does talk


def test_what_talks_lies_within_the_heads_bound() -> None:
    warp = motion.pose("slow", 0.1).warp
    assert warp is not None
    assert (np.linalg.norm(warp[:, :3], axis=1) + warp[:, 3:6].max(axis=1)).max() < 175


@pytest.mark.slow
def test_normals_are_those_of_the_surface_that_is_traced() -> None:
    """Against cross products of points traced about 0.5 mm apart, to 1e-3 mm.

    The resting head, whose normals have no warp in them, says how good the comparison is; leaving the warp out of a
    bent head's normals costs degrees."""
    shape = head.parts(0)
    field = head.coarse_field(shape)
    middle = rays(203, 154, 2.0).reshape(-1, 3)
    error, naive_error = {}, {}
    for time_s in (0.0, 0.11, 0.29):
        warp = motion.pose("fast", time_s).warp
        bent = head.bent_field(shape, field, warp)
        corners = []
        for a, side in ((0, 1), (0, -1), (1, 1), (1, -1)):
            d = middle + side * 3e-4 * np.eye(3)[a]
            d /= np.linalg.norm(d, axis=1, keepdims=True)
            corners.append(np.where((t := head.first_hit(shape, bent, warp, d, EYE)) >= 0, t, np.nan)[:, None] * d)
        across, up = corners[0] - corners[1], corners[2] - corners[3]
        traced = np.cross(across, up)
        traced /= np.linalg.norm(traced, axis=1, keepdims=True)
        t, normal = head.surface(shape, bent, warp, middle, EYE)
        points = EYE + t[:, None] * middle
        one_surface = (np.linalg.norm(across, axis=1) < 1.5) & (np.linalg.norm(up, axis=1) < 1.5) & (t >= 0)
        if warp is not None:
            one_surface &= np.linalg.norm(head.material(points, warp) - points, axis=1) > 0.5
        assert one_surface.sum() > 300
        error[time_s] = _median_angle(traced, normal, one_surface)
        if warp is not None:
            # J^-T of the exact normal is along the gradient that knows no warp
            columns = [head.material(points + h, warp) - head.material(points - h, warp) for h in 1e-4 * np.eye(3)]
            jacobian = np.stack(columns, axis=-1) / 2e-4
            plain = np.linalg.solve(np.swapaxes(jacobian, 1, 2), normal[..., None])[..., 0]
            plain /= np.linalg.norm(plain, axis=1, keepdims=True) + 1e-30
            naive_error[time_s] = _median_angle(traced, plain, one_surface)
    assert error[0.0] < 0.4
    assert max(error.values()) < 1.3 * error[0.0]
    assert max(naive_error.values()) > 3 * error[0.0]


def _median_angle(a: np.ndarray, b: np.ndarray, keep: np.ndarray) -> float:
    cosine = np.einsum("ij,ij->i", a, b)[keep]
    return float(np.median(np.degrees(np.arccos(np.clip(cosine, -1, 1)))))

"""Height maps against bodies whose depth is known."""

import numpy as np
import pytest

from lightstage.kernels.encodings import EDGE_BELOW, EDGE_RIGHT
from lightstage.kernels.errors import KernelError
from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.kernels.surface.shape import breaks, shape
from tests.scenes import light_places, near_ball

RADIUS_MM = 80.0
BAND = 576.0


def ball(size: int = 96) -> tuple[np.ndarray, np.ndarray, np.ndarray, Pinhole]:
    lights, drive = light_places()
    pictures, normals, depth, camera = near_ball(lights, drive, size=size, radius_mm=RADIUS_MM)
    return (
        np.asarray(normals, np.float32),
        depth,
        np.asarray(pictures["C"], np.float32),
        Pinhole.of(camera, depth.shape),
    )


def test_depth_that_was_found_is_the_shape() -> None:
    normals, depth, albedo, camera = ball()
    found = np.asarray(depth, np.float32)
    for given in (found, normals, albedo):
        given.flags.writeable = False
    out = shape({0: found}, {BAND: normals}, {BAND: albedo}, camera=camera)
    np.testing.assert_array_equal(out["depth_mm"], found)
    # a ball has no break; its last pixels may be steeper than 83 degrees
    steep = np.abs(normals[2]) < 0.15
    assert not out["edge"][np.isfinite(depth) & ~steep].any()


def test_breaks_by_hand() -> None:
    """A wall 60 mm behind another: a = log(960 / 900) / 0.01 = 6.5, and both face the camera, so a1 = a2 = 0."""
    turn = np.diag([1.0, -1.0, -1.0])
    camera = Pinhole((4, 6), (100.0, 100.0, 2.5, 1.5), (0.0,) * 5, turn, np.array([0, 0, 900.0]))
    depth = np.full((4, 6), 900.0)
    depth[:, 3:] = 960.0
    facing = np.zeros((4, 6, 3))
    facing[..., 2] = -1
    wanted = np.zeros((4, 6), np.uint8)
    wanted[:, 2] = EDGE_RIGHT
    np.testing.assert_array_equal(breaks(depth, facing, camera), wanted)
    # a slope of 6.5 that the normals have seen is none; nor is one of which they say nothing
    sloped = np.broadcast_to(np.array([np.log(960 / 900) / 0.01, 0, -1.0]), (4, 6, 3))
    sloped = sloped / np.linalg.norm(sloped, axis=2, keepdims=True)
    assert not breaks(depth, sloped, camera)[:, 2].any()
    assert not breaks(depth, np.zeros((4, 6, 3)), camera).any()
    # 8 and more is one always: log(990 / 900) / 0.01 = 9.5; transposed it is below; off the subject is none
    depth[:, 3:] = 990.0
    assert (breaks(depth, np.zeros((4, 6, 3)), camera)[:, 2] == EDGE_RIGHT).all()
    square = Pinhole((6, 6), (100.0, 100.0, 2.5, 2.5), (0.0,) * 5, turn, np.array([0, 0, 900.0]))
    upright = np.full((6, 6), 900.0)
    upright[3:] = 990.0
    upright[:, 0] = np.nan
    wanted = np.zeros((6, 6), np.uint8)
    wanted[2, 1:] = EDGE_BELOW
    np.testing.assert_array_equal(breaks(upright, np.zeros((6, 6, 3)), square), wanted)


def test_a_given_mask_is_kept_to_and_all_bands_count() -> None:
    normals, depth, albedo, camera = ball()
    half = np.isfinite(depth)
    half[:, :48] = False
    bands = {BAND: normals, 655.0: np.full_like(normals, np.nan)}
    out = shape({}, bands, dict.fromkeys(bands, albedo), camera=camera, mask=half)["depth_mm"]
    assert not np.isfinite(out[:, :48]).any()
    assert np.isfinite(out).sum() > 0.9 * half.sum()


def test_normals_of_a_ball_integrate_to_it() -> None:
    normals, depth, albedo, camera = ball()
    out = shape({}, {BAND: normals}, {BAND: albedo}, camera=camera)["depth_mm"]
    known = np.isfinite(out) & np.isfinite(depth)
    assert known.sum() > 0.9 * np.isfinite(depth).sum()
    # the distance is set, not measured: perspective makes the body larger in proportion
    scale = np.median(depth[known]) / np.median(out[known])
    off = scale * out[known] - depth[known]
    # one pixel is 2.1 mm here, and the rim is all slope; 1 % of the radius is what the field calls good
    assert np.abs(off - off.mean()).mean() < 0.01 * RADIUS_MM
    assert np.median(out[known]) == pytest.approx(890.0, rel=1e-5)


def test_nothing_to_integrate_is_refused() -> None:
    normals, _, albedo, camera = ball()
    with pytest.raises(KernelError, match="only 0 pixels of the subject have normals"):
        shape({}, {BAND: np.full_like(normals, np.nan)}, {BAND: albedo}, camera=camera)
    with pytest.raises(KernelError, match="no point of the subject has a depth"):
        shape({0: np.full(albedo.shape, np.nan, np.float32)}, {BAND: normals}, {BAND: albedo}, camera=camera)

"""Height maps against bodies whose depth is known."""

import numpy as np
import pytest

from dag.stage import StageError
from stages.pinhole import Pinhole
from stages.shape import shape
from tests.scenes import light_places, near_ball

RADIUS_MM = 80.0


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
    _, depth, albedo, camera = ball()
    found = np.asarray(depth, np.float32)
    found.flags.writeable = False
    out = shape([found], [], [albedo], camera=camera)["depth_mm"]
    np.testing.assert_array_equal(out, found)


def test_normals_of_a_ball_integrate_to_it() -> None:
    normals, depth, albedo, camera = ball()
    out = shape([], [normals], [albedo], camera=camera)["depth_mm"]
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
    with pytest.raises(StageError, match="only 0 pixels of the subject have normals"):
        shape([], [np.full_like(normals, np.nan)], [albedo], camera=camera)
    with pytest.raises(StageError, match="no point of the subject has a depth"):
        shape([np.full(albedo.shape, np.nan, np.float32)], [normals], [albedo], camera=camera)

"""Shading by distant lights by hand, and shadows of a step."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lightstage.kernels.appearance.distant_lights import DistantLight
from lightstage.kernels.appearance.shading import cast_shadows, shade
from lightstage.kernels.surface.pinhole import Pinhole


def test_lambert_by_hand() -> None:
    normal = np.array([[0.0, 0.6], [0.0, 0.0], [1.0, 0.8]], np.float32)[:, None]
    normal.flags.writeable = False
    lights = (DistantLight(0, 0, 2.0), DistantLight(-90, 0, 1.0))
    # the second light is to the left: behind a surface that faces right
    np.testing.assert_allclose(shade(normal, lights), [[2.0, 1.6]], atol=1e-6)
    seen = np.array([[[0.5, 1.0]], [[1.0, 1.0]]], np.float32)
    np.testing.assert_allclose(shade(normal, lights, seen), [[1.0, 1.6]], atol=1e-6)


@given(st.floats(-180, 180), st.floats(-90, 90), st.floats(0.01, 50))
def test_light_adds_and_scales(azimuth: float, elevation: float, gain: float) -> None:
    random = np.random.default_rng(0)
    normal = random.normal(size=(3, 4, 5)).astype(np.float32)
    normal /= np.linalg.norm(normal, axis=0)
    one, other = DistantLight(azimuth, elevation, 1.0), DistantLight(20, 30, 1.0)
    both = shade(normal, (one._replace(strength=gain), other))
    np.testing.assert_allclose(both, gain * shade(normal, (one,)) + shade(normal, (other,)), rtol=1e-4, atol=1e-5)


def test_a_step_casts_its_shadow_to_the_far_side() -> None:
    camera = Pinhole(
        (60, 80), (400.0, 400.0, 39.5, 29.5), (0.0,) * 5, np.diag([1.0, -1, -1]), np.array([0, 0, 900.0])
    )
    depth = np.full((60, 80), 900.0)
    depth[:, 35:45] = 870.0
    depth[:, 78:] = np.nan
    left, right = cast_shadows(depth, camera, (DistantLight(-45, 0, 1), DistantLight(45, 0, 1)))
    # 30 mm high under light of 45 degrees: a shadow of 30 mm, 13 pixels
    assert left[30, 47:55].max() < 0.1
    assert left[30, 25:33].min() > 0.9
    assert right[30, 25:33].max() < 0.1
    assert right[30, 62:70].min() > 0.9
    assert (left[:, 79] == 1).all()

"""Shading by distant lights, and the shadows that they cast."""

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lightstage.kernels.appearance.distant_lights import DistantLight
from lightstage.kernels.appearance.shading import cast_shadows, shade
from lightstage.kernels.surface.pinhole import Pinhole


def normals_of(*vectors: tuple[float, float, float]) -> Any:
    """(xyz, 1, x) unit vectors."""
    rows = np.array(vectors, np.float32).T
    return (rows / np.linalg.norm(rows, axis=0))[:, None, :]


@given(st.floats(-80, 80), st.floats(-80, 80), st.floats(0.1, 3))
def test_lights_add_up(azimuth: float, elevation: float, strength: float) -> None:
    normal = normals_of((0, 0, 1), (1, 0, 1), (0, -1, 1))
    one, other = DistantLight(azimuth, elevation, strength), DistantLight(20, -10, 1.0)
    np.testing.assert_allclose(
        shade(normal, (one, other)), shade(normal, (one,)) + shade(normal, (other,)), rtol=1e-5, atol=1e-6
    )


def test_a_wall_casts_its_shadow_to_the_far_side_only() -> None:
    """A plane at 900 mm with a wall 20 mm high in its middle, the light 45 degrees from the left: the shadow is as
    long as the wall is high, 20 pixels of 1 mm. The march's first step and slack cost about 3 of them."""
    camera = Pinhole(
        (40, 120), (900.0, 900.0, 59.5, 19.5), (0, 0, 0, 0, 0), np.diag([1.0, -1, -1]), np.array([0, 0, 900.0])
    )
    depth = np.full((40, 120), 900.0, np.float32)
    depth[:, 50:54] = 880
    seen = cast_shadows(depth, camera, (DistantLight(-45, 0, 1),))[0, 10]
    assert seen[:48].min() == 1
    assert seen[56:69].max() < 0.5
    assert seen[80:].min() == 1

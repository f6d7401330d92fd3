"""One light at a time: least squares, saturated pictures, rotations."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.kernels.normals import one_light
from tests.scenes import angle_deg, decoded, sphere_normals

# int16 steps of 1/32767 leave at most 0.002 degrees; float32 arithmetic less
QUANTISED = 0.004


@settings(max_examples=25, deadline=None)
@given(st.permutations(list(range(5))), st.integers(0, 2**20))
def test_one_light_at_a_time_is_exact_and_does_not_mind_the_order(order: list[int], seed: int) -> None:
    generator = np.random.default_rng(seed)
    lights = generator.standard_normal((5, 3)) + np.array([0, 0, 3.0])
    truth = generator.standard_normal((3, 4, 4)) * 0.2 + np.array([0, 0, 1.0])[:, None, None]
    albedo = generator.uniform(0.5, 2, (4, 4))
    unit = truth / np.linalg.norm(truth, axis=0)
    images = [(albedo * np.einsum("a,ayx->yx", light, unit)).astype(np.float32) for light in lights]
    out = one_light.solve([images[i] for i in order], lights[order])
    assert angle_deg(decoded(out.normal), unit).max() < 0.05  # float32 through a pseudo-inverse
    np.testing.assert_allclose(out.constant, albedo, rtol=1e-3)


def test_one_light_at_a_time_does_without_saturated_pictures() -> None:
    truth, mask = sphere_normals(24)
    lights = np.array([[0, 0, 1.0], [0.5, 0, 1], [0, 0.5, 1], [-0.5, -0.3, 1], [0.3, -0.5, 1]])
    images = [np.einsum("a,ayx->yx", light, truth).astype(np.float32) for light in lights]
    images[1][5:15, 5:15] = np.nan
    images[3][10:20, 10:20] = np.nan
    out = one_light.solve(images, lights)
    assert angle_deg(decoded(out.normal), truth)[mask].max() < 0.05
    images[0][0, 0] = images[2][0, 0] = images[1][0, 0] = np.nan
    assert not one_light.solve(images, lights).valid[0, 0]


def test_rotating_lights_and_surface_together_rotates_the_normals() -> None:
    truth, mask = sphere_normals(24)
    a = np.radians(20)
    rotation = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    lights = np.array([[0, 0, 1.0], [0.5, 0, 1], [0, 0.5, 1], [-0.5, -0.3, 1]])
    images = [np.einsum("a,ayx->yx", light, truth).astype(np.float32) for light in lights]
    one = decoded(one_light.solve(images, lights).normal)
    other = decoded(one_light.solve(images, lights @ rotation.T).normal)
    rotated = np.einsum("ab,byx->ayx", rotation, one)
    assert angle_deg(other, rotated)[mask].max() < 0.02

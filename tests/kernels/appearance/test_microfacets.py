"""The lobe and what light shows of it: closed forms, the limits of narrow and wide, what norms do."""

import numpy as np
import pytest

from lightstage.kernels.appearance.microfacets import at_normal_incidence, lobe, response, shines, sphere_response
from lightstage.kernels.normals.near_light import Lights
from tests.scenes import LIGHT_MM, light_places

INDEX = 1.4


def rig() -> Lights:
    places, drive = light_places()
    return Lights(places, drive, np.ones(len(places)))


def test_head_on_by_hand() -> None:
    # pi D = 1 / a^2, both masking terms are 2, R = ((n - 1) / (n + 1))^2
    assert lobe(1.0, 1.0, 1.0, 1.0, 0.5, 1.5) == pytest.approx(0.04 / (4 * 0.25))
    assert at_normal_incidence(1.5) == pytest.approx(0.04)


def test_fresnel_at_brewsters_angle_and_grazing() -> None:
    """At Brewster's angle one polarisation is gone and the other has ((n^2 - 1) / (n^2 + 1))^2."""
    c = 1 / np.sqrt(1 + INDEX**2)
    brewster = 0.5 * ((INDEX**2 - 1) / (INDEX**2 + 1)) ** 2
    shape = lobe(0.7, 0.7, 1.0, 1.0, 0.3, INDEX) / at_normal_incidence(INDEX)
    assert lobe(0.7, 0.7, 1.0, c, 0.3, INDEX) / shape == pytest.approx(brewster, rel=1e-9)
    assert lobe(0.7, 0.7, 1.0, 0.0, 0.3, INDEX) / shape == pytest.approx(1, rel=1e-9)


def test_light_from_below_is_not_seen() -> None:
    assert lobe(-0.1, 0.8, 0.5, 0.5, 0.3, INDEX) == 0


def test_reciprocity() -> None:
    """Radiance per light that arrives on the surface is the same with light and camera changed over."""
    there = lobe(0.4, 0.9, 0.8, 0.7, 0.3, INDEX) / 0.4
    assert lobe(0.9, 0.4, 0.8, 0.7, 0.3, INDEX) / 0.9 == pytest.approx(there)


def test_a_narrow_lobe_under_a_sphere_of_light_is_a_mirror() -> None:
    s, norm = sphere_response(np.array([1.0, 0.7]), np.array([0.05, 0.1]), INDEX)
    # the lobe's own width: a^2 of the energy is masked, and the quadrature has 400 rings
    assert s[:, 0] == pytest.approx(at_normal_incidence(INDEX), rel=0.03)
    # a mirror has 1/2; the centroid of a lobe this wide falls short by about a^2 (2 - 2 ln a)
    assert (norm > 0.5 - 0.01 * (2 - 2 * np.log(0.1))).all()
    assert (norm < 0.5).all()


def test_the_norm_falls_with_the_width_and_not_with_power() -> None:
    widths = np.array([0.1, 0.2, 0.3, 0.5])
    _, norm = sphere_response(np.array([1.0, 0.6]), widths, INDEX)
    assert (np.diff(norm, axis=0) < -0.005).all()
    lights = rig()
    normal, point, view = np.array([[0.0, 0.6, 0.8]]), np.array([[10.0, 20.0, 30.0]]), np.array([[0.0, 0.0, 1.0]])
    strong = Lights(lights.position, lights.drive, 3 * lights.power)
    s, m = response(normal, point, view, lights, widths, INDEX)
    more, longer = response(normal, point, view, strong, widths, INDEX)
    np.testing.assert_allclose(more, 3 * s)
    np.testing.assert_allclose(longer, 3 * m)


def test_constant_light_is_the_sum_of_all_lights_and_shadows_take_theirs() -> None:
    lights = rig()
    generator = np.random.default_rng(0)
    normal = generator.normal(size=(5, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    points, view = generator.normal(size=(5, 3)) * 40, np.tile([0.0, 0.0, 1.0], (5, 1))
    seen = generator.random((5, len(lights.position))).astype(np.float32)
    each = shines(normal, points, view, np.full(5, 0.3), lights.position, LIGHT_MM, INDEX)
    s, m = response(normal, points, view, lights, np.array([0.3]), INDEX, seen)
    scale = (lights.distance / LIGHT_MM) ** 2
    np.testing.assert_allclose(s[0], (each * seen).sum(axis=1) * scale, rtol=1e-5)  # float32 sums
    np.testing.assert_allclose(m[0], (each * seen) @ lights.drive * scale, rtol=1e-5, atol=1e-9)

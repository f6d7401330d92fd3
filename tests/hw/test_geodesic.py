"""Where the lights are, against an icosahedron whose vertices and edges are written out here."""

from itertools import combinations

import numpy as np
import pytest

from lightstage.hw.errors import RigError
from lightstage.hw.geodesic import icosahedron, light_positions

GOLDEN = (1 + 5**0.5) / 2
# the textbook's: cyclic permutations of (0, +-1, +-phi), edges of length 2
TEXTBOOK = np.array(
    [np.roll((0.0, a, b * GOLDEN), shift) for shift in range(3) for a in (-1, 1) for b in (-1, 1)]
) / np.hypot(1, GOLDEN)


def distances(points: np.ndarray) -> np.ndarray:
    """Between all pairs, rising: what no rotation, numbering or mirror changes."""
    return np.sort([np.linalg.norm(a - b) for a, b in combinations(points, 2)])


def midpoints() -> np.ndarray:
    """Of the textbook's 30 edges, on the sphere."""
    edge = 2 / np.hypot(1, GOLDEN)
    middles = [(a + b) / 2 for a, b in combinations(TEXTBOOK, 2) if np.linalg.norm(a - b) < 1.01 * edge]
    return np.array(middles) / np.linalg.norm(middles, axis=1, keepdims=True)


def test_the_icosahedron_is_the_textbooks_turned() -> None:
    vertices, faces = icosahedron()
    np.testing.assert_allclose(distances(vertices), distances(TEXTBOOK), atol=1e-12)
    np.testing.assert_allclose(vertices[0], [0, 1, 0])
    # 20 triangles, each of three edges, that use every vertex five times and look outward
    assert np.bincount(faces.ravel()).tolist() == [5] * 12
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    edge = 2 / np.hypot(1, GOLDEN)
    for p, q in ((a, b), (b, c), (c, a)):
        np.testing.assert_allclose(np.linalg.norm(p - q, axis=1), edge)
    assert (np.abs(np.einsum("fi,fi->f", np.cross(b - a, c - a), a + b + c)) > 1).all()


def test_frequency_two_is_its_vertices_and_the_middles_of_its_edges() -> None:
    wanted = np.concatenate([TEXTBOOK, midpoints()])
    assert len(wanted) == 42
    np.testing.assert_allclose(distances(light_positions(2, left_out=())), distances(wanted), atol=1e-9)


@pytest.mark.parametrize(("frequency", "count"), [(1, 12), (2, 42), (3, 92), (4, 162)])
def test_counts_are_ten_f_squared_plus_two(frequency: int, count: int) -> None:
    positions = light_positions(frequency, left_out=())
    assert positions.shape == (count, 3)
    np.testing.assert_allclose(np.linalg.norm(positions, axis=1), 1)
    np.testing.assert_allclose(positions.mean(axis=0), 0, atol=1e-9)
    np.testing.assert_allclose(positions[0], [0, 1, 0], atol=1e-9)


def test_the_thesis_rig_lacks_the_lowest_light() -> None:
    positions = light_positions()
    assert len(positions) == 41
    assert positions[:, 1].min() > -0.9


def test_lights_are_numbered_by_falling_height_then_by_azimuth_from_the_camera() -> None:
    positions = light_positions()
    # the middle of the edge towards the camera (icosahedron: sqrt(1 - 0.85065^2) = 0.52573)
    np.testing.assert_allclose(positions[1], [0, 0.85065081, 0.52573111], atol=1e-7)
    height = np.round(positions[:, 1], 6)
    assert (np.diff(height) <= 0).all()
    azimuth = np.round(np.mod(np.degrees(np.arctan2(positions[:, 0], positions[:, 2])), 360 - 1e-6), 4)
    for level in np.unique(height):
        ring = azimuth[height == level]
        assert (np.diff(ring) > 0).all(), level
    # a ring of five under the pole: 72 degrees apart, the second towards +x
    np.testing.assert_allclose(azimuth[1:6], [0, 72, 144, 216, 288], atol=1e-3)


def test_any_light_can_be_left_out_and_no_other() -> None:
    everything = light_positions(2, left_out=())
    np.testing.assert_array_equal(light_positions(2, left_out=[0, 41]), everything[1:41])
    with pytest.raises(RigError, match="light 42 cannot be left out: frequency 2 has lights 0 to 41"):
        light_positions(2, left_out=[42])
    with pytest.raises(RigError, match="does not exist"):
        light_positions(0)

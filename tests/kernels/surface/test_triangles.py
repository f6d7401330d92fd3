"""A height map as triangles: where they are, how they lie, and where the surface is broken."""

from typing import Any

import numpy as np
import pytest

from lightstage.kernels.errors import KernelError
from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.kernels.surface.triangles import smooth_frames, tangent_space, triangulate
from tests.scenes import light_places, near_ball

RADIUS_MM = 80.0


@pytest.fixture(scope="module")
def ball() -> tuple[np.ndarray, np.ndarray, Pinhole]:
    lights, drive = light_places()
    _, normals, depth, camera = near_ball(lights, drive, size=64, radius_mm=RADIUS_MM)
    return normals, depth, Pinhole.of(camera, depth.shape)


def test_faces_look_at_the_camera_and_are_where_the_body_is(ball: Any) -> None:
    _, depth, camera = ball
    surface = triangulate(depth, camera)
    np.testing.assert_allclose(np.linalg.norm(surface.vertices, axis=1), RADIUS_MM, rtol=1e-9)
    corners = surface.vertices[surface.faces]
    turned = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", turned, camera.centre - corners.mean(axis=1)) > 0).all()
    assert (surface.vertices[:, 1][surface.pixels[:, 0] < 20] > 0).all()  # up is up
    assert (np.diff(surface.uv[surface.pixels[:, 0] == 32], axis=0)[:, 0] > 0).all()


def test_no_triangle_spans_a_step() -> None:
    camera = Pinhole(
        (8, 8), (100.0, 100.0, 3.5, 3.5), (0.0,) * 5, np.diag([1.0, -1.0, -1.0]), np.array([0, 0, 900.0])
    )
    depth = np.full((8, 8), 900.0)
    depth[:, 4:] = 1200.0
    surface = triangulate(depth, camera)
    assert len(surface.faces) == 2 * 7 * (3 + 3)
    with pytest.raises(KernelError, match="no two neighbouring points"):
        triangulate(np.full((8, 8), np.nan), camera)


def test_a_break_is_kept_open_at_every_step() -> None:
    camera = Pinhole(
        (9, 9), (100.0, 100.0, 4.0, 4.0), (0.0,) * 5, np.diag([1.0, -1.0, -1.0]), np.array([0, 0, 900.0])
    )
    depth = np.full((9, 9), 900.0)
    edge = np.zeros((9, 9), np.uint8)
    edge[:, 3] = 1  # between columns 3 and 4
    edge[6, 0] = 2  # between rows 6 and 7 of column 0
    surface = triangulate(depth, camera, edge=edge)
    across = np.sort(surface.pixels[surface.faces][..., 1], axis=1)
    assert not ((across[:, 0] <= 3) & (across[:, 2] >= 4)).any()
    # eight by eight squares; a column of them is cut, and the triangle with the side that is broken below
    assert len(surface.faces) == 2 * 8 * 7 - 1
    # of two by two squares of four pixels each, the cut goes through both on the left
    coarse = triangulate(depth, camera, every=4, edge=edge)
    assert len(coarse.faces) == 4
    assert coarse.pixels[coarse.faces][..., 1].min() == 4


@pytest.mark.parametrize("every", [1, 4])
def test_the_smooth_surface_in_its_own_frame_is_flat(ball: Any, every: int) -> None:
    normals, depth, camera = ball
    frames, mask = smooth_frames(depth, camera, every=every), np.isfinite(depth)
    np.testing.assert_allclose(np.einsum("yxi,yxi->yx", frames.normal, frames.tangent)[mask], 0, atol=1e-9)
    assert (frames.tangent[mask][:, 0] > 0).all()  # to the right, at the rim as well
    own = tangent_space(frames.normal, frames)
    np.testing.assert_allclose(own[mask][:, 2], 1, atol=1e-9)
    # leaning to the right and up is +x and +y in the map, whatever the body's own slope
    tilted = np.moveaxis(normals, 0, 2) + np.array([0.2, 0.1, 0.0])
    tilted /= np.linalg.norm(tilted, axis=2, keepdims=True)
    middle = tangent_space(tilted, frames)[28:36, 28:36]
    assert (middle[..., 0] > 0.1).all()
    assert (middle[..., 1] > 0.05).all()

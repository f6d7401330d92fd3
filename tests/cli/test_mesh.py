"""Meshes, read back by trimesh and, for glTF, by pygltflib."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from cli.mesh import smooth_normals, surface_of, tangent_space, write_mesh
from stages.pinhole import Pinhole
from store.errors import RequestError
from tests.scenes import light_places, near_ball

RADIUS_MM = 80.0


@pytest.fixture(scope="module")
def ball() -> tuple[np.ndarray, np.ndarray, Pinhole]:
    lights, drive = light_places()
    _, normals, depth, camera = near_ball(lights, drive, size=64, radius_mm=RADIUS_MM)
    return normals, depth, Pinhole.of(camera, depth.shape)


def test_faces_look_at_the_camera_and_are_where_the_body_is(ball: Any) -> None:
    _, depth, camera = ball
    surface = surface_of(depth, camera)
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
    surface = surface_of(depth, camera)
    assert len(surface.faces) == 2 * 7 * (3 + 3)
    with pytest.raises(RequestError, match="no two neighbouring points"):
        surface_of(np.full((8, 8), np.nan), camera)


def test_the_smooth_surface_in_its_own_frame_is_flat(ball: Any) -> None:
    normals, depth, camera = ball
    points, mask = camera.points(depth), np.isfinite(depth)
    own = tangent_space(smooth_normals(points, mask), points, mask)
    np.testing.assert_allclose(own[mask][:, 2], 1, atol=1e-9)
    # leaning to the right and up is +x and +y in the map, whatever the body's own slope
    tilted = np.moveaxis(normals, 0, 2) + np.array([0.2, 0.1, 0.0])
    tilted /= np.linalg.norm(tilted, axis=2, keepdims=True)
    middle = tangent_space(tilted, points, mask)[28:36, 28:36]
    assert (middle[..., 0] > 0.1).all()
    assert (middle[..., 1] > 0.05).all()


@pytest.mark.parametrize(("form", "scale"), [("ply", 1.0), ("obj", 1.0), ("glb", 0.001)])
def test_read_back(ball: Any, tmp_path: Path, form: str, scale: float) -> None:
    _, depth, camera = ball
    surface = surface_of(depth, camera, every=2)
    colour = np.full((*depth.shape, 3), (0.5, 0.2, 0.1))
    files = write_mesh(tmp_path / f"ball.{form}", surface, base_colour=colour)
    assert not list(tmp_path.glob(".*"))
    back = trimesh.load_mesh(files[0], process=False)
    np.testing.assert_allclose(
        back.bounds, scale * np.stack([surface.vertices.min(0), surface.vertices.max(0)]), rtol=1e-4
    )
    assert len(back.faces) == len(surface.faces)
    assert (back.face_normals @ [0, 0, 1] > 0).mean() > 0.99
    # linear 0.5, 0.2, 0.1 are 188, 124, 89 in sRGB's code
    if form == "ply":
        assert tuple(back.visual.vertex_colors[0][:3]) == (188, 124, 89)
    else:
        image = back.visual.material.baseColorTexture if form == "glb" else back.visual.material.image
        assert image.convert("RGB").getpixel((0, 0)) == (188, 124, 89)


def test_glb_is_gltf_2(ball: Any, tmp_path: Path) -> None:
    from pygltflib import GLTF2

    normals, depth, camera = ball
    bumps = tangent_space(np.moveaxis(normals, 0, 2), camera.points(depth), np.isfinite(depth))
    (file,) = write_mesh(tmp_path / "ball.glb", surface_of(depth, camera), normal_map=bumps)
    opened = GLTF2().load(str(file))
    assert opened.asset.version == "2.0"
    (primitive,) = opened.meshes[0].primitives
    assert {"POSITION", "NORMAL", "TEXCOORD_0"} <= {
        k for k, v in vars(primitive.attributes).items() if v is not None
    }
    (material,) = opened.materials
    assert material.normalTexture is not None
    assert material.pbrMetallicRoughness.metallicFactor == 0
    high = opened.accessors[primitive.attributes.POSITION].max
    assert high[2] == pytest.approx(RADIUS_MM / 1000, rel=0.01)


def test_the_command(lightstage: Callable[..., Any], tmp_path: Path) -> None:
    assert lightstage("demo", "--size", "96x72", "--bands", "576", "--session", "small").code == 0
    assert lightstage("run", "shape", "--session", "small").code == 0
    done = lightstage(
        "export", "shape", "--session", "small", "--to", tmp_path / "out", "--format", "glb", "--json"
    )
    (file,) = done.json["files"]
    size = trimesh.load_mesh(file).extents * 1000
    assert 100 < size[0] < 400  # a head, in millimetres
    assert 100 < size[1] < 400
    wrong = lightstage("export", "stack", "--session", "small", "--to", tmp_path / "out", "--format", "ply")
    assert (wrong.code, "node 'stack' has no depth" in wrong.err) == (2, True)
    assert (
        lightstage(
            "export", "shape", "--session", "small", "--to", tmp_path / "out", "--format", "png8", "--every", "2"
        ).code
        == 2
    )

"""Meshes, read back by trimesh and, for glTF, by pygltflib."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from pygltflib import GLTF2

from lightstage.cli.mesh import smooth_frames, surface_of, tangent_space, write_glb, write_mesh
from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.store.errors import RequestError
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


def test_a_break_is_kept_open_at_every_step() -> None:
    camera = Pinhole(
        (9, 9), (100.0, 100.0, 4.0, 4.0), (0.0,) * 5, np.diag([1.0, -1.0, -1.0]), np.array([0, 0, 900.0])
    )
    depth = np.full((9, 9), 900.0)
    edge = np.zeros((9, 9), np.uint8)
    edge[:, 3] = 1  # between columns 3 and 4
    edge[6, 0] = 2  # between rows 6 and 7 of column 0
    surface = surface_of(depth, camera, edge=edge)
    across = np.sort(surface.pixels[surface.faces][..., 1], axis=1)
    assert not ((across[:, 0] <= 3) & (across[:, 2] >= 4)).any()
    # eight by eight squares; a column of them is cut, and the triangle with the side that is broken below
    assert len(surface.faces) == 2 * 8 * 7 - 1
    # of two by two squares of four pixels each, the cut goes through both on the left
    coarse = surface_of(depth, camera, every=4, edge=edge)
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


def test_a_renderer_gets_the_measured_normals_back(ball: Any, tmp_path: Path) -> None:
    """Shade as glTF says, n = t x + (n x t) w y + n z with what is in the file, at the vertices."""
    normals, depth, camera = ball
    measured = np.moveaxis(normals, 0, 2) + 0.15 * np.sin(np.arange(64))[:, None, None]
    measured /= np.linalg.norm(measured, axis=2, keepdims=True)
    surface = surface_of(depth, camera, every=3)
    bumps = tangent_space(measured, smooth_frames(depth, camera, every=3))
    write_glb(tmp_path / "ball.glb", surface, normal_map=bumps)
    read = Glb(tmp_path / "ball.glb")
    normal, tangent, uv = (read.array(name) for name in ("NORMAL", "TANGENT", "TEXCOORD_0"))
    picture = np.asarray(read.picture(read.material.normalTexture.index))
    row, column = (np.floor(uv[:, i] * n).astype(int) for i, n in ((1, 64), (0, 64)))
    x, y, z = np.moveaxis(picture[row, column] / 127.5 - 1, 1, 0)[..., None]
    shaded = tangent[:, :3] * x + np.cross(normal, tangent[:, :3]) * tangent[:, 3:] * y + normal * z
    apart = np.degrees(np.arccos(np.clip(np.sum(_unit(shaded) * measured[row, column], axis=1), -1, 1)))
    seen = bumps[row, column, 2] < 1  # beyond the rim of what faces the camera there is no bump
    assert seen.mean() > 0.95
    assert apart[seen].max() < 0.5  # 8 bits are steps of 0.45 degrees


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


class Glb:
    """A GLB's first mesh as pygltflib reads it."""

    def __init__(self, file: Path) -> None:
        self.gltf = GLTF2().load(str(file))
        (self.primitive,) = self.gltf.meshes[0].primitives
        (self.material,) = self.gltf.materials

    def _bytes(self, view: int) -> bytes:
        at = self.gltf.bufferViews[view]
        return self.gltf.binary_blob()[at.byteOffset : at.byteOffset + at.byteLength]

    def array(self, name: str) -> np.ndarray:
        accessor = self.gltf.accessors[getattr(self.primitive.attributes, name)]
        width = {"VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor.type]
        return np.frombuffer(self._bytes(accessor.bufferView), np.float32)[: accessor.count * width].reshape(
            -1, width
        )

    def picture(self, texture: int) -> Image.Image:
        source = self.gltf.images[self.gltf.textures[texture].source]
        assert source.mimeType == "image/png"
        return Image.open(io.BytesIO(self._bytes(source.bufferView)))


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
    normals, depth, camera = ball
    surface = surface_of(depth, camera)
    colour = np.full((64, 64, 3), 0.5)
    colour[:32] = np.nan
    write_glb(
        tmp_path / "ball.glb",
        surface,
        base_colour=colour,
        normal_map=tangent_space(np.moveaxis(normals, 0, 2), smooth_frames(depth, camera)),
        metallic_roughness=np.full((64, 64, 2), (0.0, 0.4)),
        specular=np.full((64, 64), 0.8),
    )
    read = Glb(tmp_path / "ball.glb")
    assert read.gltf.asset.version == "2.0"
    assert read.gltf.extensionsUsed == ["KHR_materials_specular"]
    assert not read.gltf.extensionsRequired
    high = read.gltf.accessors[read.primitive.attributes.POSITION].max
    assert high[2] == pytest.approx(RADIUS_MM / 1000, rel=0.01)
    np.testing.assert_allclose(read.array("POSITION"), surface.vertices / 1000, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(read.array("TANGENT")[:, :3], axis=1), 1, atol=1e-6)
    assert (read.array("TANGENT")[:, 3] == 1).all()
    plain = read.material.pbrMetallicRoughness
    assert (plain.metallicFactor, plain.roughnessFactor) == (1, 1)  # times the map
    # sRGB's code of 0.5 is 188, also where the colour is not known: filled from what is nearest
    assert read.picture(plain.baseColorTexture.index).getextrema() == ((188, 188),) * 3
    # green is roughness, blue metal, both linear
    assert read.picture(plain.metallicRoughnessTexture.index).getpixel((5, 5)) == (255, 102, 0)
    shine = read.material.extensions["KHR_materials_specular"]["specularTexture"]["index"]
    assert read.picture(shine).getpixel((5, 5)) == (255, 255, 255, 204)
    assert trimesh.load_mesh(tmp_path / "ball.glb").visual.material.roughnessFactor == 1


@pytest.mark.parametrize("space", ["tangent", "object"])
def test_obj_names_what_lies_beside_it(ball: Any, tmp_path: Path, space: str) -> None:
    normals, depth, camera = ball
    made = write_mesh(
        tmp_path / "ball.obj",
        surface_of(depth, camera),
        base_colour=np.full((64, 64, 3), 0.5),
        normal_map=np.moveaxis(normals, 0, 2),
        space=space,
    )
    assert (
        {f.name for f in made}
        == {"ball.obj", "ball.mtl", "ball.png", "ball_normal.png"}
        == {f.name for f in tmp_path.iterdir()}
    )
    assert "mtllib ball.mtl" in made[0].read_text()
    material = (tmp_path / "ball.mtl").read_text()
    assert "map_Kd ball.png" in material
    assert ("norm ball_normal.png" in material) == (space == "tangent")
    # the middle faces the camera: (0, 0, 1) is (128, 128, 255), give or take the pixel's own tilt of 1.1 degrees
    middle = np.array(Image.open(tmp_path / "ball_normal.png"))[32, 32].astype(int)
    assert np.abs(middle - (128, 128, 255)).max() <= 3


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
    every = ("export", "shape", "--session", "small", "--to", tmp_path / "none")
    for words, said in (
        (("--format", "ply", "--normal-map", "tangent"), "PLY has no textures"),
        (("--format", "glb", "--normal-map", "object"), "glTF knows tangent space alone"),
        (("--format", "png8", "--normal-map", "object"), "only a mesh has it"),
        (("--format", "obj", "--every", "0"), "a step of 1 or more"),
    ):
        refused = lightstage(*every, *words)
        assert (refused.code, said in refused.err) == (2, True), refused.err
    assert not (tmp_path / "none").exists()
    wrong = lightstage("export", "stack", "--session", "small", "--to", tmp_path / "out", "--format", "ply")
    assert (wrong.code, "node 'stack' has no depth" in wrong.err) == (2, True)
    assert (
        lightstage(
            "export", "shape", "--session", "small", "--to", tmp_path / "out", "--format", "png8", "--every", "2"
        ).code
        == 2
    )


def test_one_command_from_the_capture_to_the_mesh(lightstage: Callable[..., Any], tmp_path: Path) -> None:
    assert lightstage("demo", "--size", "96x72", "--bands", "576", "--session", "small").code == 0
    done = lightstage("shape", "small", "--json", "--every", "2")
    assert done.code == 0, done.err
    (file,) = done.json["files"]
    assert Path(file).parent.name == "small_shape"
    scene = GLTF2().load(file)
    assert scene.materials[0].pbrMetallicRoughness.baseColorTexture is not None
    again = Path(file).read_bytes()
    assert lightstage("shape", "small", "--every", "2").code == 0
    assert Path(file).read_bytes() == again
    for words, said in (
        (("--every", "0"), "a step of 1 or more"),
        (("--format", "ply", "--normal-map", "object"), "PLY has no textures"),
    ):
        refused = lightstage("shape", "small", "--to", tmp_path / "none", *words)
        assert (refused.code, said in refused.err) == (2, True), refused.err
    assert not (tmp_path / "none").exists()


@pytest.mark.slow
def test_blender_opens_all_formats(ball: Any, tmp_path: Path) -> None:
    """Bounds, faces towards the camera, colour spaces, and tangents that its own MikkTSpace agrees with."""
    bpy = pytest.importorskip("bpy", reason="Blender as a package (pip install bpy) is not installed")
    _, depth, camera = ball
    surface = surface_of(depth, camera)
    frames = smooth_frames(depth, camera)
    colour, bumps = np.full((64, 64, 3), 0.5), tangent_space(frames.normal, frames)
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    load = {
        "glb": lambda file: bpy.ops.import_scene.gltf(filepath=file),
        "obj": lambda file: bpy.ops.wm.obj_import(filepath=file, forward_axis="NEGATIVE_Z", up_axis="Y"),
        "ply": lambda file: bpy.ops.wm.ply_import(filepath=file, forward_axis="NEGATIVE_Z", up_axis="Y"),
    }
    for form, open_file in load.items():
        (file, *_) = write_mesh(
            tmp_path / f"ball.{form}", surface, base_colour=colour, normal_map=bumps, space="tangent"
        )
        bpy.ops.wm.read_factory_settings(use_empty=True)
        open_file(str(file))
        (body,) = [thing for thing in bpy.data.objects if thing.type == "MESH"]
        place = np.array(body.matrix_world)
        points = np.array([v.co for v in body.data.vertices]) @ place[:3, :3].T + place[:3, 3]
        # Blender's z is up: x, y, z there are x, -z, y here
        scale = 0.001 if form == "glb" else 1.0
        world = points @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0.0]]).T
        np.testing.assert_allclose(world.min(axis=0), scale * low, atol=scale * 0.01, err_msg=form)
        np.testing.assert_allclose(world.max(axis=0), scale * high, atol=scale * 0.01, err_msg=form)
        turned = np.array([face.normal for face in body.data.polygons]) @ place[:3, :3].T
        assert (turned[:, 1] < 0).mean() > 0.99, form
        if form == "glb":
            spaces = {i.colorspace_settings.name for i in bpy.data.images}
            assert spaces == {"sRGB", "Non-Color"}
            body.data.calc_tangents()
            assert {loop.bitangent_sign for loop in body.data.loops} == {1.0}
            theirs = (
                np.array([loop.tangent for loop in body.data.loops])
                @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0.0]]).T
            )
            ours = surface.tangents[[loop.vertex_index for loop in body.data.loops]]
            # theirs is of triangles, ours of the blurred surface: they part where it bends within a pixel
            assert np.median(np.degrees(np.arccos(np.clip(np.sum(theirs * ours, axis=1), -1, 1)))) < 1

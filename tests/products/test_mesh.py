"""Meshes, read back by trimesh and, for glTF, by pygltflib."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import xarray
from PIL import Image

from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.kernels.surface.triangles import smooth_frames, tangent_space, triangulate
from lightstage.products.mesh import Beside, Paint, filled, mesh_files, write_meshes
from tests.readers import Glb
from tests.scenes import light_places, near_ball

RADIUS_MM = 80.0


@pytest.fixture(scope="module")
def ball() -> tuple[np.ndarray, np.ndarray, Pinhole]:
    lights, drive = light_places()
    _, normals, depth, camera = near_ball(lights, drive, size=64, radius_mm=RADIUS_MM)
    return normals, depth, Pinhole.of(camera, depth.shape)


def written(folder: Path, files: Mapping[str, bytes]) -> list[Path]:
    """The files in a folder, the mesh last."""
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return [folder / name for name in files]


def test_a_renderer_gets_the_measured_normals_back(ball: Any, tmp_path: Path) -> None:
    """Shade as glTF says, n = t x + (n x t) w y + n z with what is in the file, at the vertices."""
    normals, depth, camera = ball
    measured = np.moveaxis(normals, 0, 2) + 0.15 * np.sin(np.arange(64))[:, None, None]
    measured /= np.linalg.norm(measured, axis=2, keepdims=True)
    surface = triangulate(depth, camera, every=3)
    bumps = tangent_space(measured, smooth_frames(depth, camera, every=3))
    written(tmp_path, mesh_files("ball", "glb", surface, Paint(normal_map=bumps)))
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


@pytest.mark.parametrize(("form", "scale"), [("ply", 1.0), ("obj", 1.0), ("glb", 0.001)])
def test_read_back(ball: Any, tmp_path: Path, form: str, scale: float) -> None:
    _, depth, camera = ball
    surface = triangulate(depth, camera, every=2)
    colour = np.full((*depth.shape, 3), (0.5, 0.2, 0.1))
    files = written(tmp_path, mesh_files("ball", form, surface, Paint(colour)))
    back = trimesh.load_mesh(files[-1], process=False)
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
    surface = triangulate(depth, camera)
    colour = np.full((64, 64, 3), 0.5)
    colour[:32] = np.nan
    paint = Paint(
        colour,
        tangent_space(np.moveaxis(normals, 0, 2), smooth_frames(depth, camera)),
        np.full((64, 64, 2), (0.0, 0.4)),
        np.full((64, 64), 0.8),
    )
    written(tmp_path, mesh_files("ball", "glb", surface, paint))
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
    paint = Paint(np.full((64, 64, 3), 0.5), np.moveaxis(normals, 0, 2))
    made = written(tmp_path, mesh_files("ball", "obj", triangulate(depth, camera), paint, space=space))
    assert (
        {f.name for f in made}
        == {"ball.obj", "ball.mtl", "ball.png", "ball_normal.png"}
        == {f.name for f in tmp_path.iterdir()}
    )
    assert "mtllib ball.mtl" in made[-1].read_text()
    material = (tmp_path / "ball.mtl").read_text()
    assert "map_Kd ball.png" in material
    assert ("norm ball_normal.png" in material) == (space == "tangent")
    # the middle faces the camera: (0, 0, 1) is (128, 128, 255), give or take the pixel's own tilt of 1.1 degrees
    middle = np.array(Image.open(tmp_path / "ball_normal.png"))[32, 32].astype(int)
    assert np.abs(middle - (128, 128, 255)).max() <= 3


@pytest.mark.slow
def test_blender_opens_all_formats(ball: Any, tmp_path: Path) -> None:
    """Bounds, faces towards the camera, colour spaces, and tangents that its own MikkTSpace agrees with."""
    bpy = pytest.importorskip("bpy", reason="Blender as a package (pip install bpy) is not installed")
    _, depth, camera = ball
    surface = triangulate(depth, camera)
    frames = smooth_frames(depth, camera)
    colour, bumps = np.full((64, 64, 3), 0.5), tangent_space(frames.normal, frames)
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    load = {
        "glb": lambda file: bpy.ops.import_scene.gltf(filepath=file),
        "obj": lambda file: bpy.ops.wm.obj_import(filepath=file, forward_axis="NEGATIVE_Z", up_axis="Y"),
        "ply": lambda file: bpy.ops.wm.ply_import(filepath=file, forward_axis="NEGATIVE_Z", up_axis="Y"),
    }
    for form, open_file in load.items():
        (*_, file) = written(tmp_path, mesh_files("ball", form, surface, Paint(colour, bumps), space="tangent"))
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


def test_a_mesh_a_tracking_frame_with_what_there_is_beside_it(ball: Any, tmp_path: Path) -> None:
    """Reflectance is there at the first frame alone; at the second the albedo of the normals stands in for it."""
    normals, depth, camera = ball
    shape = xarray.Dataset({"depth_mm": (("tracking", "y", "x"), np.stack([depth, depth]))}, {"tracking": [3, 7]})
    results = {
        "reflectance": xarray.Dataset(
            {"reflectance": (("tracking", "band", "y", "x"), np.full((1, 1, 64, 64), 0.5))}, {"tracking": [3]}
        ),
        "normals": xarray.Dataset(
            {
                "normal": (("tracking", "band", "xyz", "y", "x"), np.stack([normals, normals])[:, None]),
                "albedo": (("tracking", "band", "y", "x"), np.full((2, 1, 64, 64), 20.0)),
            },
            {"tracking": [3, 7]},
        ),
    }
    beside = Beside(results, [0.0], {})
    names = write_meshes(tmp_path, "shape", shape, camera, beside, form="glb", every=4, space="tangent")
    assert names == ["shape_tracking0003.glb", "shape_tracking0007.glb"]
    for name, code in zip(names, (188, 231), strict=True):  # sRGB's code of 0.5 and of 0.8
        read = Glb(tmp_path / name)
        colour = read.picture(read.material.pbrMetallicRoughness.baseColorTexture.index)
        assert colour.getpixel((32, 32)) == (code,) * 3
        assert read.material.normalTexture is not None
    (bare,) = write_meshes(tmp_path, "bare", shape.isel(tracking=[0]), camera, Beside({}, [0.0], {}), form="ply")
    assert trimesh.load_mesh(tmp_path / bare).visual.kind is None


def test_a_hole_takes_the_nearest_colour_and_nothing_at_all_is_black() -> None:
    colour = np.full((2, 3, 3), np.nan)
    assert (filled(colour) == 0).all()
    colour[0, 0] = 0.25
    assert (filled(colour) == 0.25).all()

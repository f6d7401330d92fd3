"""Meshes by hand: two triangles, read back by trimesh and pygltflib."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from lightstage.formats.errors import FormatError
from lightstage.formats.meshes import Mesh, Textures, mesh_files, names_of, normal_map_space
from tests.readers import Glb

SQUARE = Mesh(
    np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0], [10, 10, 0]], float),
    np.array([[0, 1, 2], [1, 3, 2]]),
    np.tile([0.0, 0, 1], (4, 1)),
    np.tile([1.0, 0, 0], (4, 1)),
    np.array([[0, 0], [1, 0], [0, 1], [1, 1]], float),
)
COLOUR = np.full((2, 2, 3), (200, 100, 50), np.uint8)


def test_units_and_axes(tmp_path: Path) -> None:
    for form, scale in (("ply", 1.0), ("obj", 1.0), ("glb", 0.001)):
        files = mesh_files("square", form, SQUARE, Textures())
        for name, data in files.items():
            (tmp_path / name).write_bytes(data)
        back = trimesh.load_mesh(tmp_path / f"square.{form}", process=False)
        np.testing.assert_allclose(back.bounds, [[0, 0, 0], [10 * scale, 10 * scale, 0]], atol=1e-9)
        assert (back.face_normals[:, 2] > 0.99).all()


def test_the_files_are_named_beforehand_and_the_mesh_is_last() -> None:
    textures = Textures(COLOUR, COLOUR)
    for form in ("ply", "obj", "glb"):
        files = mesh_files("square", form, SQUARE, textures, space="tangent")
        assert set(files) == set(names_of("square", form))
        assert list(files)[-1] == names_of("square", form)[0] == f"square.{form}"


def test_ply_has_colours_at_its_vertices(tmp_path: Path) -> None:
    colours = np.arange(12, dtype=np.uint8).reshape(4, 3)
    (data,) = mesh_files("square", "ply", SQUARE, Textures(), colours=colours).values()
    (tmp_path / "square.ply").write_bytes(data)
    back = trimesh.load_mesh(tmp_path / "square.ply", process=False)
    np.testing.assert_array_equal(back.visual.vertex_colors[:, :3], colours)


def test_glb_has_its_tangents_and_one_roughness_without_a_map(tmp_path: Path) -> None:
    (data,) = mesh_files("square", "glb", SQUARE, Textures(COLOUR), roughness=0.6).values()
    (tmp_path / "square.glb").write_bytes(data)
    read = Glb(tmp_path / "square.glb")
    assert read.material.pbrMetallicRoughness.roughnessFactor == pytest.approx(0.6)
    assert read.material.pbrMetallicRoughness.metallicFactor == 0
    np.testing.assert_array_equal(read.array("TANGENT"), np.tile([1, 0, 0, 1], (4, 1)))
    assert read.picture(0).getpixel((0, 0)) == (200, 100, 50)
    assert not read.gltf.extensionsUsed


def test_spaces_of_normal_maps() -> None:
    assert [normal_map_space(form, None) for form in ("ply", "obj", "glb")] == [None, None, "tangent"]
    assert normal_map_space("obj", "object") == "object"
    with pytest.raises(FormatError, match="PLY has no textures"):
        normal_map_space("ply", "tangent")
    with pytest.raises(FormatError, match="glTF knows tangent space alone"):
        normal_map_space("glb", "object")

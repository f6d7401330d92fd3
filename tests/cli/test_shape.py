"""Meshes by command: from the shape that was computed, and from the capture."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import trimesh
from pygltflib import GLTF2

pytestmark = pytest.mark.slow


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


def test_another_file_in_its_place_is_not_lost(lightstage: Callable[..., Any], tmp_path: Path) -> None:
    """Its own files are made anew, with other options too; what somebody put there or painted over stays."""
    assert lightstage("demo", "--size", "96x72", "--bands", "576", "--session", "small").code == 0
    assert lightstage("shape", "small", "--every", "4", "--to", tmp_path / "out").code == 0
    file = tmp_path / "out" / "shape_tracking0000.glb"
    first = file.read_bytes()
    export = ("export", "shape", "--session", "small", "--to", tmp_path / "out", "--format", "glb")
    assert lightstage(*export, "--every", "3").code == 0
    assert file.read_bytes() != first
    file.write_bytes(b"painted over")
    for words in (export, ("shape", "small", "--to", tmp_path / "out")):
        refused = lightstage(*words)
        assert refused.code == 2
        assert f"{file} is there already and is not as export.json describes it" in refused.err
    assert file.read_bytes() == b"painted over"
    assert {path.name for path in file.parent.iterdir()} == {file.name, "export.json"}

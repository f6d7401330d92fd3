"""Maps and GLB for renderers, read back by OpenImageIO, pygltflib and trimesh."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from lightstage.kernels.appearance.colour import decode_srgb
from tests.conftest import Answer
from tests.readers import Exr, Glb
from tests.scenes import sphere_capture

pytestmark = pytest.mark.slow

Lightstage = Callable[..., Answer]
SIZE = (120, 92)


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of this file: the capture is made once."""
    return tmp_path_factory.mktemp("material") / "store"


@pytest.fixture
def head(lightstage: Lightstage, kept: Path) -> Path:
    assert lightstage("demo", "--size", "{}x{}".format(*SIZE), store=kept).code == 0
    return kept


def truth(store: Path) -> dict[str, NDArray[np.floating]]:
    with np.load(store / "sessions" / "demo" / "truth" / "ground_truth_cam1.npz") as stored:
        return {name: stored[name] for name in stored.files}


def test_maps_of_the_virtual_head(lightstage: Lightstage, head: Path, tmp_path: Path) -> None:
    to = tmp_path / "out"
    answer = lightstage("material", "demo", "--to", to, "--format", "exr", "--json", store=head)
    assert answer.code == 0, answer.err
    record = json.loads((to / "material.json").read_text())
    assert {path.name for path in to.iterdir()} == {*record["files"], "material.json"}
    maps = {name: Exr(to / name) for name in record["files"]}
    true = truth(head)
    inside = maps["mask.exr"]["Y"] == 1
    padded = maps["specular.exr"]["Y"][~inside]
    assert np.isin(padded, maps["specular.exr"]["Y"][inside]).all()  # what is nearest, and no other number
    inner = cv2.erode(true["mask"].astype(np.uint8), np.ones((3, 3))) > 0
    assert (inside != true["mask"]).sum() < (true["mask"] & ~inner).sum()  # right to a pixel of the rim
    inside &= inner
    for name, read in maps.items():
        assert np.isfinite(read.pixels).all(), name
        assert read.channels == tuple(record["files"][name]["channels"]), name
        assert read.pixels.shape[:2] == SIZE[::-1]
        colour = "lin_rec709_scene" if name == "base_colour.exr" else "data"
        assert read.attributes["colorInteropID"] == colour
        assert ("chromaticities" in read.attributes) == (name == "base_colour.exr")
    assert maps["base_colour.exr"].attributes["oiio:ColorSpace"] == "lin_rec709_scene"
    np.testing.assert_allclose(
        maps["base_colour.exr"].attributes["chromaticities"],
        (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
        rtol=1e-6,
    )
    bands = maps["bands.exr"]
    assert bands.attributes["spectralLayoutVersion"] == "1.0"
    assert set(bands.channels) == {f"T.{nm},0nm" for nm in (407, 434, 445, 497, 576, 655)}
    for i, nm in enumerate((407, 434, 445, 497, 576, 655)):
        # docs/methods/reflectance.md: the head's albedo is right to 3 % in the median
        ratio = bands[f"T.{nm},0nm"][inside] / true["albedo_bands"][..., i][inside]
        assert np.median(ratio) == pytest.approx(1, abs=0.05)
    # the green of skin lies between its bands at 497 and 576 nm
    green = maps["base_colour.exr"]["G"]
    assert np.median(green[inside]) == pytest.approx(np.median(true["albedo_bands"][..., 3:5][inside]), rel=0.1)
    for name in ("normal_diffuse.exr", "normal_specular.exr"):
        np.testing.assert_allclose(np.linalg.norm(maps[name].pixels, axis=2), 1, atol=1e-5)
    normal = maps["normal_diffuse.exr"]
    assert normal["G"][:40][inside[:40]].mean() > 0.2  # world: the crown's normals look up
    off = maps["depth.exr"]["Z"][inside] - true["depth_mm"][inside]
    assert np.abs(off - np.median(off)).mean() < 5  # mm; the shape, not its distance
    # the rig's skin has GGX width 0.25; the median over a head is right to 1 % at full size
    assert np.median(maps["roughness.exr"]["Y"][inside]) ** 2 == pytest.approx(0.25, rel=0.05)
    # it reflects 0.028 head on, and less than Fresnel's law by up to a fifth at 60 degrees (Schlick's law)
    facing = inside & (normal["B"] > 0.9)
    assert np.median(maps["specular.exr"]["Y"][facing]) == pytest.approx(0.028, rel=0.1)


def test_glb(lightstage: Lightstage, head: Path, tmp_path: Path) -> None:
    to = tmp_path / "out"
    answer = lightstage("material", "demo", "--to", to, "--json", store=head)
    assert answer.code == 0, answer.err
    read = Glb(to / "material.glb")
    assert read.gltf.extensionsUsed == ["KHR_materials_specular"]
    plain = read.material.pbrMetallicRoughness
    gloss = np.asarray(read.picture(plain.metallicRoughnessTexture.index)).astype(float) / 255
    shine = np.asarray(read.picture(read.material.extensions["KHR_materials_specular"]["specularTexture"]["index"]))
    colour = np.asarray(read.picture(plain.baseColorTexture.index)).astype(float) / 255
    inside = Exr(to / "mask.exr")["Y"] == 1
    assert (gloss[..., 2] == 0).all()  # skin is no metal
    # half a step of 8 bits
    np.testing.assert_allclose(gloss[..., 1][inside], Exr(to / "roughness.exr")["Y"][inside], atol=0.51 / 255)
    factor = Exr(to / "specular.exr")["Y"] / 0.04
    np.testing.assert_allclose(shine[..., 3][inside] / 255, np.clip(factor, 0, 1)[inside], atol=0.51 / 255)
    assert answer.json["material"]["files"]["material.glb"]["clipped specular"] == pytest.approx(
        (factor[inside] > 1).mean(), abs=1e-4
    )
    linear = Exr(to / "base_colour.exr").pixels
    # a step of 8-bit sRGB is at most 0.009 of white in linear light
    np.testing.assert_allclose(decode_srgb(colour)[inside], np.clip(linear, 0, 1)[inside], atol=0.006)
    mesh = trimesh.load_mesh(to / "material.glb", process=False)
    assert 0.1 < mesh.extents[1] < 0.4  # metres
    middle = inside & (np.indices(inside.shape)[0] == SIZE[1] // 2)
    assert mesh.bounds[1][2] * 1000 == pytest.approx(890 - Exr(to / "depth.exr")["Z"][inside].min(), abs=1)
    assert middle.any()


def test_what_is_not_ours_stays(lightstage: Lightstage, head: Path, tmp_path: Path) -> None:
    to = tmp_path / "out"
    words = ("material", "demo", "--to", to, "--format", "exr")
    assert lightstage(*words, store=head).code == 0
    before = {path.name: path.read_bytes() for path in to.iterdir()}
    assert lightstage(*words, store=head).code == 0  # its own files may be made anew, and are the same
    assert {path.name: path.read_bytes() for path in to.iterdir()} == before
    (to / "specular.exr").write_text("painted over")
    refused = lightstage(*words, store=head)
    assert refused.code == 2
    assert "specular.exr is there already and is not as material.json describes it" in refused.err
    assert (to / "specular.exr").read_text() == "painted over"
    (to / "material.json").write_text("{}")
    assert "material.json is there already and is no record of this command" in lightstage(*words, store=head).err
    (tmp_path / "file").write_text("")
    assert "no folder can be made there" in lightstage(*words[:3], tmp_path / "file" / "x", store=head).err


def test_without_lights_the_gloss_of_the_subject_is_that_of_its_index(
    lightstage: Lightstage, head: Path, tmp_path: Path
) -> None:
    (source,) = (head / "captures").glob("demo-*")
    folder = shutil.copytree(source, tmp_path / "nol")
    (folder / "calibration" / "lights.yaml").unlink()
    text = (folder / "capture.yaml").read_text()
    (folder / "capture.yaml").write_text(text.replace("session: demo", "session: nol"))
    to = tmp_path / "out"
    done = lightstage("material", folder, "--to", to, "--format", "exr", store=head)
    assert done.code == 0, done.err
    assert "the scale is relative" in done.err
    inside = Exr(to / "mask.exr")["Y"] == 1
    # the background shines nowhere, and its numbers are not the subject's
    assert np.median(Exr(to / "specular.exr")["Y"][inside]) == pytest.approx(0.0278, rel=0.1)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--format", "png"), "--format png: 'png' is not known; expected exr, glb or exr,glb"),
        (("--tracking", "7"), "has no tracking frame 7; it has 0"),
    ],
)
def test_refusals(lightstage: Lightstage, head: Path, tmp_path: Path, words: tuple[str, ...], said: str) -> None:
    answer = lightstage("material", "demo", "--to", tmp_path / "out", *words, store=head)
    assert answer.code == 2
    assert said in answer.err
    assert not list(tmp_path.glob("out/*"))


def test_a_capture_without_a_camera_item_is_refused(lightstage: Lightstage, kept: Path, tmp_path: Path) -> None:
    folder = sphere_capture(tmp_path / "plain")
    answer = lightstage("material", folder, "--to", tmp_path / "out", store=kept)
    assert answer.code == 2
    assert "camera" in answer.err
    assert not list(tmp_path.glob("out/*"))

"""The names that scripts depend on, as docs/formats.md has them."""

import subprocess
import sys

from lightstage.products import names


def test_by_hand() -> None:
    assert [names.band(nm) for nm in (0, 407.0, 434.5)] == ["broadband", "407nm", "434.5nm"]
    assert names.tracking(7) == "tracking0007"
    assert names.frame(12, "Xc") == "0012_Xc"
    assert names.frame(12) == "0012"
    assert names.plane("normal", [names.tracking(0), names.band(576)]) == "normal_tracking0000_576nm"
    assert names.contact_sheet("a") == "a.png"
    assert names.film("a", "normals", 576.0) == "a_normals_576nm"
    assert names.film("a", "upsample") == "a_upsample"
    assert names.alignment("a", 1) == "a_alignment_1.png"
    assert names.skin("a") == {
        "picture": "a_skin.png", "spectra": "a_skin_spectra.png", "table": "a_skin_spectra.csv",
    }  # fmt: skip
    assert names.shape_folder("a") == "a_shape"
    assert names.mesh_files("shape", 3, "glb") == ("shape_tracking0003.glb",)
    assert names.mesh_files("shape", 3, "obj")[:2] == ("shape_tracking0003.obj", "shape_tracking0003.mtl")
    assert names.stimulus("a", "both") == ("a_both.png", "16bit/a_both.png")
    assert names.morph("a", "b", "shape", 0.5) == "a-b-shape-050"
    assert names.light_preview("a") == "a-lights.png"


def test_sets_of_files() -> None:
    assert names.material(["glb"], glossy=True) == ["material.glb"]
    plain, glossy = (names.material(["exr", "glb"], glossy=which) for which in (False, True))
    assert set(glossy) - set(plain) == {"specular.exr", "roughness.exr", "normal_specular.exr"}
    assert {"base_colour.exr", "bands.exr", "normal_diffuse.exr", "depth.exr", "mask.exr"} < set(plain)
    assert names.relit(["L07"], turns=False) == ["L07.png", "L07.exr", "relight.csv", "relight.png"]
    assert names.relit([], turns=True)[-1] == "environment_turn.mp4"


def test_names_and_choices_are_light_to_import() -> None:
    """Every command's parser needs them."""
    modules = ", ".join(f"lightstage.products.{name}" for name in ("names", "choices", "figures", "errors"))
    code = f"import sys, {modules}; print(sorted({{'numpy', 'cv2', 'matplotlib', 'trimesh'}} & set(sys.modules)))"
    said = subprocess.run([sys.executable, "-c", code], check=True, timeout=60, capture_output=True, text=True)
    assert said.stdout.strip() == "[]"

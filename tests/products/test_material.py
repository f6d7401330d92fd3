"""A material without a store: what is known, how it is read, and what the files and the record say."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray

from lightstage.products.errors import ProductError
from lightstage.products.material import document, read_material, write_material
from tests.products.plate import SHAPE, plate
from tests.readers import Exr, Glb

CAMERA = {
    "size_px": [SHAPE[1], SHAPE[0]], "K": [[100, 0, 9.5], [0, 100, 7.5], [0, 0, 1]], "distortion": [0] * 5,
    "world_to_camera": {"R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "t_mm": [0, 0, 900]},
}  # fmt: skip


def results() -> dict[str, Any]:
    normal = np.zeros((1, 1, 3, *SHAPE))
    normal[:, :, 2] = 1
    frame = {"tracking": [5]}
    picture = ("tracking", "y", "x")
    return {
        "reflectance": xarray.Dataset(
            {"reflectance": (("tracking", "band", "y", "x"), np.full((1, 1, *SHAPE), 0.5))},
            {**frame, "band": [576.0]},
            {"scale": "absolute"},
        ),
        "relief": xarray.Dataset({"normal": (("tracking", "band", "xyz", "y", "x"), normal)}, frame),
        "shape": xarray.Dataset(
            {
                "depth_mm": (picture, np.full((1, *SHAPE), 900.0)),
                "edge": (picture, np.zeros((1, *SHAPE), np.uint8)),
            },
            frame,
        ),
        "specular": xarray.Dataset({"normal": (("tracking", "band", "xyz", "y", "x"), normal)}, frame),
        "gloss": xarray.Dataset(
            {"specular": (picture, np.full((1, *SHAPE), 7.0)), "roughness": (picture, np.full((1, *SHAPE), 0.25))},
            frame,
            {"index": 1.4, "scale": "relative"},
        ),
    }


def read(opened: dict[str, Any], tracking: int | None = None) -> Any:
    bands = [{"centre_nm": 576, "width_nm": 10}]
    return read_material(opened, {}, CAMERA, bands, session="a", tracking=tracking)


def test_what_the_results_say() -> None:
    material = read(results())
    assert (material.tracking, material.bands_nm, material.widths_nm) == (5, (576.0,), (10,))
    assert material.known.all()
    np.testing.assert_allclose(material.colour, 0.5, rtol=1e-9)
    # a gloss of no scale is that of its index in the median: ((1.4 - 1) / (1.4 + 1))^2
    np.testing.assert_allclose(material.gloss.specular, (0.4 / 2.4) ** 2)
    without = {node: dataset for node, dataset in results().items() if node not in ("gloss", "specular")}
    assert read(without).gloss is None
    with pytest.raises(ProductError, match="has no tracking frame 3; it has 5"):
        read(results(), tracking=3)
    opened = results()
    opened["shape"].depth_mm[:] = np.nan
    with pytest.raises(ProductError, match="session 'a' has no pixel with albedo, normal and depth"):
        read(opened)


def test_maps_are_padded_and_the_mask_says_where(tmp_path: Path) -> None:
    files = write_material(tmp_path, plate(albedo=0.5), ["exr"])
    assert set(files) == {path.name for path in tmp_path.iterdir()}
    assert not {"specular.exr", "roughness.exr"} & set(files)
    mask = Exr(tmp_path / "mask.exr")["Y"]
    assert (mask[:, 0] == 0).all()
    assert (mask[:, 1:] == 1).all()
    assert (Exr(tmp_path / "base_colour.exr")["R"] == np.float32(0.5)).all()
    assert (Exr(tmp_path / "normal_diffuse.exr")["B"] == 1).all()
    assert files["depth.exr"]["units"] == "mm"


def test_the_mesh_has_what_was_measured(tmp_path: Path) -> None:
    material = read(results())
    files = write_material(tmp_path, material, ["glb"])
    material_of_glb = Glb(tmp_path / "material.glb").material
    assert material_of_glb.pbrMetallicRoughness.metallicRoughnessTexture is not None
    assert files["material.glb"]["clipped specular"] == 0
    assert write_material(tmp_path, plate(albedo=0.5), ["glb"])["material.glb"]["roughness"] == "0.6, not measured"


def test_the_record() -> None:
    said = document(plate(albedo=0.5))
    assert said["scale"] == "absolute: 1 is a perfect white"
    assert said["results"] == {"reflectance": "r", "relief": "n", "shape": "s"}

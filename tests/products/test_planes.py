"""A result's arrays as pictures, read back by others."""

from pathlib import Path

import cv2
import numpy as np
import xarray

from lightstage.products.planes import plane_names, planes, suffix, write_plane
from tests.readers import Exr

RESULT = xarray.Dataset(
    {
        "normal": (
            ("tracking", "band", "xyz", "y", "x"),
            np.array([0.0, 0.6, 0.8], np.float32)[None, None, :, None, None] * np.ones((2, 1, 3, 8, 4), np.float32),
        ),
        "radiance": (
            ("frame", "band", "y", "x"),
            np.arange(2 * 1 * 8 * 4, dtype=np.float32).reshape(2, 1, 8, 4),
            {"units": "radiance"},
        ),
        "valid": (("y", "x"), np.arange(32).reshape(8, 4) % 2 == 0),
    },
    {"tracking": [3, 7], "band": [0.0], "frame": [0, 1], "illumination": ("frame", np.array(["X", "C"], object))},
    {"method": "ratio", "parameters": {}},
)


def test_names_say_what_is_not_in_the_picture() -> None:
    expected = [
        *(f"normal_tracking000{t}_broadband" for t in (3, 7)),
        *(f"radiance_{frame}_broadband" for frame in ("0000_X", "0001_C")),
        "valid",
    ]
    assert plane_names(RESULT) == expected == [plane.name for plane in planes(RESULT)]
    assert [plane.kind for plane in planes(RESULT)] == ["normal"] * 2 + ["scalar"] * 2 + ["mask"]


def test_numbers_come_back(tmp_path: Path) -> None:
    every = {plane.name: plane for plane in planes(RESULT)}
    normal, radiance, valid = (
        every[n] for n in ("normal_tracking0003_broadband", "radiance_0001_C_broadband", "valid")
    )

    def write(plane: object, form: str, convention: str = "opengl") -> Path:
        return tmp_path / write_plane(tmp_path, plane, form=form, convention=convention, attrs=RESULT.attrs)  # type: ignore[arg-type]

    np.testing.assert_array_equal(np.load(write(radiance, "npy")), RESULT.radiance.values[1, 0])
    up, down = (cv2.imread(str(write(normal, "png8", way)))[0, 0, ::-1].tolist() for way in ("opengl", "directx"))
    assert (up, down) == ([128, 204, 230], [128, 51, 230])  # (n + 1) / 2; 229.5 is even at 230
    deep = cv2.imread(str(write(radiance, "png16")), cv2.IMREAD_UNCHANGED)
    full = np.percentile(RESULT.radiance.values[..., ::4, ::4], 99.9)
    np.testing.assert_allclose(deep / 65535, np.minimum(RESULT.radiance.values[1, 0] / full, 1), atol=1e-5)
    mask = cv2.imread(str(write(valid, "png8")), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(mask == 255, RESULT.valid.values)
    read = Exr(write(normal, "exr", "directx"))
    assert read["normal.Y"][0, 0] == np.float32(-0.6)
    assert read.attributes["lightstage.convention"] == "green = down (DirectX)"
    assert read.attributes["lightstage.method"] == "ratio"
    assert "lightstage.parameters" not in read.attributes
    assert Exr(write(radiance, "exr")).attributes["lightstage.units"] == "radiance"


def test_suffixes() -> None:
    assert [suffix(form) for form in ("png8", "png16", "exr", "npy")] == ["png", "png", "exr", "npy"]

"""The contact sheet of results made by hand."""

import io

import numpy as np
import pytest
import xarray
from PIL import Image

from lightstage.products.contact_sheet import contact_sheet
from lightstage.products.errors import ProductError


def results(*components: str, bands: tuple[float, ...] = (434.0, 576.0)) -> tuple[xarray.Dataset, xarray.Dataset]:
    shape = (2, len(bands), len(components), 12, 16)
    stack = xarray.Dataset(
        {"radiance": (("illumination", "band", "component", "y", "x"), np.ones(shape, np.float32))},
        {"illumination": ["X", "C"], "band": list(bands), "component": list(components)},
    )
    normal = np.zeros((1, 1, 3, 12, 16), np.float32)
    normal[:, :, 2] = 1
    dims = ("tracking", "band", "y", "x")
    normals = xarray.Dataset(
        {
            "normal": (("tracking", "band", "xyz", "y", "x"), normal),
            "albedo": (dims, np.ones((1, 1, 12, 16), np.float32)),
            "norm": (dims, np.full((1, 1, 12, 16), 1 / 3, np.float32)),
        },
        {"tracking": [0], "band": [0.0]},
        {"method": "ratio", "component": "diffuse"},
    )
    return stack, normals


@pytest.mark.parametrize(("components", "panels"), [(("diffuse", "specular"), 5), (("total",), 3)])
def test_a_panel_a_component_the_normals_and_the_norm(components: tuple[str, ...], panels: int) -> None:
    picture = np.asarray(Image.open(io.BytesIO(contact_sheet("a", *results(*components), 7))).convert("RGB"))
    assert picture.shape[1] == panels * 440  # 4 inches at 110 dots
    middle = picture[picture.shape[0] // 2]
    assert (np.abs(middle.astype(int) - (128, 128, 255)).max(axis=1) <= 1).sum() > 300  # normals to the camera


def test_a_session_without_a_band_has_no_sheet() -> None:
    stack, normals = results("total")
    with pytest.raises(ProductError, match="no band"):
        contact_sheet("a", stack.isel(band=[]), normals, 7)

"""PNG files read back by Pillow: what the numbers are, and what they mean."""

import io
from typing import Any

import numpy as np
import pytest
from PIL import Image

from lightstage.formats.png import encode_png


def opened(data: bytes) -> Any:
    picture = Image.open(io.BytesIO(data))
    picture.load()
    return picture


def test_channels_keep_their_order() -> None:
    values = np.arange(2 * 3 * 4, dtype=np.uint8).reshape(2, 3, 4)
    np.testing.assert_array_equal(np.asarray(opened(encode_png(values))), values)
    np.testing.assert_array_equal(np.asarray(opened(encode_png(values[..., :3]))), values[..., :3])
    np.testing.assert_array_equal(np.asarray(opened(encode_png(values[..., 0]))), values[..., 0])


@pytest.mark.parametrize(
    ("light", "intent", "gamma"), [("srgb", 1, 0.45455), ("linear", None, 1.0), (None, None, None)]
)
def test_what_the_numbers_mean_is_said(light: Any, intent: int | None, gamma: float | None) -> None:
    said = opened(encode_png(np.zeros((2, 2), np.uint16), light=light, comment="by us")).info
    assert said.get("srgb") == intent
    assert said.get("gamma") == gamma
    assert said["Comment"] == "by us"
    if light is not None:
        assert said["chromaticity"][:4] == pytest.approx((0.3127, 0.3290, 0.64, 0.33))  # white first, then red

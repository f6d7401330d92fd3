"""Environment maps for tests, in latitude and longitude."""

from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray


def write_hdr(file: Path, values: NDArray[np.floating]) -> Path:
    """Radiance HDR, not compressed, by hand (Ward 1991): a mantissa of 8 bits a channel and one exponent."""
    height, width = values.shape[:2]
    fraction, exponent = np.frexp(values.max(axis=2))
    scale = np.where(values.max(axis=2) > 0, fraction * 256 / np.maximum(values.max(axis=2), 1e-30), 0)
    code = np.zeros((height, width, 4), np.uint8)
    code[..., :3] = np.floor(values * scale[..., None])
    code[..., 3] = np.where(scale > 0, exponent + 128, 0)
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode()
    file.write_bytes(head + code.tobytes())
    return file


def write_map(file: Path, values: NDArray[np.floating], **header: Any) -> Path:
    parts = {name: np.ascontiguousarray(values[..., i], np.float32) for i, name in enumerate("RGB")}
    with OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, **header}, parts) as exr:
        exr.write(str(file))
    return file


def white(size: int = 16) -> NDArray[np.floating]:
    return np.ones((size, 2 * size, 3))


def noise() -> NDArray[np.floating]:
    return np.random.default_rng(0).random((16, 32, 3)) ** 4 * 100

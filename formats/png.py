"""PNG with what its numbers mean said in its chunks.

`sRGB` says that the numbers are sRGB's code; `gAMA` and `cHRM` say so, or that they are linear light, for who knows
no `sRGB`. Pictures of measured light are not to be made pleasing, so the intent is relative colorimetric.

Source: Portable Network Graphics, third edition (W3C 2025), 11.3.2.
"""

import struct
import zlib
from typing import TYPE_CHECKING, Any, Literal

from lightstage.formats.exr import REC709

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_HEAD = 8 + 25
"""Bytes of the signature and of the first chunk; what says the colour comes before the pixels."""
_RELATIVE_COLORIMETRIC = b"\x01"
_SRGB_GAMMA = 1 / 2.2


def encode_png(
    values: "NDArray[np.integer[Any]]", *, light: Literal["srgb", "linear"] | None = None, comment: str = ""
) -> bytes:
    """The bytes of a PNG file.

    Args:
        values: (y, x) grey, (y, x, rgb) or (y, x, rgba) with straight alpha; uint8 or uint16.
        light: how the numbers stand for light; None for numbers that are no light, such as normals.
        comment: its `Comment`.

    Raises:
        OSError: it cannot be encoded.
    """
    import cv2

    # OpenCV writes B, G, R, A
    turned = values if values.ndim == 2 else values[..., [2, 1, 0, *range(3, values.shape[2])]]
    good, encoded = cv2.imencode(".png", turned)
    if not good:
        raise OSError("the picture cannot be encoded as PNG")
    data = encoded.tobytes()
    chunks = _chunk(b"sRGB", _RELATIVE_COLORIMETRIC) if light == "srgb" else b""
    if light is not None:
        gamma = _SRGB_GAMMA if light == "srgb" else 1.0
        white_first = (*REC709[6:], *REC709[:6])
        chunks += _chunk(b"gAMA", struct.pack(">I", round(100000 * gamma)))
        chunks += _chunk(b"cHRM", struct.pack(">8I", *(round(100000 * value) for value in white_first)))
    if comment:
        chunks += _chunk(b"tEXt", b"Comment\0" + comment.encode("latin-1", "replace"))
    return data[:_HEAD] + chunks + data[_HEAD:]


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

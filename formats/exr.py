"""OpenEXR with what its numbers are said.

A file says so in two ways that others read: `chromaticities` (OpenEXR's own) and `colorInteropID`, the names that
OpenColorIO configurations and OpenImageIO share: `lin_rec709_scene` is linear light in the primaries of Rec. 709
(sRGB), `data` no colour at all.

Sources: OpenEXR, "Standard attributes"; the Color Interop Forum's identifiers; Fichet, Pacanowski, Wilkie (2021),
JCGT 10(3), for the names of spectral channels.
"""

import errno
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

COLOUR, DATA = "lin_rec709_scene", "data"
REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""Red, green, blue and white, x and y each."""
_ROWS_A_BLOCK = 16
"""Of ZIP compression."""


def write_exr(
    file: Path, channels: "Mapping[str, NDArray[np.floating]]", *, colour: str, **attributes: str | float
) -> None:
    """Write 32-bit float channels (y, x), ZIP-compressed.

    Args:
        channels: by name.
        colour: COLOUR or DATA.
        attributes: more for the header, under `lightstage.`; text or numbers.

    Raises:
        OSError: the file cannot be written.
    """
    import numpy as np
    import OpenEXR

    header: dict[str, Any] = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "colorInteropID": colour,
        **{f"lightstage.{name}": value for name, value in attributes.items()},
    }
    if colour == COLOUR:
        header["chromaticities"] = REC709
    if any(name.startswith("T.") for name in channels):
        header["spectralLayoutVersion"] = "1.0"
    parts = {name: np.ascontiguousarray(values, np.float32) for name, values in channels.items()}
    try:
        with OpenEXR.File(header, parts) as exr:
            exr.write(str(file))
    except RuntimeError as error:
        raise OSError(str(error)) from None
    rows = next(iter(channels.values())).shape[0]
    if not is_whole(file.read_bytes(), rows):
        # the library says nothing where its last buffer finds no place
        raise OSError(errno.ENOSPC, "the picture was not written to its end; the disk may be full", str(file))


def is_whole(data: bytes, rows: int) -> bool:
    """Whether a file of `write_exr` has all its blocks, by the table of their places behind the header."""
    try:
        at = 8  # magic number and version
        while data[at]:  # attributes: name, type, size and value
            kind = data.index(b"\0", at) + 1
            size = data.index(b"\0", kind) + 1
            at = size + 4 + struct.unpack_from("<i", data, size)[0]
        places = struct.unpack_from(f"<{-(-rows // _ROWS_A_BLOCK)}Q", data, at + 1)
        ends = [place + 8 + struct.unpack_from("<i", data, place + 4)[0] for place in places]
    except (IndexError, ValueError, struct.error):
        return False
    return 0 not in places and max(ends) <= len(data)


def rgb(values: "NDArray[np.floating]", layer: str = "") -> "dict[str, NDArray[np.floating]]":
    """The channels of a picture (y, x, 3 or 4): R, G, B and A, of a layer."""
    prefix = f"{layer}." if layer else ""
    return {f"{prefix}{name}": values[..., i] for i, name in enumerate("RGBA"[: values.shape[-1]])}


def spectral(values: "NDArray[np.floating]", bands_nm: Sequence[float]) -> "dict[str, NDArray[np.floating]]":
    """The channels of reflectance (band, y, x): T.407,0nm and so on, with a comma because a dot parts layers."""
    return {f"T.{nm:.1f}nm".replace(".", ",").replace("T,", "T."): values[i] for i, nm in enumerate(bands_nm)}

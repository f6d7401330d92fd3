"""Pictures for renderers: OpenEXR with its colour said, 16-bit PNG in sRGB, and environment maps read.

An EXR file says what its numbers are in two ways that others read: `chromaticities` (OpenEXR's own) and
`colorInteropID`, the names that OpenColorIO configurations and OpenImageIO share: `lin_rec709_scene` is linear
light in the primaries of Rec. 709 (sRGB), `data` no colour at all.

Sources: OpenEXR, "Standard attributes"; the Color Interop Forum's identifiers; PNG (Third Edition) 11.3.2;
Fichet, Pacanowski and Wilkie (2021), JCGT 10(3), for the names of spectral channels.
"""

import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from store.errors import RequestError
from store.intake import FileError, open_regular

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

COLOUR, DATA = "lin_rec709_scene", "data"
REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""Red, green, blue and white, x and y each."""
WIDEST = 1024
"""Columns of an environment; wider maps are averaged down to about this, finer than the lights made of them."""
WIDEST_READ = 16384
LARGEST_READ = 800 << 20
"""Bytes of an environment; 11,500 x 5,750 pixels of three channels are 794 MB, more than lights are made of."""
_PRIMARIES_OFF = 0.002


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


def rgb(values: "NDArray[np.floating]", layer: str = "") -> "dict[str, NDArray[np.floating]]":
    """The channels of a picture (y, x, 3 or 4): R, G, B and A, of a layer."""
    prefix = f"{layer}." if layer else ""
    return {f"{prefix}{name}": values[..., i] for i, name in enumerate("RGBA"[: values.shape[-1]])}


def spectral(values: "NDArray[np.floating]", bands_nm: Sequence[float]) -> "dict[str, NDArray[np.floating]]":
    """The channels of reflectance (band, y, x): T.407,0nm and so on, with a comma because a dot parts layers."""
    return {f"T.{nm:.1f}nm".replace(".", ",").replace("T,", "T."): values[i] for i, nm in enumerate(bands_nm)}


def png16(linear: "NDArray[np.floating]", alpha: "NDArray[np.bool_]", text: str) -> bytes:
    """A 16-bit RGBA PNG in sRGB, said in its `sRGB`, `gAMA` and `cHRM` chunks; alpha is straight.

    Args:
        linear: (y, x, rgb); values beyond 0..1 are clipped.
        alpha: (y, x): where the picture is opaque; it is black elsewhere.
        text: its `Comment`.
    """
    import cv2
    import numpy as np

    from stages.colour import encode_srgb

    counts = np.zeros((*alpha.shape, 4), np.uint16)
    shown = np.floor(65535 * encode_srgb(linear) + 0.5)
    counts[..., :3] = np.where(alpha[..., None], shown, 0)[..., ::-1]  # OpenCV writes B, G, R, A
    counts[..., 3] = np.where(alpha, 65535, 0)
    data = cv2.imencode(".png", counts)[1].tobytes()
    start = 8 + 12 + 13  # the signature, and IHDR
    order = (6, 7, 0, 1, 2, 3, 4, 5)  # cHRM has white first
    told = (
        _chunk(b"cHRM", struct.pack(">8I", *(round(100000 * REC709[i]) for i in order))),
        _chunk(b"gAMA", struct.pack(">I", 45455)),
        _chunk(b"sRGB", b"\x01"),  # relative colorimetric
        _chunk(b"tEXt", b"Comment\0" + text.encode("latin-1", "replace")),
    )
    return data[:start] + b"".join(told) + data[start:]


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def read_environment(path: Path) -> "NDArray[np.float32]":
    """An environment map in latitude and longitude: (y, x, rgb) radiance, linear Rec. 709.

    Radiance HDR, OpenEXR, or float TIFF, by OpenImageIO. Grey maps become three equal channels.

    Raises:
        RequestError: the file is missing, damaged, not twice as wide as high, not linear light in floating point or
            in other primaries than Rec. 709's, or holds NaN, infinite or negative values, or no light at all.
    """
    import numpy as np

    name = f"--environment {path}"
    try:
        with open_regular(path):
            pass  # OpenImageIO opens it by its name
    except FileError as error:
        raise RequestError(f"{name} {error}; give a .hdr or .exr map in latitude and longitude") from None
    values, attributes = _pixels(path, name)
    height, width = values.shape[:2]
    if width != 2 * height:
        raise RequestError(
            f"{name} is {width} x {height}; a map in latitude and longitude is twice as wide as high"
        )
    _check_colour(attributes, name)
    wrong = ~np.isfinite(values)
    if wrong.any():
        raise RequestError(f"{name}: {int(wrong.sum())} values are NaN or infinite; repair the map")
    if (values < 0).any():
        raise RequestError(
            f"{name}: {int((values < 0).sum())} values are negative, down to {values.min():g}; light is not"
        )
    if not values.any():
        raise RequestError(f"{name} is black; there is no light in it")
    factor = width // WIDEST
    while factor > 1 and height % factor:
        factor -= 1
    if factor > 1:
        values = values.reshape(height // factor, factor, width // factor, factor, 3).mean(axis=(1, 3))
    return np.asarray(values, np.float32)


def _pixels(path: Path, name: str) -> "tuple[NDArray[np.float32], dict[str, Any]]":
    """(y, x, rgb) as stored, and what the file says of them."""
    import numpy as np
    import OpenImageIO

    source = OpenImageIO.ImageInput.open(str(path))
    if source is None:
        said = OpenImageIO.geterror().splitlines()
        raise RequestError(f"{name} is no picture that can be read ({said[-1] if said else 'unknown format'})")
    try:
        spec = source.spec()
        channels = [str(channel) for channel in spec.channelnames]
        if str(spec.format) not in ("half", "float", "double"):
            raise RequestError(
                f"{name} holds {spec.format}, which ends at white; radiance needs floating point, .hdr or .exr"
            )
        if max(spec.width, spec.height) > WIDEST_READ:
            raise RequestError(
                f"{name} declares {spec.width} x {spec.height} pixels; a side has at most {WIDEST_READ}"
            )
        wanted = [channels.index(c) for c in "RGB"] if set("RGB") <= set(channels) else [0, 0, 0]
        if wanted == [0, 0, 0] and len(channels) > 2:
            raise RequestError(f"{name} has channels {', '.join(channels)}; expected R, G, B, or one grey channel")
        first, beyond = min(wanted), max(wanted) + 1
        if spec.width * spec.height * (beyond - first) * 4 > LARGEST_READ:
            raise RequestError(
                f"{name} declares {spec.width} x {spec.height} pixels; at most {LARGEST_READ >> 20} MiB are read"
            )
        values = source.read_image(0, 0, first, beyond, "float")
        if values is None:
            raise RequestError(f"{name} is damaged or cut short ({source.geterror().splitlines()[0]})")
        attributes = {entry.name: entry.value for entry in spec.extra_attribs}
    finally:
        source.close()
    if (spec.full_width, spec.full_height) != (spec.width, spec.height):
        raise RequestError(
            f"{name} holds {spec.width} x {spec.height} pixels of {spec.full_width} x {spec.full_height}; "
            "a whole map is needed"
        )
    shaped = np.asarray(values, np.float32).reshape(spec.height, spec.width, beyond - first)
    return shaped if wanted == [first, first + 1, first + 2] else shaped[
        ..., np.subtract(wanted, first)
    ], attributes


def _check_colour(attributes: Mapping[str, Any], name: str) -> None:
    said = attributes.get("chromaticities")
    if said is not None and max(abs(a - b) for a, b in zip(said, REC709, strict=True)) > _PRIMARIES_OFF:
        raise RequestError(
            f"{name}: its chromaticities are other primaries than Rec. 709's; convert it to linear sRGB first"
        )
    space = attributes.get("colorInteropID", COLOUR)
    if space not in (COLOUR, "unknown"):
        raise RequestError(f"{name} is in the colour space {space}; convert it to {COLOUR} (linear sRGB) first")

"""Environment maps in latitude and longitude: Radiance HDR, OpenEXR or float TIFF, read by OpenImageIO."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.formats.errors import FormatError
from lightstage.formats.exr import COLOUR, REC709

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

WIDEST = 1024
"""Columns of an environment; wider maps are averaged down to about this, finer than the lights made of them."""
WIDEST_READ = 16384
LARGEST_READ = 800 << 20
"""Bytes of an environment; 11,500 x 5,750 pixels of three channels are 794 MB, more than lights are made of."""
_PRIMARIES_OFF = 0.002


def read_environment(path: Path) -> "NDArray[np.float32]":
    """An environment map in latitude and longitude: (y, x, rgb) radiance, linear Rec. 709.

    Grey maps become three equal channels.

    Args:
        path: of a regular file that is there; OpenImageIO would wait for a pipe.

    Raises:
        FormatError: the file is damaged, not twice as wide as high, not linear light in floating point or
            in other primaries than Rec. 709's, or holds NaN, infinite or negative values, or no light at all.
    """
    import numpy as np

    values, attributes = _pixels(path)
    height, width = values.shape[:2]
    if width != 2 * height:
        raise FormatError(f"{path} is {width} x {height}; a map in latitude and longitude is twice as wide as high")
    _check_colour(attributes, path)
    wrong = ~np.isfinite(values)
    if wrong.any():
        raise FormatError(f"{path}: {int(wrong.sum())} values are NaN or infinite; repair the map")
    if (values < 0).any():
        raise FormatError(
            f"{path}: {int((values < 0).sum())} values are negative, down to {values.min():g}; light is not"
        )
    if not values.any():
        raise FormatError(f"{path} is black; there is no light in it")
    factor = width // WIDEST
    while factor > 1 and height % factor:
        factor -= 1
    if factor > 1:
        values = values.reshape(height // factor, factor, width // factor, factor, 3).mean(axis=(1, 3))
    return np.asarray(values, np.float32)


def _pixels(path: Path) -> "tuple[NDArray[np.float32], dict[str, Any]]":
    """(y, x, rgb) as stored, and what the file says of them."""
    import numpy as np
    import OpenImageIO

    source = OpenImageIO.ImageInput.open(str(path))
    if source is None:
        lines = OpenImageIO.geterror().splitlines()
        raise FormatError(f"{path} is no picture that can be read ({lines[-1] if lines else 'unknown format'})")
    try:
        spec = source.spec()
        channels = [str(channel) for channel in spec.channelnames]
        if str(spec.format) not in ("half", "float", "double"):
            raise FormatError(
                f"{path} holds {spec.format}, which ends at white; radiance needs floating point, .hdr or .exr"
            )
        if max(spec.width, spec.height) > WIDEST_READ:
            raise FormatError(
                f"{path} declares {spec.width} x {spec.height} pixels; a side has at most {WIDEST_READ}"
            )
        wanted = [channels.index(c) for c in "RGB"] if set("RGB") <= set(channels) else [0, 0, 0]
        if wanted == [0, 0, 0] and len(channels) > 2:
            raise FormatError(f"{path} has channels {', '.join(channels)}; expected R, G, B, or one grey channel")
        first, beyond = min(wanted), max(wanted) + 1
        if spec.width * spec.height * (beyond - first) * 4 > LARGEST_READ:
            raise FormatError(
                f"{path} declares {spec.width} x {spec.height} pixels; at most {LARGEST_READ >> 20} MiB are read"
            )
        values = source.read_image(0, 0, first, beyond, "float")
        if values is None:
            raise FormatError(f"{path} is damaged or cut short ({source.geterror().splitlines()[0]})")
        attributes = {entry.name: entry.value for entry in spec.extra_attribs}
    finally:
        source.close()
    if (spec.full_width, spec.full_height) != (spec.width, spec.height):
        raise FormatError(
            f"{path} holds {spec.width} x {spec.height} pixels of {spec.full_width} x {spec.full_height}; "
            "a whole map is needed"
        )
    shaped = np.asarray(values, np.float32).reshape(spec.height, spec.width, beyond - first)
    return shaped if wanted == [first, first + 1, first + 2] else shaped[
        ..., np.subtract(wanted, first)
    ], attributes


def _check_colour(attributes: Mapping[str, Any], path: Path) -> None:
    primaries = attributes.get("chromaticities")
    if primaries is not None and max(abs(a - b) for a, b in zip(primaries, REC709, strict=True)) > _PRIMARIES_OFF:
        raise FormatError(
            f"{path}: its chromaticities are other primaries than Rec. 709's; convert it to linear sRGB first"
        )
    space = attributes.get("colorInteropID", COLOUR)
    if space not in (COLOUR, "unknown"):
        raise FormatError(f"{path} is in the colour space {space}; convert it to {COLOUR} (linear sRGB) first")

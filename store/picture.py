"""Integer pictures: 8- and 16-bit PNG and TIFF, whole or refused.

What a file declares is read first, and refused where no camera makes it, so that a small file cannot ask for all
memory. Then the container is held against itself: every part of a PNG against its checksum; a TIFF's strips or
tiles against the file (all there, none over another) and against the size that is declared (each gives exactly
the rows that it stands for), deflate also against its checksum. What has no checksum (plain, LZW and PackBits
values, a TIFF's tags) may be altered without anybody's noticing.
"""

import io
import logging
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from store.intake import FileError

if TYPE_CHECKING:
    from tifffile import TiffPage

Picture = NDArray[Any]
EXTENSIONS = (".png", ".tif", ".tiff")
WIDEST_PX = 16384
"""Of either side; the largest sensors have 14204 x 10652."""
LARGEST = 640 << 20
"""Bytes of values; 100 megapixels of 16-bit colour are 610 MB."""
LARGEST_FILE = 1 << 30

_PNG = b"\x89PNG\r\n\x1a\n"
_TIFF = (b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+")
_PNG_CHANNELS = {0: 1, 2: 3, 3: 4, 4: 4, 6: 4}
"""By colour type, as decoded; a palette may have alpha, and OpenCV makes four of grey with alpha."""
_NONE, _LZW, _DEFLATE, _PACKBITS = (1,), (5,), (8, 32946), (32773,)
_PHOTOMETRICS = {
    0: "counts from white (MINISWHITE); save it so that 0 is black",
    3: "has palette colours (PALETTE); save it as grey or RGB",
    4: "is a transparency mask (MASK); save it as grey",
    5: "is in ink colours (SEPARATED); save it as grey or RGB",
    6: "is in YCbCr colours; save it as grey or RGB",
    8: "is in CIE Lab colours (CIELAB); save it as grey or RGB",
    32803: "holds a colour filter array (CFA, Bayer); save it as grey or RGB",
}

# a damaged file is refused in our words; without a handler logging would print tifffile's beside them
logging.getLogger("tifffile").addHandler(logging.NullHandler())


class PictureError(FileError):
    """The file is not a whole picture; the message does not name it, the caller does."""


@dataclass(frozen=True)
class Declared:
    """What a file says that it holds."""

    height: int
    width: int
    channels: int
    """At most: a palette may have alpha or not."""
    bits: int

    @property
    def shape(self) -> tuple[int, int]:
        """(y, x)."""
        return self.height, self.width

    @property
    def size(self) -> int:
        """Bytes of the values, decoded."""
        return self.height * self.width * self.channels * (self.bits + 7) // 8


def declared(file: BinaryIO) -> Declared:
    """What a picture file says of itself, without decoding it.

    Raises:
        PictureError: not a PNG or TIFF, of a kind that is not read, or larger than any camera's.
    """
    start = file.read(33)
    if not start:
        raise PictureError("is empty")
    if start[:8] == _PNG:
        return _sane(_declared_by_png(start))
    if start[:4] in _TIFF:
        return _declared_by_tiff(file)
    raise PictureError("is not a PNG or TIFF picture")


def decode(data: bytes) -> Picture:
    """Decode a picture as it is stored: (y, x) or (y, x, channel) in R, G, B order, uint8 or uint16.

    Raises:
        PictureError: not a PNG or TIFF, truncated, damaged, larger than any camera's, or not of 8 or 16 bits.
    """
    promised = declared(io.BytesIO(data))
    if data[:8] == _PNG:
        _check_png(data)
        picture = _decoded_by_opencv(data, "PNG")
    else:
        picture = _decode_tiff(data)
    if picture.shape[:2] != promised.shape or picture.dtype not in (np.uint8, np.uint16):
        raise PictureError(f"is damaged: it declares {promised.width} x {promised.height} and decodes to other")
    return picture


def _sane(promised: Declared) -> Declared:
    height, width = promised.shape
    if not (height and width):
        raise PictureError(f"declares {width} x {height} pixels; there is no picture in it")
    if max(height, width) > WIDEST_PX:
        raise PictureError(f"declares {width} x {height} pixels; a side has at most {WIDEST_PX}")
    if promised.size > LARGEST:
        raise PictureError(
            f"declares {width} x {height} pixels of {promised.channels} x {promised.bits} bits, "
            f"{promised.size >> 20} MiB; at most {LARGEST >> 20} are read"
        )
    return promised


def _declared_by_png(start: bytes) -> Declared:
    if len(start) < 33:
        raise PictureError(f"is truncated: the PNG ends after {len(start)} bytes")
    length, kind, width, height, bits, colour = struct.unpack_from(">I4sIIBB", start, 8)
    if (length, kind) != (13, b"IHDR"):
        raise PictureError("is damaged: the PNG does not begin with its header")
    _check_part(start, 8, 33)
    if colour not in _PNG_CHANNELS:
        raise PictureError(f"is damaged: the PNG's colour type {colour} does not exist")
    return Declared(height, width, _PNG_CHANNELS[colour], bits)


def _check_png(data: bytes) -> None:
    offset = 8
    while offset + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, offset)
        end = offset + 12 + length
        if end > len(data):
            break
        _check_part(data, offset, end)
        if kind == b"acTL":
            raise PictureError("is an animation (APNG); a file holds one picture")
        if kind == b"IEND":
            return
        offset = end
    raise PictureError(f"is truncated: the PNG ends after {len(data)} bytes without an end mark")


def _check_part(data: bytes, offset: int, end: int) -> None:
    (checksum,) = struct.unpack_from(">I", data, end - 4)
    if zlib.crc32(memoryview(data)[offset + 4 : end - 4]) != checksum:
        kind = data[offset + 4 : offset + 8].decode("ascii", "replace")
        raise PictureError(f"is damaged: its {kind} part fails the checksum")


def _decoded_by_opencv(data: bytes | bytearray, kind: str) -> Picture:
    import cv2

    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise PictureError(f"cannot be decoded as {kind} ({str(error.err).splitlines()[0]})") from None
    if picture is None:
        raise PictureError(f"cannot be decoded as {kind}: its values are damaged or cut short")
    if picture.ndim == 3:
        picture = picture[:, :, [2, 1, 0, 3]] if picture.shape[2] == 4 else picture[:, :, ::-1]
    return np.asarray(picture)


@dataclass(frozen=True)
class _Layout:
    """Where a TIFF's values lie, and how."""

    promised: Declared
    compression: int
    predictor: int
    apart: bool
    """Each channel by itself, instead of pixel by pixel."""
    big_endian: bool
    tile: tuple[int, int] | None
    """Rows, columns; None for strips."""
    rows: int
    """Of a whole strip or tile."""
    places: tuple[tuple[int, int], ...]
    """(offset, bytes) of each strip or tile."""
    orientation_at: int | None
    """Byte of the file at which the orientation is said."""

    @property
    def count(self) -> int:
        """Of strips or tiles."""
        height, width = self.promised.shape
        across = -(-width // self.tile[1]) if self.tile else 1
        return -(-height // self.rows) * across * (self.promised.channels if self.apart else 1)

    def boxes(self) -> Iterator[tuple[int, int, int, int, int]]:
        """(channel, first row, rows, first column, columns) of each strip or tile, without what hangs over."""
        height, width = self.promised.shape
        columns = self.tile[1] if self.tile else width
        for channel in range(self.promised.channels if self.apart else 1):
            for y in range(0, height, self.rows):
                for x in range(0, width, columns):
                    yield channel, y, min(self.rows, height - y), x, min(columns, width - x)


def _declared_by_tiff(file: BinaryIO) -> Declared:
    return _tiff_layout(file).promised


def _tiff_layout(file: BinaryIO) -> _Layout:
    import tifffile

    file.seek(0)
    try:
        with tifffile.TiffFile(file) as tiff:
            page = tiff.pages[0]
            layout = _layout_of(page, big_endian=tiff.byteorder == ">")
            if len(tiff.pages) > 1:
                raise PictureError(f"holds {len(tiff.pages)} pictures; a file holds one")
    except PictureError:
        raise
    except Exception as error:  # noqa: BLE001  tifffile raises many kinds
        raise PictureError(f"cannot be decoded as TIFF ({error or type(error).__name__})") from None
    size = file.seek(0, io.SEEK_END)
    _check_places(layout, size)
    return layout


def _layout_of(page: "TiffPage", *, big_endian: bool) -> _Layout:
    def tag(name: str, default: Any) -> Any:
        found = page.tags.get(name)
        return default if found is None else found.value

    bits = tag("BitsPerSample", 1)
    bits = set(bits) if isinstance(bits, tuple) else {bits}
    formats = tag("SampleFormat", 1)
    formats = set(formats) if isinstance(formats, tuple) else {formats}
    photometric = int(tag("PhotometricInterpretation", -1))
    if photometric not in (1, 2):
        raise PictureError(
            _PHOTOMETRICS.get(photometric, f"has the unknown photometric interpretation {photometric}")
        )
    if formats != {1} or not bits <= {8, 16} or len(bits) != 1:
        held = str(page.dtype) if page.dtype is not None else f"{sorted(bits)}-bit"
        raise PictureError(f"holds {held} values; 8- or 16-bit integers are expected")
    promised = _sane(Declared(page.imagelength, page.imagewidth, page.samplesperpixel, bits.pop()))
    if photometric == 2 and promised.channels < 3:
        raise PictureError(f"is damaged: it is RGB and has {promised.channels} channel(s)")
    compression, predictor = int(tag("Compression", 1)), int(tag("Predictor", 1))
    if compression not in (*_NONE, *_LZW, *_DEFLATE, *_PACKBITS):
        name = getattr(page.compression, "name", compression)
        raise PictureError(f"is compressed as {name}; none, deflate, LZW or PackBits are expected")
    if predictor not in (1, 2):
        raise PictureError(f"has the predictor {predictor}; none or horizontal differences are expected")
    if int(tag("FillOrder", 1)) != 1:
        raise PictureError("holds its bits from the lowest on (FillOrder 2); save it with the usual order")
    apart = promised.channels > 1 and int(tag("PlanarConfiguration", 1)) == 2
    tile = (int(page.tilelength), int(page.tilewidth)) if page.is_tiled else None
    rows = tile[0] if tile else min(int(tag("RowsPerStrip", promised.height)), promised.height)
    if rows < 1 or (tile and (min(tile) < 1 or max(tile) > WIDEST_PX)):
        raise PictureError("is damaged: its strips or tiles have no size that can be")
    turned = page.tags.get("Orientation")
    return _Layout(
        promised,
        compression,
        predictor,
        apart,
        big_endian,
        tile,
        rows,
        tuple(zip(page.dataoffsets, page.databytecounts, strict=True)),
        None if turned is None else turned.valueoffset,
    )


def _check_places(layout: _Layout, size: int) -> None:
    part = "tile" if layout.tile else "strip"
    if len(layout.places) != layout.count:
        raise PictureError(f"is damaged: it has {len(layout.places)} {part}s of values and needs {layout.count}")
    last = 0
    for offset, count in sorted(layout.places):
        if offset < 8 or count < 1:
            raise PictureError(f"is damaged: a {part} of its values is missing")
        if offset < last:
            raise PictureError(f"is damaged: two {part}s of its values lie over each other")
        last = offset + count
    if last > size:
        raise PictureError(f"is truncated: the TIFF has {size} bytes and needs {last}")


def _decode_tiff(data: bytes) -> Picture:
    layout = _tiff_layout(io.BytesIO(data))
    if layout.compression in (*_NONE, *_DEFLATE):
        return _assembled(data, layout)
    if layout.apart:
        raise PictureError("is compressed and keeps its channels apart; save it with deflate, or pixel by pixel")
    if layout.orientation_at is None:
        return _decoded_by_opencv(data, "TIFF")
    # OpenCV would turn the picture; raw keeps the sensor's orientation
    upright = bytearray(data)
    upright[layout.orientation_at : layout.orientation_at + 2] = (1).to_bytes(
        2, "big" if layout.big_endian else "little"
    )
    return _decoded_by_opencv(upright, "TIFF")


def _assembled(data: bytes, layout: _Layout) -> Picture:
    """The picture of strips or tiles that are plain or deflated."""
    promised = layout.promised
    together = 1 if layout.apart else promised.channels
    stored = np.dtype("u1" if promised.bits == 8 else ">u2" if layout.big_endian else "<u2")
    picture = np.empty((promised.height, promised.width, promised.channels), stored.newbyteorder("="))
    for (offset, count), (channel, y, rows, x, columns) in zip(layout.places, layout.boxes(), strict=True):
        shape = (*(layout.tile or (rows, columns)), together)
        needed = shape[0] * shape[1] * together * stored.itemsize
        values: Any = memoryview(data)[offset : offset + count]
        if layout.compression in _DEFLATE:
            values = _inflated(values, needed)
        if len(values) != needed:
            raise PictureError(
                f"is damaged: the values from row {y}, column {x} on are {len(values)} bytes, not {needed}"
            )
        part = np.frombuffer(values, stored).reshape(shape)
        if layout.predictor == 2:
            part = np.cumsum(part, axis=1, dtype=picture.dtype)
        picture[y : y + rows, x : x + columns, channel : channel + together] = part[:rows, :columns]
    return picture[..., 0] if promised.channels == 1 else picture


def _inflated(values: Any, needed: int) -> bytes:
    inflater = zlib.decompressobj()
    try:
        # one byte more than needed: the stream must come to its end, where its checksum stands
        found = inflater.decompress(values, needed + 1)
    except zlib.error as error:
        raise PictureError(f"is damaged: its values cannot be inflated ({error})") from None
    if not inflater.eof:
        raise PictureError("is damaged: its deflated values have no end, or are more than it declares")
    return found


def linear_from_srgb(picture: Picture) -> Picture:
    """Undo the sRGB curve (IEC 61966-2-1): integers of either depth to linear uint16, full scale 65535."""
    top = np.iinfo(picture.dtype).max
    codes = np.arange(top + 1) / top
    linear = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
    table = np.round(linear * 65535).astype(np.uint16)
    decoded = np.empty(picture.shape, np.uint16)
    for row, found in zip(decoded, picture, strict=True):
        row[...] = table[found]  # a row at a time: the indices take eight bytes a value
    return decoded

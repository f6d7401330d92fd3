"""Integer pictures: 8- and 16-bit PNG and TIFF, whole or refused.

What a file declares is read first, and refused where no camera makes it, so that a small file cannot ask for all
memory. Then the container is held against itself: every part of a PNG against its checksum; a TIFF's strips or
tiles against the file (all there, none over another) and against the size that is declared (each gives exactly
the rows that it stands for), deflate also against its checksum. What has no checksum (plain, LZW and PackBits
values, a TIFF's tags) may be altered without anybody's noticing.
"""

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, BinaryIO

from lightstage.store.intake import FileError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Picture = NDArray[Any]
EXTENSIONS = (".png", ".tif", ".tiff")
WIDEST_PX = 16384
"""Of either side; the largest sensors have 14204 x 10652."""
LARGEST = 640 << 20
"""Bytes of values of 16 bits; 100 megapixels of colour are 610 MB."""
LARGEST_FILE = 1 << 30

_PNG = b"\x89PNG\r\n\x1a\n"
_TIFF = (b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+")
_PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}
"""By colour type; a palette's colours count."""
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

_FORMATS = {1: "uint", 2: "int", 3: "float"}
_TYPES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}
"""Of a TIFF's tags: bytes a value."""
_WHOLE = {1: "B", 3: "H", 4: "I", 13: "I", 16: "Q", 18: "Q"}
_MOST_NUMBERS = 1 << 20
"""That one tag may hold: the widest picture in tiles of 16 x 16."""


class PictureError(FileError):
    """The file is not a whole picture; the message does not name it, the caller does."""


@dataclass(frozen=True)
class Declared:
    """What a file says that it holds."""

    height: int
    width: int
    channels: int
    bits: int

    @property
    def shape(self) -> tuple[int, int]:
        """(y, x)."""
        return self.height, self.width

    @property
    def size(self) -> int:
        """Bytes of the values, in the 16 bits that they get."""
        return self.height * self.width * self.channels * 2


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
        return _tiff_layout(file).promised
    raise PictureError("is not a PNG or TIFF picture")


def decode(data: bytes) -> "Picture":
    """Decode a picture as it is stored: (y, x) or (y, x, channel) in R, G, B order, uint8 or uint16.

    Raises:
        PictureError: not a PNG or TIFF, truncated, damaged, larger than any camera's, or not of 8 or 16 bits.
    """
    import numpy as np

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
            f"declares {width} x {height} pixels of {promised.channels} channel(s), "
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


def _decoded_by_opencv(data: bytes | bytearray, kind: str) -> "Picture":
    import cv2
    import numpy as np

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # a damaged file is refused in our words
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


def _tiff_layout(file: BinaryIO) -> _Layout:
    tags = _Tags(file)
    bits, formats = set(tags.numbers(258, (1,))), set(tags.numbers(339, (1,)))
    photometric = tags.number(262, -1)
    if photometric not in (1, 2):
        other = f"has the unknown photometric interpretation {photometric}"
        raise PictureError(_PHOTOMETRICS.get(photometric, other))
    if formats != {1} or bits not in ({8}, {16}):
        kinds = "/".join(_FORMATS.get(number, "unknown") for number in sorted(formats))
        held = f"{kinds}{'/'.join(map(str, sorted(bits)))}"
        raise PictureError(f"holds {held} values; 8- or 16-bit integers are expected")
    promised = _sane(Declared(tags.number(257), tags.number(256), tags.number(277, 1), bits.pop()))
    if photometric == 2 and promised.channels < 3:
        raise PictureError(f"is damaged: it is RGB and has {promised.channels} channel(s)")
    compression, predictor = tags.number(259, 1), tags.number(317, 1)
    if compression not in (*_NONE, *_LZW, *_DEFLATE, *_PACKBITS):
        name = "JPEG" if compression in (6, 7) else f"number {compression}"
        raise PictureError(f"is compressed by {name}; none, deflate, LZW or PackBits are expected")
    if predictor not in (1, 2):
        raise PictureError(f"has the predictor {predictor}; none or horizontal differences are expected")
    if tags.number(266, 1) != 1:
        raise PictureError("holds its bits from the lowest on (FillOrder 2); save it with the usual order")
    planes = tags.number(284, 1)
    tiled = 324 in tags
    tile = (tags.number(323), tags.number(322)) if tiled else None
    rows = tile[0] if tile else min(tags.number(278, promised.height), promised.height)
    if planes not in (1, 2) or rows < 1 or (tile and (min(tile) < 1 or max(tile) > WIDEST_PX)):
        raise PictureError("is damaged: its values are laid out in no way that can be")
    offsets, counts = (tags.numbers(code) for code in ((324, 325) if tiled else (273, 279)))
    if len(offsets) != len(counts):
        raise PictureError("is damaged: it has offsets and lengths of different number")
    layout = _Layout(
        promised,
        compression,
        predictor,
        promised.channels > 1 and planes == 2,
        tags.order == ">",
        tile,
        rows,
        tuple(zip(offsets, counts, strict=True)),
        tags.place_of.get(274),
    )
    _check_places(layout, tags)
    return layout


class _Tags:
    """The tags of a TIFF's one picture, as far as they are whole numbers; TIFF 6.0, and BigTIFF."""

    def __init__(self, file: BinaryIO) -> None:
        """Read them.

        Raises:
            PictureError: the file is cut short, its tags are damaged, or it holds several pictures.
        """
        self._file = file
        self.size = file.seek(0, io.SEEK_END)
        self.order = "<" if self._read(0, 2) == b"II" else ">"
        self._big = 43 in self._read(2, 2)
        self.place_of: dict[int, int] = {}
        """Byte of the file at which a tag's values stand."""
        self.places: list[tuple[int, int]] = [(0, 16 if self._big else 8)]
        """(offset, bytes) of everything but the picture's values."""
        self._found: dict[int, tuple[int, int]] = {}
        at = self._at("HHQ", 4)[2] if self._big else self._at("I", 4)[0]
        seen: list[int] = []
        while at:
            if at in seen or len(seen) == 1000:
                raise PictureError("is damaged: its pictures refer to each other in a circle")
            following = self._directory(at, first=not seen)
            seen.append(at)
            at = following
        if len(seen) != 1:
            raise PictureError(f"holds {len(seen)} pictures; a file holds one")

    def _read(self, at: int, count: int) -> bytes:
        if at + count > self.size:
            raise PictureError(f"is truncated: the TIFF has {self.size} bytes and needs {at + count}")
        self._file.seek(at)
        return self._file.read(count)

    def _at(self, form: str, at: int) -> tuple[int, ...]:
        return struct.unpack(self.order + form, self._read(at, struct.calcsize("=" + form)))

    def _directory(self, at: int, *, first: bool) -> int:
        """Where the next picture's tags stand, 0 for none; the first one's are kept."""
        count_form, entry_form, offset_form = ("Q", "HHQ", "Q") if self._big else ("H", "HHI", "I")
        wide = struct.calcsize("=" + entry_form)
        inside = struct.calcsize("=" + offset_form)
        (count,) = self._at(count_form, at)
        begin = at
        at += struct.calcsize("=" + count_form)
        for _ in range(count if first else 0):
            code, kind, length = self._at(entry_form, at)
            if kind not in _TYPES:
                raise PictureError(f"is damaged: its tag {code} is of the unknown type {kind}")
            place = at + wide
            if length * _TYPES[kind] > inside:
                (place,) = self._at(offset_form, place)
                self.places.append((place, length * _TYPES[kind]))
            if code in self._found:
                raise PictureError(f"is damaged: its tag {code} stands twice")
            self._found[code] = kind, length
            self.place_of[code] = place
            at += wide + inside
        if first:
            self.places.append((begin, at + inside - begin))
        else:
            at += count * (wide + inside)
        return self._at(offset_form, at)[0]

    def __contains__(self, code: int) -> bool:
        return code in self._found

    def numbers(self, code: int, default: tuple[int, ...] | None = None) -> tuple[int, ...]:
        """The whole numbers of a tag."""
        if code not in self._found:
            if default is None:
                raise PictureError(f"is damaged: its tag {code} is missing")
            return default
        kind, length = self._found[code]
        if kind not in _WHOLE or not 0 < length <= _MOST_NUMBERS:
            raise PictureError(f"is damaged: its tag {code} holds no whole numbers")
        return self._at(f"{length}{_WHOLE[kind]}", self.place_of[code])

    def number(self, code: int, default: int | None = None) -> int:
        """The one whole number of a tag."""
        numbers = self.numbers(code, None if default is None else (default,))
        if len(numbers) != 1:
            raise PictureError(f"is damaged: its tag {code} holds {len(numbers)} numbers, not one")
        return numbers[0]


def _check_places(layout: _Layout, tags: _Tags) -> None:
    part = "tile" if layout.tile else "strip"
    if len(layout.places) != layout.count:
        raise PictureError(f"is damaged: it has {len(layout.places)} {part}s of values and needs {layout.count}")
    if not all(offset and count for offset, count in layout.places):
        raise PictureError(f"is damaged: a {part} of its values is missing")
    ends = {True: 0, False: 0}  # of values so far, and of tags; two tags may share a place
    for offset, count, values in sorted(
        [*((*place, True) for place in layout.places), *((*place, False) for place in tags.places)]
    ):
        if offset < max(ends.values() if values else [ends[True]]):
            raise PictureError(f"is damaged: a {part} of its values lies over another, or over its tags")
        ends[values] = max(ends[values], offset + count)
    if ends[True] > tags.size:
        raise PictureError(f"is truncated: the TIFF has {tags.size} bytes and needs {ends[True]}")


def _decode_tiff(data: bytes) -> "Picture":
    layout = _tiff_layout(io.BytesIO(data))
    if layout.compression not in _LZW:
        return _assembled(data, layout)
    if layout.apart:
        raise PictureError("is LZW and keeps its channels apart; save it with deflate, or pixel by pixel")
    if layout.orientation_at is None:
        return _decoded_by_opencv(data, "TIFF")
    # OpenCV would turn the picture; raw keeps the sensor's orientation
    upright = bytearray(data)
    upright[layout.orientation_at : layout.orientation_at + 2] = (1).to_bytes(
        2, "big" if layout.big_endian else "little"
    )
    return _decoded_by_opencv(upright, "TIFF")


def _assembled(data: bytes, layout: _Layout) -> "Picture":
    """The picture of strips or tiles that are plain, deflated or PackBits."""
    import numpy as np

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
        elif layout.compression in _PACKBITS:
            values = _unpacked(bytes(values), needed)
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
        inflated = inflater.decompress(values, needed + 1)
    except zlib.error as error:
        raise PictureError(f"is damaged: its values cannot be inflated ({error})") from None
    if not inflater.eof:
        raise PictureError("is damaged: its deflated values have no end, or are more than it declares")
    return inflated


def _unpacked(values: bytes, needed: int) -> bytes:
    """PackBits: n < 128: n + 1 values as they are; n > 128: one value 257 - n times; 128: nothing."""
    unpacked = bytearray()
    at = 0
    while at < len(values) and len(unpacked) <= needed:
        n = values[at]
        if n < 128:
            unpacked += values[at + 1 : at + 2 + n]
            at += 2 + n
        elif n > 128:
            unpacked += values[at + 1 : at + 2] * (257 - n)
            at += 2
        else:
            at += 1
    return bytes(unpacked)


def linear_from_srgb(picture: "Picture") -> "Picture":
    """Undo the sRGB curve (IEC 61966-2-1): integers of either depth to linear uint16, full scale 65535."""
    import numpy as np

    top = np.iinfo(picture.dtype).max
    codes = np.arange(top + 1) / top
    linear = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
    table = np.round(linear * 65535).astype(np.uint16)
    decoded = np.empty(picture.shape, np.uint16)
    for target, row in zip(decoded, picture, strict=True):
        target[...] = table[row]  # a row at a time: the indices take eight bytes a value
    return decoded

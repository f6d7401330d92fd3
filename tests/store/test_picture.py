"""Pictures: every kind reads exactly, and what is damaged, cut short or out of all measure is refused."""

import io
import itertools
import struct
import zlib
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from lightstage.store.picture import PictureError, declared, decode

SIZE = (20, 28)


def values(bits: int, channels: int) -> NDArray[Any]:
    """A slope with noise, so that no two rows are alike."""
    noise = np.random.default_rng(bits + channels).integers(0, 9, (*SIZE, channels))
    slope = np.add.outer(np.arange(SIZE[0]) * 3, np.arange(SIZE[1]) * 2)[..., None] * np.arange(1, channels + 1)
    picture = (slope + noise).astype(np.uint8 if bits == 8 else np.uint16)
    return picture[..., 0] if channels == 1 else picture


def tiff(picture: NDArray[Any], **options: Any) -> bytes:
    file = io.BytesIO()
    colour = "rgb" if picture.ndim == 3 else "minisblack"
    if not options.get("tile"):
        options.setdefault("rowsperstrip", 7)
    tifffile.imwrite(file, picture, photometric=colour, **options)
    return file.getvalue()


def by_opencv(picture: NDArray[Any], extension: str, *options: int) -> bytes:
    order = picture if picture.ndim == 2 else picture[..., ::-1]
    done, data = cv2.imencode(extension, order, options)
    assert done
    return data.tobytes()


def kinds() -> dict[str, tuple[bytes, NDArray[Any], bool]]:
    """Name -> (file, its values, whether they have a checksum)."""
    found = {}
    for bits, channels in itertools.product((8, 16), (1, 3)):
        picture = values(bits, channels)
        name = f"{bits} bits x {channels}"
        found[f"png {name}"] = by_opencv(picture, ".png"), picture, True
        for order, big, tile in itertools.product("<>", (False, True), (None, (16, 16))):
            layout = {"byteorder": order, "bigtiff": big, "tile": tile}
            label = f"{name} {order}{' big' if big else ''}{' tiles' if tile else ''}"
            found[f"plain {label}"] = tiff(picture, **layout), picture, False
            for predictor in (1, 2):
                data = tiff(picture, compression="zlib", predictor=predictor, **layout)
                found[f"deflate {predictor} {label}"] = data, picture, True
        for compression, scheme in (("lzw", 5), ("packbits", 32773)):
            for predictor in (1, 2) if scheme == 5 else (1,):
                options = (cv2.IMWRITE_TIFF_COMPRESSION, scheme, cv2.IMWRITE_TIFF_PREDICTOR, predictor)
                found[f"{compression} {predictor} {name}"] = by_opencv(picture, ".tiff", *options), picture, False
    apart = values(16, 3)
    file = io.BytesIO()
    tifffile.imwrite(
        file, np.moveaxis(apart, 2, 0), photometric="rgb", planarconfig="separate", compression="zlib", predictor=2
    )
    found["channels apart"] = file.getvalue(), apart, True
    return found


KINDS = kinds()


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_reads_exactly_and_says_its_size_before(kind: str) -> None:
    data, picture, _ = KINDS[kind]
    found = decode(data)
    assert found.dtype == picture.dtype
    np.testing.assert_array_equal(found, picture)
    said = declared(io.BytesIO(data))
    assert (said.shape, said.bits) == (SIZE, picture.dtype.itemsize * 8)


def test_damage_is_refused_where_there_is_a_checksum_and_never_ends_in_anything_else() -> None:
    random = np.random.default_rng(13)
    names = list(KINDS)
    places = {}
    for name, (data, _, _) in KINDS.items():
        if data[:4] == b"\x89PNG":
            places[name] = [(0, len(data))]
        else:
            with tifffile.TiffFile(io.BytesIO(data)) as file:
                page = file.pages[0]
                places[name] = [(o, o + n) for o, n in zip(page.dataoffsets, page.databytecounts, strict=True)]
    refused = 0
    for trial in range(4000):
        name = names[trial % len(names)]
        data, picture, checked = KINDS[name]
        harmed = bytearray(data)
        begin = end = int(random.integers(len(data)))
        match int(random.integers(5)):
            case 0:
                harmed[begin] ^= 1 << int(random.integers(8))
            case 1:
                del harmed[begin:]
                end = len(data) - 1
            case 2:
                end = min(len(data), begin + int(random.integers(1, 9))) - 1
                harmed[begin : end + 1] = random.bytes(end + 1 - begin)
            case 3:
                end = min(len(data), begin + int(random.integers(1, 65))) - 1
                harmed[begin : end + 1] = bytes(end + 1 - begin)
            case _:
                number = int(random.choice([0, 1, 2, 8, 255, 65535, 2**31, 2**32 - 1]))
                field = struct.pack("<I" if random.integers(2) else ">I", number)[: len(data) - begin]
                end = begin + len(field) - 1
                harmed[begin : begin + len(field)] = field
        try:
            found = decode(bytes(harmed))
        except PictureError:
            refused += 1
            continue
        if checked and any(first <= begin and end < last for first, last in places[name]):
            assert np.array_equal(found, picture), f"{name}: bytes {begin} to {end} altered, and not noticed"
    assert refused > 2000


def entry(data: bytes, code: int, order: str = "<") -> int:
    """Where the value of a tag stands in a small TIFF."""
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, at)
    for i in range(count):
        if struct.unpack_from(f"{order}H", data, at + 2 + 12 * i)[0] == code:
            place: int = at + 2 + 12 * i + 8
            return place
    raise LookupError(code)


def with_tag(code: int, value: int, *, index: int | None = None) -> Callable[[], bytes]:
    """A plain TIFF of three strips with another value of a tag, or of one of its values."""

    def made() -> bytes:
        data = bytearray(tiff(values(16, 1)))
        place = entry(bytes(data), code)
        if index is not None:
            form = "<H" if data[place - 6] == 3 else "<I"
            place = struct.unpack_from("<I", data, place)[0] + struct.calcsize(form) * index
            struct.pack_into(form, data, place, value)
        else:
            struct.pack_into("<I", data, place, value)
        return bytes(data)

    return made


OFFSETS, COUNTS, WIDTH, HEIGHT, ROWS = 273, 279, 256, 257, 278


def second_over_first() -> bytes:
    data = bytearray(tiff(values(16, 1)))
    at = struct.unpack_from("<I", data, entry(bytes(data), OFFSETS))[0]
    data[at + 4 : at + 8] = data[at : at + 4]
    return bytes(data)


def deflated(change: Callable[[bytes], bytes]) -> Callable[[], bytes]:
    """A TIFF of one deflated strip, its values deflated anew from other ones."""

    def made() -> bytes:
        picture = values(16, 1)
        data = tiff(picture, compression="zlib", rowsperstrip=SIZE[0])
        begin = struct.unpack_from("<I", data, entry(data, OFFSETS))[0]
        stream = change(picture.tobytes())
        whole = bytearray(data[:begin] + stream)
        struct.pack_into("<I", whole, entry(data, COUNTS), len(stream))
        return bytes(whole)

    return made


def spoilt_checksum(plain: bytes) -> bytes:
    stream = zlib.compress(plain)
    return stream[:-1] + bytes([stream[-1] ^ 1])


def packed(runs: bytes) -> Callable[[], bytes]:
    """A TIFF of one PackBits strip that holds `runs`."""

    def made() -> bytes:
        data = bytearray(tiff(values(8, 1), rowsperstrip=SIZE[0]))
        begin = struct.unpack_from("<I", data, entry(bytes(data), OFFSETS))[0]
        struct.pack_into("<I", data, entry(bytes(data), COUNTS), len(runs))
        struct.pack_into("<H", data, entry(bytes(data), 259), 32773)
        return bytes(data[:begin]) + runs

    return made


ROW = bytes([SIZE[1] - 1, *range(SIZE[1])])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (with_tag(OFFSETS, 0, index=1), "a strip of its values is missing"),
        (with_tag(COUNTS, 0, index=1), "a strip of its values is missing"),
        (with_tag(COUNTS, 100, index=1), "from row 7, column 0 on are 100 bytes, not 392"),
        (second_over_first, "a strip of its values lies over another"),
        (with_tag(OFFSETS, 4, index=0), "a strip of its values lies over another, or over its tags"),
        (with_tag(OFFSETS, 1 << 30, index=2), "is truncated"),
        (with_tag(WIDTH, 0), "declares 0 x 20 pixels"),
        (with_tag(HEIGHT, 0), "declares 28 x 0 pixels"),
        (with_tag(HEIGHT, 60000), "declares 28 x 60000 pixels; a side has at most 16384"),
        (with_tag(HEIGHT, 30), "it has 3 strips of values and needs 5"),
        (with_tag(ROWS, 0), "laid out in no way that can be"),
        (deflated(spoilt_checksum), "incorrect data check"),
        (deflated(lambda plain: zlib.compress(plain[:-56])), "are 1064 bytes, not 1120"),
        (deflated(lambda plain: zlib.compress(plain + plain)), "more than it declares"),
        (deflated(lambda plain: zlib.compress(plain)[:-2]), "have no end"),
        (packed(ROW * (SIZE[0] - 1)), "are 532 bytes, not 560"),
        (packed(ROW * (SIZE[0] + 1)), "are 588 bytes, not 560"),
    ],
)
def test_a_tiff_that_contradicts_itself_is_refused(make: Callable[[], bytes], message: str) -> None:
    with pytest.raises(PictureError) as caught:
        decode(make())
    assert message in str(caught.value)


def part(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png(width: int, height: int, bits: int, colour: int, *parts: bytes) -> bytes:
    header = part(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + b"".join(parts) + part(b"IEND", b"")


ROWS_OF_8 = part(b"IDAT", zlib.compress(bytes(5 * 8)))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (png(60000, 60000, 16, 0, ROWS_OF_8), "declares 60000 x 60000 pixels; a side has at most 16384"),
        (png(16000, 16000, 16, 6, ROWS_OF_8), "pixels of 4 channel(s), 1953 MiB; at most 640 are read"),
        (png(0, 4, 8, 0, ROWS_OF_8), "there is no picture in it"),
        (png(4, 8, 8, 9, ROWS_OF_8), "colour type 9 does not exist"),
        (png(4, 9, 8, 0, ROWS_OF_8), "its values are damaged or cut short"),
        (png(4, 8, 8, 0), "its values are damaged or cut short"),
        (png(4, 8, 8, 0, part(b"acTL", struct.pack(">II", 2, 0)), ROWS_OF_8), "is an animation"),
        (png(4, 8, 8, 0, ROWS_OF_8)[:20], "is truncated"),
    ],
)
def test_a_png_out_of_all_measure_or_with_fewer_rows_is_refused(data: bytes, message: str) -> None:
    with pytest.raises(PictureError) as caught:
        decode(data)
    assert message in str(caught.value)


def test_the_largest_cameras_pictures_may_be_read() -> None:
    for width, height, bits, colour in ((14204, 10652, 16, 0), (11648, 8736, 16, 2), (9504, 6336, 16, 2)):
        assert declared(io.BytesIO(png(width, height, bits, colour))).shape == (height, width)


def test_an_orientation_does_not_turn_the_values() -> None:
    picture = values(16, 1)
    np.testing.assert_array_equal(decode(tiff(picture, extratags=[(274, "H", 1, 6, True)])), picture)
    data = bytearray(by_opencv(picture, ".tiff", cv2.IMWRITE_TIFF_COMPRESSION, 5))
    place = entry(bytes(data), 284)  # the planes, which are together anyway
    struct.pack_into("<H", data, place - 8, 274)
    struct.pack_into("<H", data, place, 6)
    np.testing.assert_array_equal(decode(bytes(data)), picture)

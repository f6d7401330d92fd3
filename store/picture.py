"""Integer pictures: 8- and 16-bit PNG and TIFF, whole or refused.

OpenCV decodes, but it returns a half-filled picture for some truncated files, so the containers are checked
first: every PNG chunk against its checksum, every TIFF strip against the file's length.
"""

import io
import os
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[Any]
EXTENSIONS = (".png", ".tif", ".tiff")


class PictureError(ValueError):
    """The file is not a whole picture; the message does not name it, the caller does."""


def read_file(path: Path) -> tuple[bytes, tuple[int, int, int]]:
    """The bytes of a file and its (size, mtime, inode), which did not change while it was read.

    Raises:
        PictureError: the file is missing, unreadable, or was written to in the meantime.
    """
    try:
        with open(path, "rb") as file:
            before = os.fstat(file.fileno())
            data = file.read()
            after = os.stat(path)
    except FileNotFoundError:
        raise PictureError("is missing") from None
    except OSError as error:
        raise PictureError(f"cannot be read ({error.strerror})") from None
    stamp = (before.st_size, before.st_mtime_ns, before.st_ino)
    if stamp != (after.st_size, after.st_mtime_ns, after.st_ino) or len(data) != before.st_size:
        raise PictureError("changed while it was read; wait until it is complete")
    return data, stamp


def decode(data: bytes) -> Picture:
    """Decode a picture as it is stored: (y, x) or (y, x, channel) in R, G, B order, uint8 or uint16.

    Raises:
        PictureError: not a PNG or TIFF, truncated, damaged, or not of 8 or 16 bits.
    """
    if not data:
        raise PictureError("is empty")
    if data[:8] == b"\x89PNG\r\n\x1a\n":
        _check_png(data)
        return _decode_png(data)
    if data[:4] in (b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+"):
        return _decode_tiff(data)
    raise PictureError("is not a PNG or TIFF picture")


def _check_png(data: bytes) -> None:
    offset = 8
    while offset + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, offset)
        end = offset + 12 + length
        if end > len(data):
            break
        (checksum,) = struct.unpack_from(">I", data, end - 4)
        if zlib.crc32(memoryview(data)[offset + 4 : end - 4]) != checksum:
            raise PictureError(f"is damaged: its {kind.decode('latin-1')} part fails the checksum")
        if kind == b"IEND":
            return
        offset = end
    raise PictureError(f"is truncated: the PNG ends after {len(data)} bytes without an end mark")


def _decode_png(data: bytes) -> Picture:
    import cv2

    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise PictureError("cannot be decoded as PNG")
    if picture.ndim == 3:
        order = [2, 1, 0, *range(3, picture.shape[2])]
        picture = np.ascontiguousarray(picture[:, :, order])
    return np.asarray(picture)


def _decode_tiff(data: bytes) -> Picture:
    import cv2
    import tifffile

    try:
        with tifffile.TiffFile(io.BytesIO(data)) as file:
            page = file.pages[0]
            ends = [o + n for o, n in zip(page.dataoffsets, page.databytecounts, strict=True)]
            if max(ends, default=0) > len(data):
                raise PictureError(f"is truncated: the TIFF has {len(data)} bytes and needs {max(ends)}")
            if len(file.pages) > 1:
                raise PictureError(f"holds {len(file.pages)} pictures; a file holds one")
            if page.photometric == tifffile.PHOTOMETRIC.MINISWHITE:
                raise PictureError("counts from white (MINISWHITE); save it so that 0 is black")
            if page.dtype not in (np.uint8, np.uint16):
                raise PictureError(f"holds {page.dtype} values; 8- or 16-bit integers are expected")
            if page.compression == tifffile.COMPRESSION.NONE:
                return np.asarray(page.asarray())
    except PictureError:
        raise
    except Exception as error:  # noqa: BLE001  tifffile raises many kinds
        raise PictureError(f"cannot be decoded as TIFF ({error})") from None
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise PictureError("cannot be decoded as TIFF")
    return np.ascontiguousarray(picture[:, :, ::-1]) if picture.ndim == 3 else np.asarray(picture)


def linear_from_srgb(picture: Picture) -> Picture:
    """Undo the sRGB curve (IEC 61966-2-1): integers of either depth to linear uint16, full scale 65535."""
    top = np.iinfo(picture.dtype).max
    codes = np.arange(top + 1) / top
    linear = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
    table = np.round(linear * 65535).astype(np.uint16)
    return np.asarray(table[picture])

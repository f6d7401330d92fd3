"""Content digests: 128 bits of xxh3, as 32 hexadecimal digits.

Two kinds. The digest of a *value* does not depend on how it is stored: numbers and text go through
canonical JSON, arrays through dtype, shape and their bytes in C order. The digest of *bytes* is of exactly
what lies on disk, and is what `verify` checks. xxh3 guards against accidents, not against an adversary.
"""

import json
from typing import TYPE_CHECKING, Any

import xxhash

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

SHORT = 12  # digits shown in folder names


def digest_bytes(data: bytes | memoryview) -> str:
    """Digest of bytes as they are stored."""
    return xxhash.xxh3_128_hexdigest(data)


def digest_array(array: "NDArray[np.generic]") -> str:
    """Digest of an array's values, dtype and shape; the byte order and the memory layout do not count."""
    array = array.astype(array.dtype.newbyteorder("<"), order="C", copy=False)
    hasher = xxhash.xxh3_128(f"{array.dtype.str}{array.shape}".encode())
    hasher.update(array.data.cast("B") if array.size else b"")
    return hasher.hexdigest()


def digest_value(value: Any) -> str:
    """Digest of plain data: None, booleans, numbers, text, lists and dictionaries with text keys.

    1 and 1.0 are different values (models decide which one a field holds); -0.0 and 0.0 are the same.

    Raises:
        TypeError: for anything else, so that nothing is hashed by its address or its repr.
        ValueError: for NaN and infinities.
    """
    return digest_bytes(canonical(value).encode())


def canonical(value: Any) -> str:
    """The one text of plain data: keys sorted, no spaces, shortest float that reads back equal."""
    return _ENCODER.encode(_plain(value))


_ENCODER = json.JSONEncoder(sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


_LEAVES = frozenset({str, int, bool, type(None)})
"""Types of what is plain as it is: most of what there is."""


def _plain(value: Any) -> Any:
    if type(value) in _LEAVES:
        return value
    if isinstance(value, float):
        return value + 0.0
    if isinstance(value, dict):
        wrong = [key for key in value if not isinstance(key, str)]
        if wrong:
            raise TypeError(f"only text can be a key, found {wrong[0]!r}")
        return {key: item if type(item) in _LEAVES else _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [item if type(item) in _LEAVES else _plain(item) for item in value]
    if isinstance(value, int | str):
        return value
    raise TypeError(f"cannot digest a {type(value).__name__}")

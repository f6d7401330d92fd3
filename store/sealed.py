"""Small files that tell when they have changed: JSON whose first member is a digest of all that follows it.

    {"seal":"<xxh3-128 of every byte behind the closing quote>","format":"lightstage-session/1",...}

Anybody's program still reads them as JSON; checking costs one hash over the bytes, before anything is parsed. A
sealed file that was changed, cut short, or had its seal taken off is damaged. So is one that lies where another
belongs (a record under another key, a session under another name); whoever reads it checks that.
"""

import json
from collections.abc import Mapping
from typing import Any

from lightstage.store.digest import digest_bytes
from lightstage.store.errors import DamagedFileError

_BEFORE, _AFTER = b'{"seal":"', b'"'
_HEAD = len(_BEFORE) + 32 + len(_AFTER)


def seal(plain: Mapping[str, Any], *, indent: int | None = None) -> bytes:
    """The bytes of a sealed file. `indent` spreads it over lines, for files that people look into."""
    if "seal" in plain:
        raise ValueError("'seal' is the first member of every sealed file, and cannot be one of its own")
    text = json.dumps(dict(plain), indent=indent, separators=None if indent else (",", ":"))
    rest = ("," if plain else "").encode() + text[1:].encode()
    return _BEFORE + digest_bytes(rest).encode() + _AFTER + rest


def is_sealed(data: bytes) -> bool:
    """Whether the bytes begin with a seal, right or wrong."""
    return data.startswith(_BEFORE)


def intact(data: bytes) -> bool:
    """Whether the bytes are sealed, and the seal is right."""
    view = memoryview(data)
    return view[:_HEAD] == _BEFORE + digest_bytes(view[_HEAD:]).encode() + _AFTER


def unseal(data: bytes, path: object, remedy: str = "`lightstage verify` says what can be done") -> dict[str, Any]:
    """What a sealed file says, without its seal.

    Raises:
        DamagedFileError: the seal is not there, or is not the one of these bytes.
    """
    if not intact(data):
        raise DamagedFileError(path, remedy)
    plain: dict[str, Any] = json.loads(data)
    del plain["seal"]
    return plain

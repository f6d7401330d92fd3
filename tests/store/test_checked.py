"""A group read with every byte checked."""

import asyncio
from pathlib import Path

import pytest
from zarr.abc.store import ByteRequest, OffsetByteRequest, RangeByteRequest, SuffixByteRequest
from zarr.core.buffer import default_buffer_prototype

from lightstage.store.checked import CheckedStore
from lightstage.store.digest import digest_bytes
from lightstage.store.errors import DamagedGroupError

DATA = b"0123456789"


@pytest.fixture
def group(tmp_path: Path) -> CheckedStore:
    (tmp_path / "a").write_bytes(DATA)
    (tmp_path / "stray").write_bytes(DATA)
    return CheckedStore(tmp_path, {"a": digest_bytes(DATA), "gone": digest_bytes(b"")})


@pytest.mark.parametrize(
    ("part", "wanted"),
    [
        (None, DATA),
        (RangeByteRequest(2, 5), b"234"),
        (OffsetByteRequest(7), b"789"),
        (SuffixByteRequest(3), b"789"),
        (SuffixByteRequest(0), b""),
    ],
)
def test_parts_come_from_the_whole_that_was_checked(
    group: CheckedStore, part: ByteRequest | None, wanted: bytes
) -> None:
    prototype = default_buffer_prototype()
    (several,) = asyncio.run(group.get_partial_values(prototype, [("a", part)]))
    for found in (asyncio.run(group.get("a", byte_range=part)), group.get_sync("a", byte_range=part), several):
        assert found is not None
        assert found.to_bytes() == wanted
    Path(group.root / "a").write_bytes(DATA[:-1] + b"8")
    with pytest.raises(DamagedGroupError, match="its bytes are not the ones that were stored"):
        asyncio.run(group.get("a", byte_range=part))


def test_only_what_is_named_is_there(group: CheckedStore) -> None:
    assert asyncio.run(group.exists("a"))
    assert not asyncio.run(group.exists("stray"))
    assert asyncio.run(group.get("stray")) is None
    with pytest.raises(DamagedGroupError, match="cannot be read"):
        asyncio.run(group.get("gone"))
    with pytest.raises(ValueError, match="only read"):
        group.with_read_only(False)

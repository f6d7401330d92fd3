"""`store.json`: which store a folder is, and whether this program reads it."""

import json
from pathlib import Path

import pytest

from lightstage.store import marker
from lightstage.store.errors import RequestError, WorkError
from lightstage.store.marker import FORMAT, DamagedMarkerError, Marker, other_format


def put(root: Path, data: bytes) -> None:
    (root / "store.json").write_bytes(data)


@pytest.mark.parametrize(
    "stored", [Marker(FORMAT, "ab" * 16), Marker(1, "", upgrading=True), Marker(FORMAT + 1, "x")]
)
def test_what_is_written_is_read(tmp_path: Path, stored: Marker) -> None:
    put(tmp_path, stored.as_bytes())
    assert marker.read(tmp_path) == stored


def test_the_file_says_what_the_folder_is_to_anybody_who_reads_json() -> None:
    plain = json.loads(Marker(2, "7" * 32).as_bytes())
    assert list(plain) == ["seal", "format", "id"]
    assert (plain["format"], plain["id"]) == ("lightstage-store/2", "7" * 32)


def test_no_two_new_stores_are_one() -> None:
    ids = {Marker.new().id for _ in range(100)}
    assert len(ids) == 100
    assert all(len(name) == 32 and int(name, 16) >= 0 for name in ids)


def test_a_folder_without_the_file_says_nothing(tmp_path: Path) -> None:
    assert marker.read(tmp_path) is None
    assert marker.read(tmp_path / "gone") is None
    put(tmp_path, b"")
    assert marker.read(tmp_path / "store.json") is None


def test_a_store_of_format_1_had_no_seal_and_no_id(tmp_path: Path) -> None:
    put(tmp_path, b'{"format": "lightstage-store/1"}')
    assert marker.read(tmp_path) == Marker(1, "")


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"[]",
        b"{}",
        b'{"format": "lightstage-store/two"}',
        b"\xff\xfe",
        b"[" * 100_000,
        b'{"format": "lightstage-store/2", "id": "x"}',  # a seal is missing
        Marker(FORMAT, "ab").as_bytes().replace(b'"ab"', b'"ac"'),
        Marker(FORMAT, "ab").as_bytes()[:-1],
    ],
)
def test_a_damaged_file_names_the_command_that_mends_it(tmp_path: Path, data: bytes) -> None:
    put(tmp_path, data)
    with pytest.raises(DamagedMarkerError, match="is damaged; `lightstage upgrade` looks through the store"):
        marker.read(tmp_path)


def test_a_file_of_another_program_is_not_called_damaged(tmp_path: Path) -> None:
    put(tmp_path, b'{"format": "bookstore/3"}')
    with pytest.raises(RequestError, match="says 'bookstore/3'; this program reads lightstage-store/2"):
        marker.read(tmp_path)


def test_a_store_that_is_gone_or_exchanged_is_noticed(tmp_path: Path) -> None:
    mine = Marker.new()
    with pytest.raises(WorkError, match="is gone"):
        mine.check(tmp_path)
    put(tmp_path, mine.as_bytes())
    mine.check(tmp_path)
    put(tmp_path, Marker.new().as_bytes())
    with pytest.raises(WorkError, match="was upgraded or exchanged in the meantime"):
        mine.check(tmp_path)


@pytest.mark.parametrize(
    ("stored", "sentence"),
    [
        (Marker(FORMAT - 1, ""), "was made by an older lightstage"),
        (Marker(FORMAT + 1, ""), "was made by a newer lightstage"),
        (Marker(FORMAT, "", upgrading=True), "is being upgraded"),
    ],
)
def test_why_another_format_is_not_used(tmp_path: Path, stored: Marker, sentence: str) -> None:
    refusal = other_format(stored, tmp_path)
    assert isinstance(refusal, RequestError)
    assert sentence in str(refusal)
    assert str(tmp_path) in str(refusal)
    assert other_format(Marker.new(), tmp_path) is None

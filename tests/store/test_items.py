"""Items in the store: named by their numbers alone, and refused when they are not what their name says."""

from pathlib import Path

import numpy as np
import pytest

from lightstage.store.errors import DamagedFileError, RequestError
from lightstage.store.items import (
    Item,
    StoredPicture,
    all_items,
    find_item,
    get_item,
    item_digest,
    item_names,
    not_valid_for,
    original_of,
    put_item,
)
from lightstage.store.root import Store
from lightstage.store.sealed import seal, unseal

DARK = np.array([[3, 4], [5, 6]], np.uint16)


def dark(store: Store, scale: float = 1.0, **notes: str) -> Item:
    picture = StoredPicture(store.chunks.put(DARK), DARK.dtype.str, DARK.shape)
    values = {"item": "dark", "scale": scale}
    return Item("dark", item_digest(values, {"CAM0": picture}), values, notes, {"CAM0": picture})


def test_an_item_and_its_file_come_back(store: Store) -> None:
    item = dark(store, rig="york")
    put_item(item, b"item: dark\n", store)
    back = get_item("dark", item.digest, store)
    assert back == item
    assert back.name == f"dark-{item.digest[:12]}"
    assert original_of(back, store) == b"item: dark\n"
    assert (store.calibration / back.name / "item.yaml").read_bytes() == b"item: dark\n"
    np.testing.assert_array_equal(back.pictures["CAM0"].load(store), DARK)
    assert get_item("dark", item.digest[:12], store) == item


def test_notes_are_no_part_of_a_name_and_the_newest_win(store: Store) -> None:
    first, second = dark(store, rig="york"), dark(store, rig="leeds")
    assert first.digest == second.digest != dark(store, scale=2.0).digest
    put_item(first, b"1", store)
    put_item(second, b"2", store)
    assert get_item("dark", first.digest, store).notes == {"rig": "leeds"}
    assert len(all_items(store)) == 1


def test_a_name_follows_from_numbers_and_pixels(store: Store) -> None:
    picture = StoredPicture(store.chunks.put(DARK), "<u2", DARK.shape)
    other = StoredPicture(store.chunks.put(DARK + 1), "<u2", DARK.shape)
    digests = {
        item_digest({"a": 1.0}, {}),
        item_digest({"a": 2.0}, {}),
        item_digest({"a": 1.0}, {"CAM0": picture}),
        item_digest({"a": 1.0}, {"CAM1": picture}),
        item_digest({"a": 1.0}, {"CAM0": other}),
    }
    assert len(digests) == 5
    assert item_digest({"b": 2, "a": 1}, {}) == item_digest({"a": 1, "b": 2}, {})


@pytest.mark.parametrize(
    "damage", ["flipped", "other numbers, sealed", "of another kind", "another item", "without pictures"]
)
def test_an_item_that_is_not_what_its_name_says_is_refused(store: Store, damage: str) -> None:
    item = dark(store)
    put_item(item, b"", store)
    path = store.calibration / item.name / "item.json"
    other = dark(store, scale=2.0)
    put_item(other, b"", store)
    plain = unseal(path.read_bytes(), path)
    path.write_bytes(
        {
            "flipped": path.read_bytes().replace(b'"scale": 1.0', b'"scale": 2.0'),
            "other numbers, sealed": seal({**plain, "values": {"item": "dark", "scale": 2.0}}),
            "of another kind": seal({**plain, "kind": "flat"}),
            "another item": (store.calibration / other.name / "item.json").read_bytes(),
            "without pictures": seal({k: v for k, v in plain.items() if k != "pictures"}),
        }[damage]
    )
    with pytest.raises(DamagedFileError, match=r"item\.json is damaged; import the capture"):
        get_item("dark", item.digest, store)


def test_an_item_that_is_not_there_is_named(store: Store) -> None:
    with pytest.raises(RequestError, match="the dark item 123456789012 is not in the store"):
        get_item("dark", "1234567890123456", store)


def test_an_item_is_known_by_the_beginning_of_its_name(store: Store) -> None:
    items = [dark(store), dark(store, scale=2.0)]
    for item in items:
        put_item(item, b"", store)
    assert item_names(store) == sorted(("dark", item.digest[:12]) for item in items)
    digits = next(n for n in range(1, 12) if items[0].digest[:n] != items[1].digest[:n])
    assert find_item(f"dark-{items[0].digest[:digits]}", store) == items[0]
    with pytest.raises(RequestError, match=r"'dark' may be dark-\w+ or dark-\w+; give more digits"):
        find_item("dark", store)
    with pytest.raises(RequestError, match=f"no calibration item 'dusk' in {store.root}"):
        find_item("dusk", store)


@pytest.mark.parametrize(
    ("notes", "rig", "captured", "reason"),
    [
        ({}, "york", "2010-03-12", None),
        ({"rig": "york"}, "york", None, None),
        ({"rig": "york"}, None, None, None),
        ({"rig": "york"}, "leeds", None, "it was measured on the rig 'york', the session is of 'leeds'"),
        ({"valid_from": "2010-03-12"}, None, "2010-03-12T09:00:00", None),
        ({"valid_from": "2010-03-12T18:00:00"}, None, "2010-03-12", None),
        ({"valid_from": "2010-03-12"}, None, None, None),
        (
            {"valid_from": "2010-03-12"},
            None,
            "2010-03-11",
            "it is valid from 2010-03-12, the session was captured on 2010-03-11",
        ),
    ],
)
def test_whether_an_item_holds_for_a_capture(
    notes: dict[str, str], rig: str | None, captured: str | None, reason: str | None
) -> None:
    assert not_valid_for(Item("dark", "0" * 32, {}, notes, {}), rig=rig, captured=captured) == reason


def test_an_item_that_is_stored_again_is_not_written_again(store: Store) -> None:
    put_item(dark(store), b"", store)
    paths: list[Path] = sorted(store.calibration.glob("*/item.*"))
    before = [path.stat().st_ino for path in paths]
    put_item(dark(store), b"", store)
    assert [path.stat().st_ino for path in paths] == before

"""Results: a group appears whole or not at all, never changes, and `current` names one that is there."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray

from lightstage.store.errors import RequestError, WorkError
from lightstage.store.grid import ArrayTemplate
from lightstage.store.notes import note_path, read_note
from lightstage.store.results import ResultName, current, current_path, lacks, provenance, publish, set_current
from lightstage.store.root import Store

NAME = ResultName("s", "stack", "aaaa", "bbbb")
VALUES = np.array([[1, 2, 3]], np.uint16)


def put(store: Store, name: ResultName = NAME, **more: Any) -> Path:
    return publish(
        name,
        store,
        arrays={"a": ArrayTemplate(("y", "x"), (1, 3), (1, 3), "uint16")},
        coordinates={},
        attrs={"units": "counts"},
        chunks={"a": {(0, 0): store.chunks.put(VALUES)}},
        provenance={"host": "here", **more},
    )


def test_a_group_is_where_its_name_says_and_opens_with_plain_xarray(store: Store) -> None:
    path = put(store)
    assert path == store.results / "s" / "stack" / "aaaa-bbbb" == NAME.path(store)
    with xarray.open_zarr(path, chunks=None) as opened:
        assert opened.a.values.tolist() == VALUES.tolist()
        assert opened.attrs == {"units": "counts"}
    record = provenance("s", "stack", "aaaa-bbbb", store)
    assert record is not None
    assert record["host"] == "here"
    assert lacks(path, record) == []
    assert provenance("s", "stack", "aaaa-cccc", store) is None


def test_a_group_that_is_there_is_left_and_one_that_is_not_whole_is_made_again(store: Store) -> None:
    path = put(store)
    inode = path.stat().st_ino
    assert put(store, host="elsewhere") == path
    assert path.stat().st_ino == inode
    assert read_note(path).content["host"] == "here"
    (path / "a" / "c.0.0").unlink()
    put(store, host="elsewhere")
    assert (path / "a" / "c.0.0").is_file()
    assert read_note(path).content["host"] == "elsewhere"


def test_two_who_publish_the_same_at_once_agree(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.rename
    waiting = [lambda: put(store)]

    def rename(source: Path, target: Path) -> None:
        if Path(target) == NAME.path(store) and waiting:
            waiting.pop()()
        real(source, target)

    monkeypatch.setattr(os, "rename", rename)
    path = put(store)
    assert sorted(p.name for p in path.parent.iterdir()) == ["aaaa-bbbb", "aaaa-bbbb.json"]
    assert (path / "a" / "c.0.0").is_file()


def test_a_group_that_cannot_be_finished_does_not_appear(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as patch:
        patch.setattr(os, "rename", refused)
        with pytest.raises(WorkError, match=r"the disk that holds .* fails \(Input/output error\)"):
            put(store)
    assert not NAME.path(store).exists()
    assert put(store).is_dir()


def test_what_a_group_lacks_is_named(store: Store) -> None:
    path = put(store)
    record = provenance("s", "stack", NAME.folder, store)
    assert record is not None
    (path / "a" / "c.0.0").unlink()
    assert lacks(path, record) == ["a/c.0.0"]
    (path / "a" / "c.0.0").write_bytes(b"short")
    assert lacks(path, record) == ["a/c.0.0"]
    (path / "zarr.json").unlink()
    assert lacks(path, record)[0] == "zarr.json"


def test_current_names_a_group_that_is_there(store: Store) -> None:
    assert current("s", "stack", store) is None
    put(store)
    assert current("s", "stack", store) is None
    assert set_current(NAME, store)
    assert current("s", "stack", store) == "aaaa-bbbb"
    assert current_path("s", "stack", store) == NAME.path(store)
    gone = ResultName("s", "stack", "aaaa", "dddd")
    assert not set_current(gone, store)
    assert current("s", "stack", store) is None
    (store.results / "s" / "stack" / "current").write_bytes(b"\xff\xfe")
    assert current("s", "stack", store) is None


def test_a_node_without_a_result_is_named_with_those_that_have_one(store: Store) -> None:
    with pytest.raises(RequestError, match=r"session 's' has no result of 'normals' yet \(it has none\)"):
        current_path("s", "normals", store)
    put(store)
    set_current(NAME, store)
    with pytest.raises(RequestError, match=r"it has stack\); `lightstage run normals --session s` computes it"):
        current_path("s", "normals", store)


def test_a_damaged_note_tells_nothing(store: Store) -> None:
    path = put(store)
    data = note_path(path).read_bytes()
    note_path(path).write_bytes(data.replace(b"here", b"hero"))
    assert provenance("s", "stack", NAME.folder, store) is None

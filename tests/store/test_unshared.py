"""A group in scratch, written by zarr: nothing is made above it, and no links are needed."""

import asyncio
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from zarr.core.buffer import default_buffer_prototype

from lightstage.store.unshared import UnsharedStore


def write(folder: Path) -> None:
    group = zarr.create_group(UnsharedStore(folder), zarr_format=3, attributes={"a": 1})
    group.create_array("x", data=np.arange(4))


def test_zarr_reads_what_zarr_wrote_with_its_own_store(tmp_path: Path) -> None:
    write(tmp_path / "group")
    group = zarr.open_group(str(tmp_path / "group"), mode="r")
    assert dict(group.attrs) == {"a": 1}
    array = group["x"]
    assert isinstance(array, zarr.Array)
    np.testing.assert_array_equal(array[:], [0, 1, 2, 3])


def test_no_links_are_needed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: Any, **__: Any) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", refused)
    write(tmp_path / "group")
    assert (tmp_path / "group" / "x" / "zarr.json").is_file()


def test_a_folder_that_was_moved_away_is_not_made_anew(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        write(tmp_path / "gone" / "group")
    assert not (tmp_path / "gone").exists()
    store = UnsharedStore(tmp_path / "group")
    buffer = default_buffer_prototype().buffer.from_bytes(b"1")
    asyncio.run(store.set("a/b", buffer))
    shutil.rmtree(tmp_path / "group")
    (tmp_path / "group").touch()  # not even in the place of a file
    with pytest.raises(OSError):  # noqa: PT011  which one is the system's choice
        asyncio.run(store.set("a/b", buffer))


def test_what_is_there_is_kept_where_that_is_asked_for(tmp_path: Path) -> None:
    store = UnsharedStore(tmp_path / "group")

    async def twice() -> bytes:
        make = default_buffer_prototype().buffer.from_bytes
        await store.set_if_not_exists("k", make(b"first"))
        await store.set_if_not_exists("k", make(b"second"))
        return (tmp_path / "group" / "k").read_bytes()

    assert asyncio.run(twice()) == b"first"

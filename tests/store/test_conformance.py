"""The local store, on folders with and without links, held to what every store must do; chunks and records
likewise.
"""

import contextlib
import errno
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from lightstage.store.digest import digest_bytes
from lightstage.store.errors import DamagedChunkError
from lightstage.store.files import files_below, put_if_absent, replace
from lightstage.store.records import BlockRecord
from lightstage.store.root import Store
from tests.store.conformance import Place, PlaceConformance


class Folder(Place):
    """The part of a local store that holds files by name."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._folder = store.root / "cache"

    def put(self, name: str, data: bytes) -> None:
        replace(self._store.scratch, self._folder / name, data)

    def put_if_absent(self, name: str, data: bytes) -> bool:
        return put_if_absent(self._store.scratch, self._folder / name, data)

    def get(self, name: str) -> bytes | None:
        try:
            return (self._folder / name).read_bytes()
        except FileNotFoundError:
            return None

    def names(self) -> list[str]:
        return sorted(Path(e.path).relative_to(self._folder).as_posix() for e in files_below(self._folder))

    def remove(self, name: str) -> None:
        self._store.scratch.remove(self._folder / name)

    def raw_get(self, name: str) -> bytes | None:
        path = self._folder / name
        return path.read_bytes() if path.is_file() else None

    def raw_put(self, name: str, data: bytes) -> None:
        (self._folder / name).parent.mkdir(parents=True, exist_ok=True)
        (self._folder / name).write_bytes(data)

    def raw_names(self) -> list[str]:
        return sorted(p.relative_to(self._folder).as_posix() for p in self._folder.rglob("*") if p.is_file())

    @contextlib.contextmanager
    def failing(self) -> Iterator[None]:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(os, "fsync", refuse(errno.ENOSPC))
            yield


def refuse(code: int) -> Callable[..., None]:
    def refused(*_: object, **__: object) -> None:
        raise OSError(code, os.strerror(code))

    return refused


class TestFolderWithLinks(PlaceConformance):
    @pytest.fixture
    def place(self, store: Store) -> Place:
        return Folder(store)


@pytest.mark.usefixtures("linkless")
class TestFolderWithoutLinks(PlaceConformance):
    @pytest.fixture(params=[errno.EPERM, errno.ENOSYS], ids=lambda code: errno.errorcode[code])
    def linkless(self, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(os, "link", refuse(request.param))

    @pytest.fixture
    def place(self, store: Store) -> Place:
        return Folder(store)


class TestFolderWithoutAnyLinks(PlaceConformance):
    @pytest.fixture
    def place(self, store: Store, monkeypatch: pytest.MonkeyPatch) -> Place:
        monkeypatch.setattr(os, "link", refuse(errno.EPERM))
        monkeypatch.setattr(os, "symlink", refuse(errno.EPERM))
        return Folder(store)


PIXELS = np.arange(12 * 16, dtype=np.uint16).reshape(12, 16)


def test_a_chunk_lies_under_the_digest_of_its_bytes(store: Store) -> None:
    ref = store.chunks.put(PIXELS)
    stored = (store.root / "cache" / "blobs" / ref.blob[:2] / ref.blob).read_bytes()
    assert digest_bytes(stored) == ref.blob
    assert len(stored) == ref.size
    assert np.array_equal(Store(store.root).chunks.get(ref, dtype="<u2", shape=(12, 16)), PIXELS)


def test_a_chunk_that_was_changed_past_the_store_is_refused_and_putting_it_again_heals_it(store: Store) -> None:
    ref = store.chunks.put(PIXELS)
    path = store.chunks.path(ref.blob)
    good = path.read_bytes()
    path.chmod(0o644)
    for bad in (good[:-1], good[:9] + bytes([good[9] ^ 1]) + good[10:], b"", good + b"\0"):
        path.write_bytes(bad)
        with pytest.raises(DamagedChunkError):
            Store(store.root).chunks.get(ref, dtype="<u2", shape=(12, 16))
        assert Store(store.root).chunks.put(PIXELS) == ref
        assert path.read_bytes() == good


def test_a_chunk_that_was_removed_past_the_store_is_not_there(store: Store) -> None:
    ref = store.chunks.put(PIXELS)
    store.chunks.path(ref.blob).unlink()
    fresh = Store(store.root).chunks
    assert not fresh.has(ref)
    with pytest.raises(DamagedChunkError):
        fresh.get(ref, dtype="<u2", shape=(12, 16))


def test_the_first_record_stays_and_a_changed_one_is_none(store: Store) -> None:
    refs = {name: (store.chunks.put(PIXELS + i),) for i, name in enumerate(("a", "b"))}
    first = BlockRecord("0" * 32, {"out": refs["a"]})
    assert store.records.put_block(first) == (first, True)
    standing, same = store.records.put_block(BlockRecord("0" * 32, {"out": refs["b"]}))
    assert (standing.outputs, same) == (first.outputs, False)
    (path,) = store.records.files("blocks")
    text = path.read_bytes()
    assert text.count(refs["a"][0].blob.encode()) == 1
    path.chmod(0o644)
    path.write_bytes(text.replace(refs["a"][0].blob.encode(), refs["b"][0].blob.encode()))
    assert Store(store.root).records.block("0" * 32) is None

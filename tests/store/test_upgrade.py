"""Carrying an older store over: a real one of format 1, made by the program of that time."""

import os
import subprocess
import sys
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray

from lightstage.store import marker, upgrade
from lightstage.store.errors import RequestError, WorkError
from lightstage.store.gc import gc
from lightstage.store.marker import FORMAT, Marker
from lightstage.store.root import Store
from lightstage.store.sealed import intact
from lightstage.store.sessions import read_session
from lightstage.store.verify import verify
from tests.conftest import Answer

KEPT = Path(__file__).parent.parent / "data" / "store-1.tar.xz"
"""Two sessions of one 8 x 8 capture, with items; all nodes of the one, `register` of the other."""


@pytest.fixture
def old(tmp_path: Path) -> Path:
    with tarfile.open(KEPT) as tar:
        tar.extractall(tmp_path, filter="data")
    return tmp_path / "store"


def pictures(root: Path) -> Any:
    with xarray.open_zarr(root / "sessions" / "ball" / "raw.zarr", chunks=None) as raw:
        return raw.raw.values


def small_files(root: Path) -> dict[str, bytes]:
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in root.rglob("*.json")
        if path.name != "zarr.json"
    }


def test_an_older_store_is_whole_afterwards_and_computes_nothing_anew(
    old: Path, lightstage: Callable[..., Answer]
) -> None:
    before = pictures(old)
    results = {path.relative_to(old) for path in old.glob("results/*/*/*-*/zarr.json")}
    refused = lightstage("run", "--session", "ball", store=old)
    assert (refused.code, "`lightstage upgrade`" in refused.err) == (2, True)
    done = lightstage("upgrade", "--json", store=old)
    assert (done.code, done.json["from"], done.json["to"], done.json["left"]) == (0, 1, FORMAT, [])
    assert done.json["carried"] == {"items": 2, "sessions": 2, "results": 7, "records": 24}
    assert all(intact(data) for data in small_files(old).values())
    checked = lightstage("verify", "--json", store=old).json
    assert (checked["damaged"], checked["strange"]) == ([], [])
    np.testing.assert_array_equal(pictures(old), before)
    assert all((old / path).is_file() for path in results)
    assert lightstage("run", "--session", "ball", store=old).code == 0
    assert gc(Store(old), grace_s=7 * 86400, dry_run=True).size == 0


def test_again_there_is_nothing_to_do(old: Path, lightstage: Callable[..., Answer]) -> None:
    assert lightstage("upgrade", store=old).code == 0
    before = small_files(old)
    again = lightstage("upgrade", store=old)
    assert again.code == 0
    assert "nothing to do" in again.out
    assert small_files(old) == before


def test_stopped_anywhere_it_goes_on_from_there(old: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Killed(BaseException):
        """As a kill: nothing is put in order."""

    real, kills = upgrade.replace, 0
    before = pictures(old)
    while kills < 100:
        left = iter(range(3))

        def write(*arguments: Any, left: Any = left, **options: Any) -> None:
            if next(left, None) is None:
                raise Killed
            real(*arguments, **options)

        monkeypatch.setattr(upgrade, "replace", write)
        try:
            upgrade.upgrade(old)
        except Killed:
            kills += 1
            with pytest.raises(RequestError, match="lightstage upgrade"):
                Store(old)
        else:
            break
    assert kills > 10
    assert verify(Store(old)).damaged == []
    np.testing.assert_array_equal(pictures(old), before)


def test_what_is_damaged_is_said_and_left(old: Path, lightstage: Callable[..., Answer]) -> None:
    path = old / "sessions" / "other" / "session.json"
    path.write_bytes(path.read_bytes()[:-10])
    broken = path.read_bytes()
    done = lightstage("upgrade", store=old)
    assert done.code == 1
    assert str(path) in done.out
    assert path.read_bytes() == broken
    assert lightstage("run", "register", "--session", "ball", store=old).code == 0


def test_not_while_another_process_uses_it(old: Path) -> None:
    living = old / "tmp" / f"{os.uname().nodename}~{os.getpid()}~0badcafe"
    living.mkdir(parents=True)
    with pytest.raises(WorkError, match=f"in use by process {os.getpid()}"):
        upgrade.upgrade(old)
    assert marker.read(old) == Marker(1, "")
    living.rmdir()
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        ended.wait()
    (old / "tmp" / f"{os.uname().nodename}~{ended.pid}~0badcafe").mkdir()
    assert upgrade.upgrade(old).began == 1


def test_two_upgrades_at_once_are_one(old: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = upgrade.STEPS[1]

    def meanwhile(*arguments: Any) -> None:
        with pytest.raises(WorkError, match="another `lightstage upgrade`"):
            upgrade.upgrade(old)
        real(*arguments)

    monkeypatch.setattr(upgrade, "STEPS", {1: meanwhile})
    assert upgrade.upgrade(old).carried["sessions"] == 2


def test_a_damaged_marker_is_made_anew_and_all_else_kept(store: Store, sphere: Path) -> None:
    from lightstage.store.importer import import_capture

    import_capture(sphere, store)
    (store.root / marker.NAME).write_bytes(b'{"seal": "')
    store.scratch.leave()
    done = upgrade.upgrade(store.root)
    assert not done.carried
    opened = Store(store.root)
    assert read_session("ball", opened).name == "ball"
    assert verify(opened).damaged == []


def test_there_must_be_a_store(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(RequestError, match="there is no store to upgrade"):
            upgrade.upgrade(folder)
    (tmp_path / marker.NAME).write_bytes(b'{"format": "lightstage-store/99"}')
    with pytest.raises(RequestError, match="newer lightstage"):
        upgrade.upgrade(tmp_path)

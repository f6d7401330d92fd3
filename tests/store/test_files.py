"""Files that are there whole or not at all: with links refused, for owners that live, and for what disks refuse."""

import contextlib
import errno
import multiprocessing
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import xarray

from lightstage.store import files
from lightstage.store.errors import WorkError
from lightstage.store.files import disk_faults_named, link_or_copy, move_new, put_if_absent, replace
from lightstage.store.grid import Coordinate, write_group
from lightstage.store.importer import import_capture
from lightstage.store.root import Store
from lightstage.store.verify import verify
from tests.conftest import REPOSITORY, Answer

REFUSALS = [errno.EPERM, errno.EXDEV, errno.ENOSYS, errno.ENOTSUP, errno.EINVAL, errno.EMLINK]


def refuse(code: int) -> Callable[..., None]:
    def refused(*_: object, **__: object) -> None:
        raise OSError(code, os.strerror(code))

    return refused


@pytest.fixture(params=REFUSALS, ids=lambda code: errno.errorcode[code])
def linkless(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """A file system that makes no links of either kind."""
    monkeypatch.setattr(os, "link", refuse(request.param))
    monkeypatch.setattr(os, "symlink", refuse(errno.ENOSYS if request.param == errno.EMLINK else request.param))
    return int(request.param)


@pytest.mark.parametrize("renames", [True, False], ids=["renameat2", "lock"])
def test_without_links_the_first_of_two_stays(
    linkless: int, renames: bool, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not renames:
        monkeypatch.setattr(files, "_rename_no_replace", lambda source, target: errno.EINVAL)
    path = store.root / "a" / "b" / "file"
    assert put_if_absent(store.scratch, path, b"first")
    assert not put_if_absent(store.scratch, path, b"second")
    assert path.read_bytes() == b"first"
    assert not list(store.scratch.path().parent.glob("[0-9]*"))


def test_without_links_one_of_many_at_once_is_first(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "link", refuse(errno.EPERM))
    monkeypatch.setattr(files, "_rename_no_replace", lambda source, target: errno.EINVAL)
    real, meeting = os.path.lexists, threading.Barrier(4, timeout=0.2)

    def together(path: object) -> bool:
        there = real(path)  # type: ignore[arg-type]
        with contextlib.suppress(threading.BrokenBarrierError):
            meeting.wait()  # without the lock all four would have looked before one has renamed
        return there

    monkeypatch.setattr(os.path, "lexists", together)
    won: list[bytes] = []

    def put(data: bytes) -> None:
        if put_if_absent(store.scratch, store.root / "file", data):
            won.append(data)

    threads = [threading.Thread(target=put, args=(bytes([i]),)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(won) == 1
    assert (store.root / "file").read_bytes() == won[0]


def all_of_it_works(lightstage: Callable[..., Answer], sphere: Path, store: Path, to: Path) -> None:
    """Import, run, change, gc, verify, export: with copies instead of links, and `raw.zarr` a folder."""
    assert lightstage("import", sphere, store=store).code == 0
    assert lightstage("run", "register", "--session", "ball", store=store).code == 0
    raw = Path(lightstage("path", "capture", "--session", "ball", store=store).out.strip())
    assert raw.is_dir()
    assert not raw.is_symlink()
    with xarray.open_zarr(raw, chunks=None) as opened:
        assert opened.raw.shape == (7, 1, 2, 48, 48)
    assert lightstage("verify", store=store).code == 0
    picture = sphere / "0004_Xc_576nm_CAM0.png"
    picture.write_bytes((sphere / "0005_Yc_576nm_CAM0.png").read_bytes())
    assert lightstage("import", sphere, store=store).code == 0
    done = lightstage("run", "register", "--session", "ball", "--json", store=store).json["nodes"]["register"]
    assert (done["computed"], done["reused"]) == (1, 6)
    before = size_of(store)
    freed = lightstage("gc", "--grace", "0s", "--json", store=store).json
    assert freed["results"] == 1
    assert before - size_of(store) == freed["bytes"]
    checked = lightstage("verify", "--json", store=store)
    assert (checked.code, checked.json["strange"]) == (0, [])
    assert sorted(path.name for path in raw.parent.glob("*raw*")) == ["raw.json", "raw.zarr"]
    again = lightstage("run", "register", "--session", "ball", "--json", store=store).json["nodes"]["register"]
    assert again["computed"] == 0
    assert (
        lightstage("export", "register", "--session", "ball", "--format", "npy", "--to", to, store=store).code == 0
    )
    assert any(to.iterdir())


def size_of(store: Path) -> int:
    """Bytes of all files, those with several names once."""
    files = {
        (s.st_dev, s.st_ino, s.st_nlink > 1 or str(p)): s.st_size
        for p in store.rglob("*")
        if (s := p.lstat()) and p.is_file() and not p.is_symlink()
    }
    return sum(files.values())


def test_without_links_all_of_it_works(
    lightstage: Callable[..., Answer], sphere: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "link", refuse(errno.EPERM))
    monkeypatch.setattr(os, "symlink", refuse(errno.ENOSYS))
    all_of_it_works(lightstage, sphere, tmp_path / "store", tmp_path / "out")


@pytest.fixture
def exfat(tmp_path: Path) -> Iterator[Path]:
    """A real exFAT disk of 64 MB."""
    image, place = tmp_path / "disk", tmp_path / "mounted"
    lacking = [name for name in ("mkfs.exfat", "losetup", "mount") if shutil.which(name) is None]
    if lacking or os.geteuid() != 0:
        pytest.skip(f"no exFAT disk can be made here: {', '.join(lacking) or 'only root mounts'}")
    with image.open("wb") as file:
        file.truncate(64_000_000)
    place.mkdir()
    subprocess.run(["mkfs.exfat", image], check=True, capture_output=True)
    device = subprocess.run(["losetup", "-f", "--show", image], capture_output=True, text=True, check=False)
    if device.returncode:
        pytest.skip(f"no exFAT disk can be mounted here: {device.stderr.strip()}")
    try:
        ways = [["mount", "-t", "exfat"], ["mount.exfat-fuse"]]
        said = []
        for way in ways:
            try:
                done = subprocess.run(
                    [*way, device.stdout.strip(), place], capture_output=True, text=True, check=False
                )
            except FileNotFoundError as error:
                said.append(str(error))
                continue
            if done.returncode == 0:
                break
            said.append(done.stderr.strip())
        else:
            pytest.skip(f"no exFAT disk can be mounted here: {'; '.join(said)}")
        yield place
        subprocess.run(["umount", "--lazy", place], check=True)  # a failed run may still hold its lock
    finally:
        subprocess.run(["losetup", "-d", device.stdout.strip()], check=False)


@pytest.mark.slow
def test_all_of_it_works_on_exfat(
    lightstage: Callable[..., Answer], sphere: Path, exfat: Path, tmp_path: Path
) -> None:
    all_of_it_works(lightstage, sphere, exfat / "store", tmp_path / "out")


@pytest.mark.slow
def test_a_full_exfat_disk_is_a_sentence(lightstage: Callable[..., Answer], sphere: Path, exfat: Path) -> None:
    assert lightstage("import", sphere, store=exfat / "store").code == 0
    with contextlib.suppress(OSError), open(exfat / "ballast", "wb", buffering=0) as file:
        while True:
            file.write(bytes(1 << 16))
    done = lightstage("run", "register", "--session", "ball", store=exfat / "store")
    assert done.code == 1
    assert "is full: nothing was lost" in done.err
    (exfat / "ballast").unlink()
    assert lightstage("verify", store=exfat / "store").code == 0
    assert lightstage("run", "register", "--session", "ball", store=exfat / "store").code == 0


def test_a_store_from_a_disk_without_links_goes_on_where_there_are_some(
    store: Store, sphere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as refused:
        refused.setattr(os, "symlink", refuse(errno.EPERM))
        import_capture(sphere, store)
    raw = store.sessions / "ball" / "raw.zarr"
    assert not raw.is_symlink()
    picture = sphere / "0004_Xc_576nm_CAM0.png"
    picture.write_bytes((sphere / "0005_Yc_576nm_CAM0.png").read_bytes())
    import_capture(sphere, store)
    assert raw.is_symlink()
    assert not raw.with_name("raw.json").exists()
    assert verify(store).damaged == []


def test_a_file_with_too_many_links_is_copied(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "link", refuse(errno.EMLINK))
    source, target = store.scratch.path(), store.scratch.path()
    source.write_bytes(b"pixels")
    os.utime(source, (0, 0))
    link_or_copy(source, target)
    assert target.read_bytes() == b"pixels"
    assert source.stat().st_mtime > 0  # said to be in use, as a link would have


# whose scratch folder it is


def leave_something(root: Path) -> None:
    Store(root).scratch.path().write_bytes(b"left")
    os._exit(0)


def test_what_a_killed_process_left_is_swept_and_what_lives_is_not(store: Store) -> None:
    mine = store.scratch.path()
    mine.write_bytes(b"at work")
    process = multiprocessing.get_context("fork").Process(target=leave_something, args=(store.root,))
    process.start()
    process.join()
    assert len(os.listdir(store.root / "tmp")) == 2
    Store(store.root).scratch.sweep()
    assert os.listdir(store.root / "tmp") == [mine.parent.name]
    assert mine.read_bytes() == b"at work"


def test_another_container_with_our_host_name_and_process_number_keeps_its_work(store: Store) -> None:
    """The process of that number does not live here; that of the lock does."""
    pid = 2**22 + 1  # beyond the largest process number
    theirs = store.root / "tmp" / f"{os.uname().nodename}~{pid}~0badcafe"
    theirs.mkdir(parents=True)
    (theirs / "0").write_bytes(b"at work on another machine")
    elsewhere = store.root / "tmp" / f"000000000000~{pid}~0badcafe"
    elsewhere.mkdir()
    (elsewhere / "lock").write_bytes(b"")  # held over there, where locks do not reach here
    store.scratch.sweep()
    assert theirs.is_dir()
    assert elsewhere.is_dir()
    week = 7 * 86400 + 60
    for folder in (theirs, elsewhere):
        for path in (*folder.iterdir(), folder):
            os.utime(path, (path.stat().st_mtime - week, path.stat().st_mtime - week))
    store.scratch.sweep()
    assert os.listdir(store.root / "tmp") in ([], [store.scratch.path().parent.name])


def test_a_living_process_of_this_machine_is_not_swept_after_a_week(store: Store) -> None:
    folder = store.scratch.path().parent
    for path in (*folder.iterdir(), folder):
        os.utime(path, (0, 0))
    Store(store.root).scratch.sweep()
    assert folder.is_dir()


def test_a_forked_child_has_a_folder_of_its_own_and_leaves_the_parents_lock(store: Store) -> None:
    mine = store.scratch.path().parent
    child = os.fork()
    if child == 0:
        own = store.scratch.path().parent
        store.scratch.leave()
        os._exit(0 if own != mine else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    Store(store.root).scratch.sweep()
    assert mine.is_dir()


# a store that has gone


def test_a_group_that_is_being_written_makes_no_folder_above_it_anew(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Moved away before the first of its files, and before each of the others."""
    real = os.mkdir
    for nth in range(1, 5):
        group, count = store.scratch.path(), 0

        def vanishing(path: object, *given: object, nth: int = nth, **named: object) -> None:
            nonlocal count
            count += 1
            if count == nth:
                store.root.rename(tmp_path / "away")
            real(path, *given, **named)  # type: ignore[arg-type]

        with monkeypatch.context() as patch:
            patch.setattr(os, "mkdir", vanishing)
            with pytest.raises(FileNotFoundError):
                write_group(
                    group,
                    arrays={},
                    coordinates={"frame": Coordinate(("frame",), [1, 2])},
                    attrs={},
                    chunks={},
                    source=store.chunks,
                )
        assert count >= nth
        assert not store.root.exists()
        (tmp_path / "away").rename(store.root)


def test_a_vanished_store_is_not_made_anew(store: Store, tmp_path: Path) -> None:
    replace(store.scratch, store.root / "results" / "a" / "b", b"")
    store.root.rename(tmp_path / "moved")
    with pytest.raises(WorkError, match="is gone \\(moved or unmounted"):
        replace(store.scratch, store.root / "results" / "a" / "b", b"")
    assert not store.root.exists()


def test_an_empty_mount_point_gets_no_folders(store: Store, tmp_path: Path) -> None:
    waiting = store.scratch.path()
    store.root.rename(tmp_path / "moved")
    store.root.mkdir()
    for act in (
        lambda: store.scratch.path(),
        lambda: store.scratch.make_folder(store.root / "results" / "a"),
        lambda: move_new(store.scratch, waiting, store.root / "cache" / "x"),
    ):
        with pytest.raises(WorkError, match="is gone"):
            act()
    assert os.listdir(store.root) == []


def test_a_store_that_was_exchanged_is_not_written_into(store: Store, tmp_path: Path) -> None:
    store.root.rename(tmp_path / "moved")
    Store(store.root)
    with pytest.raises(WorkError, match="exchanged"):
        store.scratch.path()


# what a disk refuses


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (errno.ENOSPC, "is full: nothing was lost"),
        (errno.EDQUOT, "is full: nothing was lost"),
        (errno.EROFS, "cannot be written"),
        (errno.EACCES, "cannot be written"),
        (errno.EMFILE, "ulimit -n"),
        (errno.ENFILE, "ulimit -n"),
        (errno.EFBIG, "ulimit -f"),
        (errno.EIO, "lightstage verify"),
        (errno.ENAMETOOLONG, "too long a name"),
        (errno.ELOOP, "links to itself"),
        (errno.ESTALE, "is gone"),
        (errno.ENOTCONN, "is gone"),
    ],
    ids=lambda value: errno.errorcode[value] if isinstance(value, int) else "",
)
def test_what_a_disk_refuses_is_a_sentence(code: int, said: str, tmp_path: Path) -> None:
    with pytest.raises(WorkError, match=said) as caught, disk_faults_named(tmp_path):
        raise OSError(code, os.strerror(code))
    assert str(tmp_path) in str(caught.value)


@contextlib.contextmanager
def limited(script: str, store: Path) -> Iterator[subprocess.CompletedProcess[str]]:
    command = f"{script}; exec {sys.executable} -m lightstage.cli.main --store {store} run register --session ball"
    yield subprocess.run(
        ["bash", "-c", command], cwd=REPOSITORY, capture_output=True, text=True, timeout=120, check=False
    )


@pytest.mark.slow
@pytest.mark.parametrize(("limit", "said"), [("ulimit -n 24", "ulimit -n"), ("ulimit -f 0", "ulimit -f")])
def test_few_open_files_and_small_ones_are_said(limit: str, said: str, store: Store, sphere: Path) -> None:
    import_capture(sphere, store)
    with limited(limit, store.root) as done:
        assert done.returncode in (0, 1)
        assert done.returncode == 0 or said in done.stderr
        assert "unexpected" not in done.stderr
        assert "Traceback" not in done.stderr
    assert verify(Store(store.root)).damaged == []

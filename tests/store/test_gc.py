"""gc: it frees what it says, all of it at once, and nothing that somebody has come to use while it worked."""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from lightstage.store.errors import WorkError
from lightstage.store.gc import Freed, gc
from lightstage.store.importer import import_capture
from lightstage.store.root import Store
from lightstage.store.sessions import read_session, remove_session
from lightstage.store.verify import verify
from tests.conftest import Answer

Lightstage = Callable[..., Answer]


def size_of(store: Store) -> int:
    """Bytes of all files, those with several names once."""
    found = (path.lstat() for path in store.root.rglob("*") if path.is_file() and not path.is_symlink())
    return sum({(s.st_dev, s.st_ino): s.st_size for s in found}.values())


def freed_by(store: Store, **options: object) -> Freed:
    return gc(store, **{"grace_s": 0, "dry_run": False, **options})  # type: ignore[arg-type]


@pytest.fixture
def two(lightstage: Lightstage, sphere: Path, tmp_path: Path) -> Store:
    """A store with a session and two results of `register`, of which the second is in use."""
    assert lightstage("import", sphere).code == 0
    run(lightstage, sphere, "0.5")
    run(lightstage, sphere, "-1")
    return Store(tmp_path / "store")


def run(lightstage: Lightstage, sphere: Path, shift_px: str) -> int:
    """Register under a homography of this shift; returns how many blocks were computed."""
    item = sphere / "homography.yaml"
    item.write_text(f"item: homography\nfrom: CAM0\nto: CAM1\nmatrix: [[1, 0, {shift_px}], [0, 1, 0], [0, 0, 1]]\n")
    words = ("run", "register", "--session", "ball", "--calibration", f"homography={item}", "--json")
    done = lightstage(*words)
    assert done.code == 0, done.err
    return int(done.json["nodes"]["register"]["computed"])


def current(store: Store) -> str:
    return (store.results / "ball" / "register" / "current").read_text().strip()


def results(store: Store) -> set[str]:
    return {path.name for path in store.results.glob("ball/register/*-*") if path.is_dir()}


def test_one_gc_frees_what_it_says_and_a_dry_run_says_the_same(two: Store) -> None:
    told = freed_by(two, dry_run=True)
    before = size_of(two)
    done = freed_by(two)
    assert done == told
    assert done.size == before - size_of(two) > 0
    assert (done.results, done.chunks) == (1, 8)
    assert freed_by(two) == Freed()
    assert verify(two).damaged == []


def test_what_is_young_stays_and_its_links_do_not_make_it_young(two: Store) -> None:
    assert freed_by(two, grace_s=3600) == Freed()
    day = 86400
    for path in two.root.rglob("*"):
        os.utime(path, (path.lstat().st_mtime - day,) * 2, follow_symlinks=False)
    before = size_of(two)
    done = freed_by(two, grace_s=3600)
    assert (done.results, done.chunks) == (1, 8)
    assert done.size == before - size_of(two)


def test_what_a_killed_command_left_goes_with_the_same_gc(two: Store) -> None:
    child = os.fork()
    if child == 0:
        shutil.copytree(two.sessions / "ball" / "raw.zarr", two.scratch.path())
        os._exit(0)
    os.waitpid(child, 0)
    told = freed_by(two, dry_run=True)
    before = size_of(two)
    done = freed_by(two)
    assert done == told
    assert done.size == before - size_of(two) > 10_000
    assert os.listdir(two.root / "tmp") == []


def test_a_removed_session_leaves_nothing(two: Store) -> None:
    remove_session("ball", two)
    done = freed_by(two)
    assert done.chunks > 8
    left = {path.relative_to(two.root).parts[0] for path in two.root.rglob("*") if path.is_file()}
    assert left == {"store.json"}


def test_gc_killed_again_and_again_leaves_a_whole_store_and_ends_at_last(two: Store) -> None:
    class Killed(BaseException):
        """As a kill: nothing is put in order."""

    whole, kills = size_of(two), 0
    for _ in range(50):
        left = iter(range(3))

        def stop(path: Path, left: Iterator[int] = left) -> None:
            if next(left, None) is None:
                raise Killed

        try:
            freed_by(Store(two.root), before=stop)
        except Killed:
            kills += 1
            assert verify(Store(two.root)).damaged == []
        else:
            break
    assert kills > 3
    assert freed_by(two, dry_run=True) == Freed()
    assert size_of(two) < whole
    assert len(results(two)) == 1


@pytest.fixture
def between(two: Store) -> Callable[[str, Callable[[], object]], Freed]:
    """gc, with something done right before a thing of some kind goes, after that has been decided."""

    def act(kind: str, meanwhile: Callable[[], object]) -> Freed:
        once = iter([meanwhile])

        def before(path: Path) -> None:
            if path.relative_to(two.root).as_posix().startswith(kind):
                for todo in once:
                    todo()

        done = freed_by(two, before=before)
        assert next(once, None) is None, "nothing of this kind was to go"
        return done

    return act


@pytest.mark.parametrize("kind", ["results/", "cache/blocks/", "cache/blobs/"])
def test_a_result_published_while_gc_works_stays_whole(
    kind: str,
    two: Store,
    lightstage: Lightstage,
    sphere: Path,
    between: Callable[[str, Callable[[], object]], Freed],
) -> None:
    published = results(two) - {current(two)}
    between(kind, lambda: run(lightstage, sphere, "0.5"))
    assert {current(two)} == published
    assert published <= results(two)
    assert verify(two).damaged == []
    # and what it is made of is still known, where no record of it had gone yet
    assert run(lightstage, sphere, "0.5") == 0 or kind == "cache/blocks/"


def test_pictures_imported_again_while_gc_works_stay(two: Store, sphere: Path) -> None:
    remove_session("ball", two)
    once: Iterator[int] = iter([1])

    def before(path: Path) -> None:
        if path.parent.parent == two.chunks.folder:
            for _ in once:
                import_capture(sphere, Store(two.root))

    freed_by(two, before=before)
    assert all(two.chunks.intact(ref) for ref in read_session("ball", two).refs())
    assert verify(two).damaged == []


def test_an_item_bound_while_gc_works_stays(two: Store, lightstage: Lightstage, sphere: Path) -> None:
    item, other = sphere / "calibration" / "homography.yaml", sphere / "other.yaml"
    other.write_text("item: homography\nfrom: CAM0\nto: CAM1\nmatrix: [[1, 0, -2], [0, 1, 0], [0, 0, 1]]\n")
    assert lightstage("calibration", "use", other, "--session", "ball").code == 0
    bound = read_session("ball", two).items["homography"]
    assert lightstage("calibration", "use", item, "--session", "ball").code == 0
    held: list[Path] = []

    def before(path: Path) -> None:
        if path == two.calibration / f"homography-{bound[:12]}":
            held.append(path)
            assert lightstage("calibration", "use", other, "--session", "ball").code == 0

    freed_by(two, before=before)
    assert held
    assert read_session("ball", two).items["homography"] == bound
    assert verify(two).damaged == []


def test_without_a_list_of_the_sessions_nothing_goes(two: Store) -> None:
    """A folder that cannot be seen is not an empty one."""
    two.root.rename(two.root.with_name("moved"))
    with pytest.raises(WorkError, match="is gone"):
        freed_by(two)
    with pytest.raises(WorkError, match="is gone"):
        freed_by(two, dry_run=True)


def test_a_session_that_lost_its_description_is_said_before_anything_goes(two: Store) -> None:
    before = results(two)
    (two.sessions / "ball" / "session.json").unlink()
    with pytest.raises(WorkError, match="import the capture"):
        freed_by(two)
    assert results(two) == before


def test_damaged_chunks_leave_the_quarantine_when_they_are_old(two: Store) -> None:
    blob = next(two.chunks.folder.glob("*/*"))
    blob.chmod(0o644)
    blob.write_bytes(blob.read_bytes()[:-1])
    verify(two)
    (kept,) = two.quarantine.iterdir()
    assert (
        gc(two, grace_s=3600, dry_run=False).size == 0
    )  # it has been there for a moment, however old its bytes are
    assert kept.exists()
    before = size_of(two)
    done = freed_by(two)
    assert not kept.exists()
    assert done.size == before - size_of(two) > 0

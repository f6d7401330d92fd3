"""One flipped bit in any file of the store: it is named, it reaches no answer, and what can be made again is."""

import errno
import json
import os
import random
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import xarray as xr

from lightstage.cli.main import main
from lightstage.store import verify as verify_module
from lightstage.store.errors import DamagedChunkError, DamagedFileError, DamagedGroupError
from lightstage.store.grid import open_dataset
from lightstage.store.importer import import_capture
from lightstage.store.records import KINDS
from lightstage.store.results import current_path
from lightstage.store.root import Store
from lightstage.store.sessions import read_session
from lightstage.store.verify import verify
from tests.conftest import Answer
from tests.scenes import sphere_capture

Lightstage = Callable[..., Answer]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a small capture, `ball`, and a store, in which it was imported and run."""
    folder = tmp_path_factory.mktemp("made")
    sphere_capture(folder / "ball", size=16)
    assert main(["--store", str(folder / "store"), "import", str(folder / "ball")]) == 0
    assert main(["--store", str(folder / "store"), "run", "--session", "ball"]) == 0
    return folder


@pytest.fixture
def ball(made: Path, tmp_path: Path) -> Path:
    """The store of `made`, a copy with its hard links; `lightstage` works on it."""
    subprocess.run(["cp", "-a", made / "store", tmp_path / "store"], check=True)
    return tmp_path / "store"


def flip(path: Path, bit: int | None = None, seed: int = 0) -> None:
    """Change one bit in place, as a failing disk does: every link of the file shows it."""
    data = bytearray(path.read_bytes())
    bit = random.Random(f"{seed}{path.name}").randrange(8 * len(data)) if bit is None else bit
    data[bit // 8] ^= 1 << bit % 8
    with open(path, "r+b") as file:
        file.write(data)


def change(path: Path, old: str, new: str) -> None:
    """Another value in the place of one, and it is still JSON."""
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    json.loads(path.read_text())


KIND = {
    "session.json": "sessions/ball/session.json",
    "raw note": "sessions/ball/.raw-*.json",
    "raw metadata": "sessions/ball/.raw-*.zarr/zarr.json",
    "raw array metadata": "sessions/ball/.raw-*.zarr/raw/zarr.json",
    "raw coordinate": "sessions/ball/.raw-*.zarr/band/c.0",
    "raw picture": "sessions/ball/.raw-*.zarr/raw/c.2.0.1.0.0",
    "item.json": "calibration/homography-*/item.json",
    "item.yaml": "calibration/homography-*/item.yaml",
    "block record": "cache/blocks/*/*.json",
    "node record": "cache/nodes/*/*.json",
    "run record": "cache/runs/*/*.json",
    "note": "results/ball/stack/*-*.json",
    "current": "results/ball/stack/current",
    "metadata": "results/ball/stack/*-*/zarr.json",
    "array metadata": "results/ball/stack/*-*/radiance/zarr.json",
    "coordinate": "results/ball/stack/*-*/illumination/c.0",
    "chunk": "results/ball/stack/*-*/radiance/c.3.0.0.0.0",
}
ONLY_AN_IMPORT_MENDS = ("session.json", "raw picture", "item.json")


def one(store: Path, kind: str) -> Path:
    return sorted(store.glob(KIND[kind]))[0]


@pytest.mark.parametrize("kind", KIND)
def test_a_flip_is_named_by_verify_and_mended_by_what_it_names(
    kind: str, ball: Path, made: Path, lightstage: Lightstage
) -> None:
    assert verify(Store(ball)).damaged == []
    for seed in range(2):
        path = one(ball, kind)
        names = {path, *(blob for blob in ball.glob("cache/blobs/*/*") if blob.samefile(path))}
        flip(path, seed=seed)
        found = verify(Store(ball)).damaged
        assert names & {damage.path for damage in found}, found
        if kind in ONLY_AN_IMPORT_MENDS:
            assert any(not damage.recomputable for damage in found)
            import_capture(made / "ball", Store(ball))
        assert lightstage("run", "--session", "ball").code == 0
        assert verify(Store(ball)).damaged == []
        assert one(ball, kind).exists()


def exported(lightstage: Lightstage, to: Path) -> tuple[Answer, dict[str, bytes]]:
    shutil.rmtree(to, ignore_errors=True)
    done = lightstage("export", "stack", "--session", "ball", "--format", "npy", "--to", to)
    return done, {path.name: path.read_bytes() for path in to.glob("*")}


@pytest.mark.parametrize("kind", ["session.json", "note", "metadata", "coordinate", "chunk"])
def test_a_flip_never_reaches_an_export_and_a_run_makes_it_good(
    kind: str, ball: Path, made: Path, lightstage: Lightstage, tmp_path: Path
) -> None:
    good = exported(lightstage, tmp_path / "good")[1]
    assert len(good) == 14 + 1  # and the record that says whose they are
    flip(one(ball, kind))
    done, files = exported(lightstage, tmp_path / "out")
    assert all(good[name] == data for name, data in files.items())
    assert done.code == 1
    assert "is damaged" in done.err
    if kind == "session.json":
        assert "import the capture folder of session 'ball' again" in done.err
        import_capture(made / "ball", Store(ball))
    else:
        assert "`lightstage run stack --session ball` makes it again" in done.err
    assert lightstage("run", "--session", "ball").code == 0
    done, files = exported(lightstage, tmp_path / "out")
    assert (done.code, files) == (0, good)
    assert verify(Store(ball)).damaged == []


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"white_level":1023', '"white_level":1123'),
        ('"illumination":["C","X"', '"illumination":["C","Y"'),
        ("576", "577"),
    ],
)
def test_a_session_that_says_something_else_is_refused(
    old: str, new: str, ball: Path, lightstage: Lightstage
) -> None:
    path = one(ball, "session.json")
    change(path, old, new)
    done = lightstage("run", "--session", "ball")
    assert done.code == 1
    assert done.err == f"lightstage: {path} is damaged; import the capture folder of session 'ball' again\n"
    assert [d.path for d in verify(Store(ball)).damaged] == [path]


def test_a_picture_named_for_another_and_another_sessions_file_are_refused(ball: Path) -> None:
    path = one(ball, "session.json")
    first, second = (read_session("ball", Store(ball)).images[f][0][0].value for f in (1, 2))
    good = path.read_bytes()
    change(path, first, second)
    with pytest.raises(DamagedFileError):
        read_session("ball", Store(ball))
    path.write_bytes(good)
    shutil.copytree(path.parent, path.parent.with_name("other"), symlinks=True)
    with pytest.raises(DamagedFileError, match="import the capture folder of session 'other' again"):
        read_session("other", Store(ball))


def test_an_item_that_is_not_what_its_name_says_is_refused(ball: Path, lightstage: Lightstage) -> None:
    path = one(ball, "item.json")
    change(path, "-1.0", "-1.009")
    done = lightstage("run", "--session", "ball")
    assert done.code == 1
    assert f"{path} is damaged; import the capture that it came with again" in done.err
    assert lightstage("calibration", "show", path.parent.name).code == 1


def test_two_chunk_files_exchanged_are_found(ball: Path, made: Path, lightstage: Lightstage) -> None:
    """Each is intact, and is not what belongs there."""
    groups = current_path("ball", "stack", Store(ball)) / "radiance", ball / "sessions/ball/raw.zarr/raw"
    for folder in groups:
        a, b = (sorted(folder.resolve().glob(f"c.{i}.*"))[-1] for i in (1, 2))
        was = a.read_bytes(), b.read_bytes()
        for source, target in ((a, a.with_name("aside")), (b, a), (a.with_name("aside"), b)):
            os.rename(source, target)
        node = "capture" if folder.name == "raw" else "stack"
        with pytest.raises(DamagedGroupError):
            open_dataset(folder.parent)[folder.name].load()
        assert {d.path for d in verify(Store(ball)).damaged} == {a, b}
        assert (a.read_bytes(), b.read_bytes()) == was
        assert verify(Store(ball)).damaged == []
        assert lightstage("export", node, "--session", "ball", "--format", "npy", "--to", ball / "out").code == 0


def test_what_is_not_read_costs_nothing_and_what_is_not_named_is_not_there(ball: Path) -> None:
    group = current_path("ball", "stack", Store(ball))
    opened = open_dataset(group)
    good = opened.radiance.values[:3]
    flip(group / "radiance/c.3.0.0.0.0")
    np.testing.assert_array_equal(open_dataset(group).radiance.isel(illumination=slice(3)).values, good)
    with pytest.raises(DamagedGroupError, match="its bytes are not the ones that were stored"):
        open_dataset(group).radiance.isel(illumination=3).load()
    (group / "radiance/c.2.0.0.0.0").unlink()  # plain zarr takes it for NaN
    with pytest.raises(DamagedGroupError, match="cannot be read"):
        open_dataset(group).radiance.isel(illumination=2).load()


def test_a_stray_chunk_is_damage_and_a_stray_file_is_named(ball: Path, lightstage: Lightstage) -> None:
    group = current_path("ball", "stack", Store(ball))
    lightstage("run", "--session", "ball", "--frames", "0:3", "--json")
    part = current_path("ball", "register", Store(ball))
    stray = part / "signal/c.5.0.0.0.0"
    shutil.copy(part / "signal/c.1.0.0.0.0", stray)
    assert np.isnan(open_dataset(part).signal.values[5]).all()
    notes = [group / ".DS_Store", ball / "sessions/ball/mine.txt", ball / "cache/blobs/note.txt"]
    for note in notes:
        note.write_text("mine")
    said = lightstage("verify", "--json").json
    assert [d["path"] for d in said["damaged"]] == [str(stray)]
    assert sorted(said["strange"]) == sorted(map(str, notes))
    assert all(note.exists() for note in notes)


def test_storing_the_same_again_heals(store: Store) -> None:
    array = np.arange(96, dtype=np.uint16).reshape(8, 12)
    ref = store.chunks.put(array)
    path = store.chunks.path(ref.blob)
    os.link(path, store.root / "link")
    flip(path, 8 * 30)
    store = Store(store.root)  # one that has not just written it and still has it in memory
    with pytest.raises(DamagedChunkError):
        store.chunks.get(ref, dtype="<u2", shape=array.shape)
    assert store.chunks.put(array) == ref
    np.testing.assert_array_equal(Store(store.root).chunks.get(ref, dtype="<u2", shape=array.shape), array)
    assert not path.samefile(store.root / "link")


def test_computing_again_heals_the_results_that_link_the_damaged_chunk(
    ball: Path, lightstage: Lightstage, tmp_path: Path
) -> None:
    good = exported(lightstage, tmp_path / "good")[1]
    flip(one(ball, "chunk"))
    for kind in KINDS:
        shutil.rmtree(ball / "cache" / kind)
    assert lightstage("run", "--session", "ball").code == 0
    done, files = exported(lightstage, tmp_path / "out")
    assert (done.code, done.err, files) == (0, "", good)
    assert verify(Store(ball)).damaged == []


def test_a_damaged_record_is_computed_again_and_does_not_stand_in_the_way(
    ball: Path, lightstage: Lightstage
) -> None:
    records = Store(ball).records
    for kind in KINDS:
        for path in records.files(kind):
            flip(path)
    done = lightstage("run", "--session", "ball", "--json")
    assert done.code == 0, done.err
    assert done.json["nodes"]["stack"]["computed"] == 7
    assert verify(Store(ball)).damaged == []
    # a record under the name of another
    a, b = list(records.files("blocks"))[:2]
    shutil.copy(a, b)
    assert [d.path for d in verify(Store(ball)).damaged] == [b]
    shutil.copy(a, b)
    assert records.block(b.stem) is None


def test_a_command_that_computes_heals_what_it_meets(ball: Path, lightstage: Lightstage) -> None:
    assert lightstage("run", "--session", "ball").code == 0
    flip(current_path("ball", "stack", Store(ball)) / "radiance/c.0.0.0.0.0")
    done = lightstage("normals", "ball")  # its picture shows the constant light
    assert done.code == 0, done.err
    assert "was damaged: ball/stack, array radiance, chunk 0/0/0/0/0; the next run makes it again" in done.err
    assert (ball / "pictures/ball.png").exists()
    assert verify(Store(ball)).damaged == []


def test_a_current_that_names_nothing_is_no_result_until_the_next_run(ball: Path, lightstage: Lightstage) -> None:
    path = one(ball, "current")
    good = path.read_bytes()
    flip(path, 7)
    assert lightstage("status", "--session", "ball").code == 0
    done = lightstage("path", "stack", "--session", "ball")
    assert done.code == 2
    assert "`lightstage run stack --session ball` computes it" in done.err
    assert lightstage("run", "--session", "ball").code == 0
    assert path.read_bytes() == good


def test_a_session_made_anew_says_what_it_cannot_know(ball: Path, made: Path) -> None:
    flip(one(ball, "session.json"))
    (warning,) = import_capture(made / "ball", Store(ball)).warnings
    assert "items that were bound to it by hand have to be bound again" in warning


def test_damage_on_a_disk_that_cannot_be_written_is_one_sentence(
    ball: Path, lightstage: Lightstage, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = one(ball, "chunk")
    flip(path)

    def refuse(*_: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(os, "replace", refuse)
    for words in (("verify",), ("export", "stack", "--session", "ball", "--format", "npy", "--to", ball / "out")):
        done = lightstage(*words)
        assert done.code == 1
        (sentence,) = (line for line in done.err.splitlines() if line.startswith("lightstage: "))
        assert "is damaged" in sentence
        assert "annot be mended: " in sentence
        assert "Read-only file system" in sentence


@pytest.fixture
def imports_between(made: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The capture with every picture changed; it is imported when `verify` has just read the session."""
    folder = shutil.copytree(made / "ball", tmp_path / "ball")
    for path in folder.glob("*.png"):
        cv2.imwrite(str(path), cv2.imread(str(path), cv2.IMREAD_UNCHANGED) + 1)

    def late(name: str, store: Store) -> object:
        session = read_session(name, store)
        import_capture(folder, store)
        return session

    monkeypatch.setattr(verify_module, "read_session", late)
    return folder


def test_verify_beside_an_import_mends_nothing_after_the_session_before(ball: Path, imports_between: Path) -> None:
    assert verify(Store(ball)).damaged == []
    shown = open_dataset(ball / "sessions/ball/raw.zarr").raw.sel(polarisation="cross").values[:, 0]
    wanted = [
        cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in sorted(imports_between.glob("*_576nm_CAM1.png"))
    ]
    np.testing.assert_array_equal(shown, wanted)


def test_a_picture_that_was_lost_is_in_its_group_again_when_its_capture_comes_back(
    tmp_path: Path, lightstage: Lightstage
) -> None:
    """Plain xarray reads a chunk that is gone as zeros, so a group that lacks one is not shown a second time."""
    folder, store = sphere_capture(tmp_path / "ball", size=16), tmp_path / "store"
    assert lightstage("import", folder).code == 0
    first, second = sorted(folder.glob("*.png"))[:2]
    raw = store / "sessions" / "ball" / "raw.zarr"
    truth = open_dataset(raw)["raw"].values
    flip(raw / "raw" / "c.0.0.0.0.0")
    assert lightstage("verify").code == 1
    pictures = first.read_bytes(), second.read_bytes()
    for contents in (pictures[::-1], pictures):
        first.write_bytes(contents[0])
        second.write_bytes(contents[1])
        assert lightstage("import", folder).code == 0
        assert lightstage("verify").code == 0
    assert np.array_equal(xr.open_zarr(raw)["raw"].values, truth)

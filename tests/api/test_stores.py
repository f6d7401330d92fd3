"""The Python API: the same answers, results and sentences as the command's."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray

import lightstage
from tests.conftest import REPOSITORY, Answer

Command = Callable[..., Answer]


@pytest.fixture
def command(request: pytest.FixtureRequest) -> Command:
    """The fixture of the package's name, under another."""
    called: Command = request.getfixturevalue("lightstage")
    return called


@pytest.fixture
def store(tmp_path: Path) -> lightstage.OpenStore:
    return lightstage.open_store(tmp_path / "store")


@pytest.fixture
def ball(store: lightstage.OpenStore, sphere: Path) -> lightstage.OpenSession:
    return store.import_capture(sphere).session


def test_opening_a_store_makes_none(store: lightstage.OpenStore, sphere: Path) -> None:
    assert store.sessions == []
    assert not store.root.exists()
    with pytest.raises(lightstage.RequestError, match="no session 'x' in the store"):
        store.session("x")
    done = store.import_capture(sphere, "face")
    assert (done.new, done.session.name, store.sessions) == (True, "face", ["face"])
    assert "face" in repr(store)
    assert "frame 7" in repr(done.session)
    assert not store.import_capture(sphere, "face").changes


def test_the_command_and_the_api_answer_each_other(ball: lightstage.OpenSession, command: Command) -> None:
    answer = ball.run("normals", method="ratio")
    assert {name: node.computed for name, node in answer.nodes.items()} == {
        "register": 7,
        "split": 7,
        "stack": 7,
        "align": 1,
        "normals": 1,
    }
    said = command("run", "normals", "--session", "ball", "--set", "normals.method=ratio", "--json").json["nodes"]
    assert {name: node["computed"] for name, node in said.items()} == dict.fromkeys(said, 0)
    assert {name: node["path"] for name, node in said.items()} == {
        name: str(node.path) for name, node in answer.nodes.items()
    }
    assert ball.run("normals", set={"normals.method": "ratio"}).nodes["normals"].reused == 1


def test_a_result_is_a_checked_dataset(ball: lightstage.OpenSession) -> None:
    ball.run("normals")
    dataset = ball["normals"]
    assert isinstance(dataset, xarray.Dataset)
    np.testing.assert_array_equal(dataset.albedo, xarray.open_zarr(ball.path("normals"), chunks=None).albedo)
    assert "normals" in ball
    assert "relief" not in ball
    assert ball["capture"].raw.dims == ("frame", "band", "polarisation", "y", "x")
    chunk = next(path for path in sorted(ball.path("normals").rglob("c.*")) if path.parent.name == "albedo")
    data = bytearray(chunk.read_bytes())
    data[len(data) // 2] ^= 1
    chunk.unlink()
    chunk.write_bytes(data)
    with pytest.raises(lightstage.WorkError, match="damaged"):
        _ = ball["normals"].albedo.values


def test_what_is_wrong_is_said_as_by_the_command(ball: lightstage.OpenSession, command: Command) -> None:
    for call, words in (
        (lambda: ball.run("nrmals"), ("run", "nrmals")),
        (lambda: ball.run("normals", methd=1), ("run", "normals", "--set", "normals.methd=1")),
        (lambda: ball.run(frames=(5, 3)), ("run", "--frames", "5:3")),
        (lambda: ball.run(frames=(0, 99)), ("run", "--frames", "0:99")),
        (lambda: ball.run(workers=0), ("run", "--workers", "0")),
        (lambda: ball.run(items={"homo": "h.yaml"}), ("run", "--calibration", "homo=h.yaml")),
        (lambda: ball.path("normals"), ("path", "normals")),
    ):
        with pytest.raises(lightstage.RequestError) as refused:
            call()
        done = command(*words, "--session", "ball")
        assert (done.code, done.err.strip()) == (2, f"lightstage: {refused.value}")
    with pytest.raises(lightstage.RequestError, match="parameters without a node's name"):
        ball.run("normals", "stack", method="ratio")


def test_status_why_and_items(ball: lightstage.OpenSession, store: lightstage.OpenStore, tmp_path: Path) -> None:
    ball.run("register")
    assert ball.status("register")["register"].condition == "fresh"
    item = tmp_path / "h.yaml"
    item.write_text("item: homography\nfrom: CAM0\nto: CAM1\nmatrix: [[1, 0, -1.5], [0, 1, 0], [0, 0, 1]]\n")
    assert ball.status("register", items={"homography": item})["register"].condition == "stale"
    name = ball.bind(item)
    assert ball.items["homography"] == name
    assert [i.name for i in store.items("ball") if i.kind == "homography"] == [name]
    assert ball.status("register")["register"].condition == "stale"
    assert any("homography" in reason.what for reason in ball.why("register").reasons)
    assert "homography" in str(ball.why("register"))


def test_what_a_run_warns_of_is_in_its_answer(ball: lightstage.OpenSession) -> None:
    answer = ball.run("normals", frames=(0, 3))
    assert answer.nodes["normals"].path is None
    assert any("each of its blocks needs frames outside 0:3" in note for note in answer.notes)
    assert "session 'ball'" in repr(answer)


def test_pictures_are_exported(ball: lightstage.OpenSession, tmp_path: Path) -> None:
    ball.run("normals")
    files = ball.export("normals", tmp_path / "out", format="png16")
    assert {file.name for file in files} == {path.name for path in (tmp_path / "out").glob("*.png")}
    with pytest.raises(lightstage.RequestError, match="format ex: it is not known"):
        ball.export("normals", tmp_path / "out", format="ex")


def test_importing_the_package_is_light_and_asks_for_one_thread() -> None:
    code = (
        "import sys, os\nbefore = set(sys.modules)\nimport lightstage\n"
        "assert os.environ['OPENBLAS_NUM_THREADS'] == '1'\n"
        "heavy = {'numpy', 'pydantic', 'yaml', 'xarray', 'zarr', 'dask'}\n"
        "assert not heavy & {name.split('.')[0] for name in sys.modules}\n"
        "assert not {name for name in sys.modules if name.startswith(('lightstage.api', 'lightstage.dag'))}\n"
        "assert set(lightstage.__all__) <= set(dir(lightstage))\n"
        "for name in lightstage.__all__:\n    getattr(lightstage, name)\n"
        "lightstage.open_store('nowhere')\n"
        "assert not heavy & {name.split('.')[0] for name in sys.modules}\n"
        "try:\n    lightstage.opne_store\nexcept AttributeError as error:\n    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, timeout=60)
    assert done.stdout == "module 'lightstage' has no attribute 'opne_store'\n", done.stderr

"""A session: results as datasets, and the sentences of the command."""

from pathlib import Path

import numpy as np
import pytest
import xarray

import lightstage
from tests.api.conftest import Command
from tests.scenes import STATIC


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


def test_a_session_says_what_it_is(finished: lightstage.OpenSession) -> None:
    assert list(finished.facts["illumination"]) == list(STATIC)
    assert repr(finished).startswith("<OpenSession 'ball' of ")
    assert (
        finished.folder == finished.read().folder
        if hasattr(finished.read(), "folder")
        else finished.folder.is_dir()
    )
    assert set(finished.items) == {"homography", "bands"}
    assert list(finished) == finished.results == finished._ipython_key_completions_()
    assert finished.results == ["align", "normals", "register", "split", "stack", "upsample"]


def test_a_result_that_is_not_there_is_refused_with_the_nearest_name(finished: lightstage.OpenSession) -> None:
    with pytest.raises(lightstage.RequestError, match="no result of a node 'nrmals'; did you mean 'normals'"):
        finished["nrmals"]
    with pytest.raises(lightstage.RequestError, match=r"'shape'.*lightstage run shape"):
        finished["shape"]
    with pytest.raises(lightstage.RequestError, match=r"'shape'"):
        finished.path("shape")


def test_parameters_of_the_one_node_and_of_any_are_the_same(finished: lightstage.OpenSession) -> None:
    own = finished.status("normals", method="ratio")
    named = finished.status("normals", set={"normals.method": "ratio"})
    assert own == named
    assert own["normals"].condition == "stale"
    assert own["align"].condition == "fresh"

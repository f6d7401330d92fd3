"""Alignment through the command, on a performance with exact flows: contract, engines, reuse, pictures that lie."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import xarray

from tests.conftest import Answer, run_process
from tests.scenes import MINIMAL, Performer, angle_deg, performance_capture

Lightstage = Callable[..., Answer]
ACTOR = Performer()


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    cv2.setNumThreads(1)


@pytest.fixture(scope="module")
def pictures() -> list[Any]:
    return [ACTOR.picture(i, name) for i, name in enumerate(MINIMAL)]


@pytest.fixture
def capture(tmp_path: Path, pictures: list[Any]) -> Callable[..., Path]:
    def make(illumination: Any = MINIMAL, **replaced: Any) -> Path:
        given = {f"f{i}": picture for i, picture in enumerate(pictures)} if illumination is MINIMAL else {}
        return performance_capture(tmp_path / "p", ACTOR, illumination, **(given | replaced))

    return make


def run(lightstage: Lightstage, folder: Path, *words: str) -> Answer:
    assert lightstage("import", folder).code == 0
    return lightstage("run", "--session", "p", "--json", *words)


def opened(done: Answer, node: str = "align") -> xarray.Dataset:
    assert done.code == 0, done.err
    return xarray.open_zarr(done.json["nodes"][node]["path"], chunks=None)


def members(align: xarray.Dataset) -> list[tuple[int, int, Any, Any]]:
    """Tracking frame, picture, endpoint error and confidence, both inside."""
    out = []
    for k, tracking in enumerate(align.tracking.values):
        inner = ACTOR.surface(tracking)[2]
        for m, frame in enumerate(align.frame.values[k]):
            if frame >= 0:
                off = align.flow.values[k, m] - ACTOR.flow(tracking, frame)
                out.append((int(tracking), int(frame), np.hypot(*off)[inner], align.confidence.values[k, m][inner]))
    return out


def test_the_contract_and_the_truth(lightstage: Lightstage, capture: Any) -> None:
    done = run(lightstage, capture())
    align = opened(done)
    assert align.flow.dims == ("tracking", "member", "xy", "y", "x")
    assert align.aligned.dims == ("tracking", "member", "band", "component", "y", "x")
    assert align.confidence.dims == ("tracking", "member", "y", "x")
    assert align.residual.dims == ("tracking", "y", "x")
    assert align.attrs["engine"] == "motion"
    assert align.tracking.values.tolist() == [2, 5, 8]
    # the last tracking frame lacks a full set: it is a member of its neighbour's
    wanted = [[0, 1, 2, 3, 4, -1], [3, 4, 5, 6, 7, -1], [6, 7, 8, 9, 10, 11]]
    assert align.frame.values.tolist() == wanted
    names = [[MINIMAL[i] if i >= 0 else "" for i in row] for row in wanted]
    assert align.illumination.values.tolist() == names
    np.testing.assert_allclose(align.time_s, np.array([2, 5, 8]) / 60, atol=1e-6)
    assert align.attrs["residual_after"] < 0.5 * align.attrs["residual_before"]
    assert np.isnan(align.aligned.values[0, 5]).all()
    for _, _, error, confidence in members(align):
        assert error.mean() < 0.1  # motion is up to 4 px
        assert confidence.mean() > 0.8
    normals, every = opened(done, "normals"), opened(done, "upsample")
    assert every.frame.values.tolist() == list(range(12))
    for i, frame in enumerate(every.frame.values):
        _, truth, inner = ACTOR.surface(frame)
        # noise of 10 bits under the minimal method is 1.5 degrees; without alignment it is 4 to 10
        assert np.mean(angle_deg(every.normal.values[i], truth)[inner]) < 2.2
    assert normals.tracking.values.tolist() == [2, 5, 8]


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["joint", "alternating", "direct", "none"])
def test_every_engine_runs(lightstage: Lightstage, capture: Any, engine: str) -> None:
    align = opened(run(lightstage, capture(), "--set", f"align.engine={engine}"))
    errors = [error.mean() for tracking, frame, error, _ in members(align) if frame != tracking]
    if engine == "none":
        assert not align.flow.values[align.frame.values >= 0].any()
        return
    assert np.mean(errors) < {"joint": 0.1, "direct": 0.15, "alternating": 0.4}[engine]


def test_a_still_capture_passes_through(lightstage: Lightstage, sphere: Path) -> None:
    assert lightstage("import", sphere).code == 0
    done = lightstage("run", "--session", "ball", "--json")
    align, stack = opened(done), opened(done, "stack")
    assert align.attrs["engine"] == "none"
    np.testing.assert_array_equal(align.aligned.values[0], stack.radiance.values)
    assert align.illumination.values[0].tolist() == stack.illumination.values.tolist()
    assert not align.flow.values.any()


@pytest.mark.slow
def test_a_preview_is_reused_by_the_full_run(lightstage: Lightstage, capture: Any) -> None:
    preview = run(lightstage, capture(), "--frames", "0:6").json["nodes"]["align"]
    # the window of 2 reads the tracking frame 5 too; that of 5 reads 8
    assert (preview["computed"], preview["reused"]) == (1, 0)
    full = lightstage("run", "--session", "p", "--json").json["nodes"]["align"]
    assert (full["computed"], full["reused"]) == (2, 1)


@pytest.mark.slow
@pytest.mark.parametrize(("frame", "windows"), [(0, 1), (4, 2), (8, 2), (11, 1)])
def test_a_replaced_picture_costs_the_windows_that_read_it(
    lightstage: Lightstage, capture: Any, pictures: list[Any], frame: int, windows: int
) -> None:
    run(lightstage, capture())
    other = pictures[frame].copy()
    other[60, 80] += 1
    changed = run(lightstage, capture(**{f"f{frame}": other})).json["nodes"]["align"]
    assert changed["computed"] == windows


@pytest.mark.slow
def test_workers_change_no_bit(lightstage: Lightstage, capture: Any, tmp_path: Path) -> None:
    folder, store = capture(), tmp_path / "other"
    threads = opened(run(lightstage, folder))
    assert run_process("import", folder, store=store).returncode == 0
    done = run_process("run", "--session", "p", "--json", "--workers", "2", store=store)
    processes = opened(Answer(done.returncode, done.stdout, done.stderr))
    for name in ("flow", "aligned", "confidence", "residual"):
        np.testing.assert_array_equal(threads[name].values, processes[name].values)


@pytest.mark.parametrize(
    ("sequence", "part"),
    [
        ("X Y Z C X Y Z", "engine: joint needs a gradient and its complement"),
        ("X Xc Y Yc Z Zc", "needs tracking frames under constant light"),
    ],
)
def test_a_set_that_cannot_be_aligned_is_refused(
    lightstage: Lightstage, capture: Any, sequence: str, part: str
) -> None:
    done = run(lightstage, capture(sequence.split()), "--set", "align.engine=joint")
    assert done.code == 2
    assert part in done.err
    assert len(done.err.strip().splitlines()) == 1


def shifted(pictures: list[Any], start: int, by: int) -> dict[str, Any]:
    more = [*pictures, ACTOR.picture(12, "Y")]
    return {f"f{i}": more[i + by] for i in range(start, 12)}


LIES: dict[str, tuple[Callable[[list[Any]], dict[str, Any]], list[str], list[tuple[int, int]]]] = {
    # what is wrong: the pictures, what is said, (tracking frame, picture) that must not be used
    "dropped": (lambda p: shifted(p, 4, 1), ["frame 4 (Xc) is as bright as frame 2 (C)"], [(2, 4), (5, 4), (8, 9)]),
    "repeated": (lambda p: {"f4": p[3]}, ["frame 4 (Xc) repeats frame 3 (Y)"], [(2, 4), (5, 4)]),
    "black": (lambda p: {"f4": 0 * p[4]}, ["frame 4 (Xc) is black beside frame 2 (C)"], [(2, 4), (5, 4)]),
    "no tracking light": (
        lambda p: {"f5": 0 * p[5]},
        ["frame 5 (C) is black, so nothing can be aligned to it"],
        [(5, 3), (5, 4), (5, 6), (5, 7)],
    ),
    "constant light": (lambda p: {"f4": p[5]}, ["frame 4 (Xc) is as bright as"], [(2, 4), (5, 4)]),
    "mislabelled": (lambda p: {"f0": p[4], "f4": p[4]}, ["frame 4 (Xc) repeats frame 0 (X)"], [(2, 4)]),
    "half as bright": (lambda p: {"f4": p[4] // 3}, ["off their sum, the constant picture"], [(2, 0), (2, 4)]),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", LIES)
def test_pictures_that_lie_are_named_and_not_used(
    lightstage: Lightstage, capture: Any, pictures: list[Any], kind: str
) -> None:
    make, said, unused = LIES[kind]
    done = run(lightstage, capture(**make(pictures)))
    align = opened(done)
    for part in said:
        assert part in done.err
    found = {(tracking, frame): (error, confidence) for tracking, frame, error, confidence in members(align)}
    for place in unused:
        assert (found[place][1] == 0).all()
        assert np.isnan(found[place][0]).all()
    if kind not in ("dropped", "mislabelled"):  # there a used picture shows another time than its place says
        # of what is left in the windows, at most a fiftieth is wrong by a pixel without being doubted
        for error, confidence in found.values():
            assert ((error > 1) & (confidence > 0.5)).mean() < 0.02

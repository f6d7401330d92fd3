"""Measuring an item: it is kept and judged, what fails leaves nothing, and what moved since the last is said."""

from pathlib import Path

import numpy as np
import pytest

import lightstage
from lightstage.api.calibration import changes_since, measure
from lightstage.store.items import Item, item_digest, put_item
from lightstage.store.root import Store
from tests.scenes import sphere_capture, write_capture


def dark_capture(folder: Path, level: float) -> Path:
    generator = np.random.default_rng(3)
    pictures = {
        (i, 0.0, "unpolarised"): np.round(generator.normal(level, 1.5, (40, 48))).astype(np.uint16)
        for i in range(4)
    }
    return write_capture(folder, pictures, illumination=["O"] * 4, target={"kind": "dark"})


@pytest.fixture
def store(tmp_path: Path) -> lightstage.OpenStore:
    return lightstage.open_store(tmp_path / "store")


def test_an_item_is_measured_kept_and_written(store: lightstage.OpenStore, tmp_path: Path) -> None:
    told: list[bool] = []
    found = measure(
        store,
        "dark",
        [dark_capture(tmp_path / "d", 64)],
        out=tmp_path / "out",
        imported=lambda done: told.append(done.new),
    )
    assert told == [True]
    assert found.verdict
    (item,) = store.items()
    assert item.name == found.item
    assert item.values["scale"] == 16
    assert found.written == tmp_path / "out" / "dark.yaml"
    assert found.report(tmp_path / "page.html").read_text().startswith("<!doctype html>")
    again = measure(store, "dark", [tmp_path / "d"])
    assert all(node.computed == 0 for node in again.answer.nodes.values())
    assert again.item == found.item


def test_a_capture_that_tells_nothing_leaves_nothing(store: lightstage.OpenStore, tmp_path: Path) -> None:
    folder = sphere_capture(tmp_path / "ball")
    with pytest.raises(lightstage.LightstageError, match="target"):
        measure(store, "dark", [folder])
    assert store.sessions == []
    store.import_capture(folder)
    before = store.session("ball").read().digest
    with pytest.raises(lightstage.LightstageError, match="target"):
        measure(store, "dark", [folder])
    assert store.session("ball").read().digest == before


def homography(shift: float, day: int) -> Item:
    matrix = [[1.0, 0, shift], [0, 1, 0], [0, 0, 1]]
    notes = {"rig": "york", "valid_from": f"2010-03-{day:02d}"}
    values = {"from": "CAM0", "to": "CAM1", "matrix": matrix}
    return Item("homography", item_digest(values, {}), values, notes, {})


@pytest.mark.parametrize(("shift", "severity"), [(0.05, "good"), (0.5, "doubtful")])
def test_what_moved_since_the_last_item_is_judged(tmp_path: Path, shift: float, severity: str) -> None:
    store = Store(tmp_path / "store")
    put_item(homography(0.0, 1), b"", store)
    (finding,) = changes_since(homography(shift, 2), (40, 48), store)
    assert finding == (severity, f"CAM0 moved {shift:.2f} px since 2010-03-01")
    assert changes_since(homography(0.0, 2), (40, 48), store) == []  # the same numbers

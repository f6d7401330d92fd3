"""Which group a node's pictures lie in."""

from pathlib import Path

import numpy as np
import pytest
import xarray

import lightstage
from lightstage.api.groups import group_of, last_moving_normals, open_group, refuse_stranger, results_of
from lightstage.dag.answer import Answer, NodeAnswer
from lightstage.store.root import Store
from tests.conftest import put_result

PIPELINE = "stages:\n  pictures: {uses: capture}\n  clean: {uses: register, from: pictures}\n"


def test_a_source_s_group_is_the_session_s_own_under_any_name(
    finished: lightstage.OpenSession, tmp_path: Path
) -> None:
    pipeline = tmp_path / "p.yaml"
    pipeline.write_text(PIPELINE)
    store, raw = finished.opened, finished.folder / "raw.zarr"
    assert group_of("ball", "capture", store) == raw
    assert group_of("ball", "pictures", store, pipeline) == raw
    assert open_group(finished.read(), "pictures", store, pipeline).raw.sizes["frame"] == 7
    with pytest.raises(lightstage.RequestError, match="no result of 'clean'"):
        group_of("ball", "clean", store, pipeline)
    with pytest.raises(lightstage.RequestError, match="no result of a node 'pictures'"):
        group_of("ball", "pictures", store)  # of no pipeline here


def test_a_result_s_group_is_the_one_in_use(finished: lightstage.OpenSession) -> None:
    group = group_of("ball", "normals", finished.opened)
    assert group.parent == finished.opened.results / "ball" / "normals"
    assert (group.parent / "current").read_text().strip() == group.name
    assert set(open_group(finished.read(), "normals", finished.opened).data_vars) >= {"normal", "albedo", "valid"}


def test_a_session_that_is_not_there_is_named_before_its_node(finished: lightstage.OpenSession) -> None:
    with pytest.raises(lightstage.RequestError, match="no session 'bal'"):
        group_of("bal", "capture", finished.opened)


def test_a_stranger_is_what_neither_results_nor_pipeline_know(finished: lightstage.OpenSession) -> None:
    assert "normals" in results_of("ball", finished.opened)
    assert results_of("nobody", finished.opened) == []
    for known in ("normals", "capture", "shape"):
        refuse_stranger(finished.read(), known, finished.opened)
    with pytest.raises(lightstage.RequestError, match="'normal'; did you mean 'normals'"):
        refuse_stranger(finished.read(), "normal", finished.opened)


def normals(dim: str, count: int) -> xarray.Dataset:
    return xarray.Dataset({"normal": ((dim, "xyz", "y", "x"), np.zeros((count, 3, 2, 2), np.float32))})


@pytest.mark.parametrize(
    ("nodes", "last"),
    [
        ({"a": ("frame", 3), "b": ("tracking", 2)}, "a"),  # every frame before every tracking frame
        ({"a": ("tracking", 2), "b": ("tracking", 4)}, "b"),
        ({"a": ("frame", 1), "b": ("tracking", 1)}, None),  # a single one does not move
        ({"a": ("frame", 3), "b": None}, "a"),
        ({}, None),
    ],
)
def test_what_moves_last_is_what_a_film_is_of(
    tmp_path: Path, nodes: dict[str, tuple[str, int] | None], last: str | None
) -> None:
    root = Store(tmp_path / "store").root
    answers = {}
    for name, size in nodes.items():
        if size is not None:
            put_result(normals(*size), root, "head", name)
        path = None if size is None else root / "results" / "head" / name / "by-hand"
        answers[name] = NodeAnswer(path, 0, 0, 0.0, 0, {}, ())
    assert last_moving_normals(Answer("head", answers, 0.0)) == last

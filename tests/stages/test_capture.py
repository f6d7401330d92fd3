"""A session as the first node of every graph: its sizes, its labels, and how a picture is called."""

import math
from typing import Any

import pytest

from lightstage.stages.capture import STAGE

FACTS: dict[str, Any] = {
    "shape": [309, 406],
    "illumination": ["C", "X", "C"],
    "bands_nm": [0, 576],
    "time_s": [0.0, None, 1],
    "polarisation": ["parallel", "cross"],
}


def test_sizes_and_labels_by_hand() -> None:
    grid = STAGE.arrange([], FACTS, STAGE.params()).grid
    assert dict(grid.sizes) == {"frame": 3, "band": 2, "polarisation": 2, "y": 309, "x": 406}
    assert tuple(grid.sizes) == STAGE.outputs["raw"].dims
    assert grid.labels["illumination"] == (("frame",), ["C", "X", "C"])
    assert grid.labels["polarisation"] == (("polarisation",), ["parallel", "cross"])
    assert grid.along("band") == [0.0, 576.0]
    first, unknown, last = grid.along("time_s")
    assert (first, last) == (0.0, 1.0)
    assert math.isnan(unknown)


def test_it_computes_nothing_and_reads_no_node_and_no_item() -> None:
    assert STAGE.is_source
    assert STAGE.sources == 0
    assert not STAGE.calibration
    assert STAGE.context is None
    assert STAGE.arrange([], FACTS, STAGE.params()).groups == ()


def test_it_has_no_parameters() -> None:
    with pytest.raises(ValueError, match="frame"):
        STAGE.params(frame=1)


@pytest.mark.parametrize(
    ("dim", "index", "labels", "words"),
    [
        ("frame", 3, {"illumination": "Xc"}, "frame 3 (Xc)"),
        ("band", 1, {"band": 576.0}, "576 nm"),
        ("band", 0, {"band": 0.0}, ""),  # unfiltered light has no wavelength
    ],
)
def test_a_place_is_called(dim: str, index: int, labels: dict[str, Any], words: str) -> None:
    assert STAGE.places[dim](index, labels) == words

"""Which bands tell pigments, and which maps there are."""

from typing import Any

import pytest

from lightstage.dag.stage import Grid, StageError
from lightstage.stages.chromophores import STAGE, ChromophoresParams


def grid(bands: list[float]) -> Grid:
    sizes = {"tracking": 1, "band": len(bands), "y": 2, "x": 2}
    return Grid(sizes, {"tracking": (("tracking",), [0]), "band": (("band",), bands)})


@pytest.mark.parametrize(
    ("bands", "listed"), [([497.0, 576.0], "497 nm, 576 nm"), ([0.0, 0.0, 0.0], "unfiltered light")]
)
def test_fewer_than_three_filtered_bands_are_refused(bands: list[float], listed: str) -> None:
    with pytest.raises(StageError, match=f"three or more filtered bands, this session has {listed}"):
        STAGE.arrange([grid(bands)], {}, ChromophoresParams())


def test_a_band_that_the_item_lacks_is_refused() -> None:
    assert STAGE.context is not None
    items = {"bands": {"bands": [{"centre_nm": 576.0, "width_nm": 10.0}]}}
    with pytest.raises(StageError, match=r"no band at 434 nm \(it has 576\)"):
        STAGE.context({}, {"bands_nm": [434.0, 576.0]}, items, ChromophoresParams())


@pytest.mark.parametrize(
    ("model", "bands", "told"), [("beer_lambert", 6, True), ("beer_lambert", 4, False), ("kubelka_munk", 6, False)]
)
def test_oxygenation_is_put_out_where_it_can_be(model: Any, bands: int, told: bool) -> None:
    made = STAGE.arrange([grid([400.0 + 30 * i for i in range(bands)])], {}, ChromophoresParams(model=model))
    assert made.outputs is not None
    assert ("oxygenation" in made.outputs) == told
    assert made.grid.attrs["oxygenation"].startswith("NaN where" if told else "left out")

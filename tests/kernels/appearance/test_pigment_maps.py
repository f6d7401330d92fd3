"""The maps that a declaration announces are those that the kernel makes."""

from typing import Any

import numpy as np
import pytest

from lightstage.kernels.appearance import absorption
from lightstage.kernels.appearance.chromophores import chromophores
from lightstage.kernels.appearance.pigment_maps import MAPS, OXYGEN_BANDS, OXYGEN_MAPS
from lightstage.stages.chromophores import STAGE

NM = (434, 497, 545, 576, 600, 655)


def fit(bands: int, model: str = "beer_lambert") -> Any:
    passing = absorption.pass_bands([{"centre_nm": nm, "width_nm": 10} for nm in NM[:bands]])
    rho = np.linspace(0.2, 0.5, bands, dtype=np.float32)[:, None, None]
    settings = {"saturation": 0.75, "model_error": 0.01, "vessel_radius_um": 15.0, "oxygenation_error": 0.1}
    return chromophores(rho, np.full_like(rho, 1e-3), passing=passing, model=model, **settings)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("bands", "model", "oxygen"),
    [(3, "beer_lambert", False), (4, "beer_lambert", False), (5, "beer_lambert", True), (6, "kubelka_munk", False)],
)
def test_oxygen_is_told_by_five_bands_of_the_linear_model(bands: int, model: str, oxygen: bool) -> None:
    # melanin, two haemoglobins, a baseline: four unknowns, and a band to doubt them with
    assert OXYGEN_BANDS == 5
    arrays = set(fit(bands, model)) - {"stats", "warnings"}
    assert arrays == set(MAPS) | (set(OXYGEN_MAPS) if oxygen else set())


def test_what_is_declared_says_what_it_holds() -> None:
    every = MAPS | OXYGEN_MAPS
    assert set(STAGE.outputs) == set(every)
    assert len(every) == len(MAPS) + len(OXYGEN_MAPS)
    assert all(text.strip() for text in every.values())
    for name in every:
        # what has an error is itself a map
        assert name.removesuffix("_standard_error") in every

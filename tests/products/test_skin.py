"""Spectra of picked points, with a fit that is known."""

import csv
import io
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
import xarray

from lightstage.products.errors import ProductError
from lightstage.products.skin import Skin, read_skin, spectra, table

BANDS = (434.0, 576.0, 655.0)
ITEM = [{"centre_nm": nm, "width_nm": 15.0, "curve": None} for nm in BANDS]


class Known:
    """Melanin is the first band's reflectance, haemoglobin the second's; what is predicted is 0.5."""

    model, saturation, vessel_radius_um = "known", 0.75, 15.0
    pass_band = "gaussian"

    def fit(self, reflectance: Any, standard_error: Any, passing: Any) -> Mapping[str, Any]:
        return {
            "melanin": reflectance[0], "haemoglobin": reflectance[1],
            "baseline": 0 * reflectance[2], "residual": standard_error[0],
        }  # fmt: skip

    def predicted(self, melanin: Any, haemoglobin: Any, baseline: Any, passing: Any) -> Any:
        return np.full((len(melanin), len(passing)), 0.5)


def skin(tracking: int | None = None) -> Skin:
    """Reflectance grows to the right; the lowest row is not known."""
    x = np.mgrid[0:30, 0:40][1]
    rho = np.stack([0.1 + 0.01 * x, 0.5 - 0.01 * x, 0.6 + 0 * x])[None].astype(np.float32)
    rho[:, :, -1] = np.nan
    dims = ("tracking", "band", "y", "x")
    albedo = xarray.Dataset(
        {"reflectance": (dims, rho), "standard_error": (dims, 0.01 + 0 * rho)},
        {"tracking": [2], "band": list(BANDS)},
    )
    maps = {"melanin": rho[:, 0], "haemoglobin": rho[:, 1], "baseline": 0 * rho[:, 0], "residual": 0 * rho[:, 0]}
    pigments = xarray.Dataset(
        {name: (("tracking", "y", "x"), values) for name, values in maps.items()},
        {"tracking": [2]},
        {"melanin_unit": "1", "haemoglobin_unit": "1"},
    )
    return read_skin(albedo, pigments, ITEM, Known(), session="a", tracking=tracking)


def test_a_point_is_the_median_of_five_by_five() -> None:
    average, point = spectra(skin(), [(20, 10)])
    assert (average.name, average.at, point.name, point.at) == ("average", None, "point 1", (20, 10))
    np.testing.assert_allclose(point.reflectance, [0.3, 0.3, 0.6], rtol=1e-6)
    assert point.pigments["melanin"] == pytest.approx(0.3)
    assert point.fit.tolist() == [0.5] * 3
    (_, edge) = spectra(skin(), [(0, 28)])  # of the square, what is inside and known
    assert edge.reflectance[0] == pytest.approx(0.11)


def test_points_are_picked_by_how_much_there_is() -> None:
    _, little, much, blood = spectra(skin(), [])
    assert (little.name, much.name, blood.name) == ("little melanin", "much melanin", "much blood")
    assert little.at is not None
    assert much.at is not None
    assert little.at[0] < 10 < 30 < much.at[0]
    assert blood.pigments["haemoglobin"] > 0.4


def test_the_table_has_a_row_a_point_and_band() -> None:
    made = skin()
    rows = list(csv.DictReader(io.StringIO(table(made, spectra(made, [(20, 10)])).decode())))
    assert [row["band_nm"] for row in rows] == ["434", "576", "655"] * 2
    assert (rows[0]["x"], rows[3]["x"], rows[3]["y"]) == ("", "20", "10")
    assert float(rows[3]["reflectance"]) == pytest.approx(0.3)


def test_what_is_refused() -> None:
    for at, said in (((40, 3), "40,3 is outside the picture; X is 0 to 39 and Y is 0 to 29"), ((5, 99), "outside")):
        with pytest.raises(ProductError, match=said):
            spectra(skin(), [at])
    dark = skin()
    dark.reflectance[:, :10] = np.nan
    with pytest.raises(ProductError, match="5,3: nothing is known"):
        spectra(dark, [(5, 3)])
    with pytest.raises(ProductError, match="'chromophores' of session 'a' has no tracking frame 7; it has 2"):
        skin(tracking=7)

"""Which tracking frame."""

import pytest
import xarray

from lightstage.products.errors import ProductError
from lightstage.products.tracking import check_frame, tracking_frame


def result(*frames: int) -> xarray.Dataset:
    return xarray.Dataset(coords={"tracking": list(frames)})


def test_the_first_or_the_one_asked_for() -> None:
    results = {"shape": result(3, 7), "gloss": result(1, 3, 7)}
    assert tracking_frame(results, "shape", "a", None) == 3
    assert tracking_frame(results, "shape", "a", 7) == 7


def test_what_a_result_lacks_is_said() -> None:
    with pytest.raises(ProductError, match="'gloss' of session 'a' has no tracking frame 3; it has 7"):
        tracking_frame({"shape": result(3, 7), "gloss": result(7)}, "shape", "a", None)
    with pytest.raises(ProductError, match="'shape' of session 'a' has no tracking frame; it has none"):
        tracking_frame({"shape": result()}, "shape", "a", None)
    check_frame(3, [1, 3], "align", "a")

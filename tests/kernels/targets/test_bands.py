"""The scale of bands in which a white square has a known reflectance."""

import numpy as np
import pytest

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.bands import bands, item, prepare, verdict

SHAPE = (60, 80)
WHITE = np.s_[15:45, 20:60]


def square(counts: float) -> np.ndarray:
    """A white square on black, and the dark below both."""
    picture = np.full(SHAPE, 16, np.uint16)
    picture[WHITE] += np.uint16(counts)
    picture.flags.writeable = False
    return picture


def measured(**known: object) -> dict:
    about = {"target_reflectance": [0.8, 0.5], "white_level": 1023, "dark_picture": None, "flat_picture": None}
    return dict(bands({434.0: square(400), 576.0: square(600)}, **{**about, **known}))


def test_counts_above_the_dark_over_the_reflectance() -> None:
    fit = measured(dark_picture=np.full(SHAPE, 16.0))
    np.testing.assert_allclose(fit["scale"], [400 / 0.8, 600 / 0.5], rtol=1e-6)
    np.testing.assert_allclose(measured()["scale"], [416 / 0.8, 616 / 0.5], rtol=1e-6)  # the dark stays in
    assert fit["target"][30, 40]
    assert not fit["target"][5, 5]
    assert np.isnan(fit["patches"]).all()


def test_vignetting_is_taken_out() -> None:
    x = np.linspace(1, 0.9, SHAPE[1])[None] * np.ones(SHAPE)
    pictures = {434.0: np.round(16 + (square(500).astype(float) - 16) * x).astype(np.uint16)}
    known = {"white_level": 1023, "dark_picture": np.full(SHAPE, 16.0), "target_reflectance": [1.0]}
    even = bands(pictures, flat_picture=16 + 800 * x, **known)
    assert even["unevenness"][0] < 0.002  # counts are whole
    assert bands(pictures, flat_picture=None, **known)["unevenness"][0] > 0.01


def test_a_saturated_target_is_refused() -> None:
    with pytest.raises(KernelError, match="saturated"):
        bands(
            {434.0: np.full(SHAPE, 1023, np.uint16)},
            target_reflectance=[0.9],
            white_level=1023,
            dark_picture=None,
            flat_picture=None,
        )


def test_a_flat_without_its_dark_gets_it() -> None:
    class Picture:
        def __init__(self, counts: float) -> None:
            self.counts = counts

        def load(self) -> np.ndarray:
            return np.full(SHAPE, self.counts)

    dark = {"picture": Picture(32.0), "scale": 2.0}
    for included, counts in ((False, 116.0), (True, 100.0)):
        flat = {"picture": Picture(200.0), "scale": 2.0, "dark_included": included}
        numbers = prepare(target_reflectance=[1.0], white_level=1023, dark=dark, flat=flat)
        assert numbers["flat_picture"][0, 0] == counts
        assert numbers["dark_picture"][0, 0] == 16.0


def test_widths_stay_those_of_the_item_that_is_bound() -> None:
    arrays, labels = measured(), {"band": [434.0, 576.0]}
    bound = {"bands": {"bands": [{"centre_nm": 576.0, "width_nm": 10.0}]}}
    content = item(arrays=arrays, labels=labels, items=bound)
    assert [band["width_nm"] for band in content["bands"]] == [None, 10.0]
    assert [severity for severity, _ in verdict(arrays=arrays, labels=labels, items=bound)][-1] == "doubtful"
    assert all(s == "good" for s, _ in verdict(arrays=arrays, labels=labels, items={"dark": {}}))

"""Sums over highlights that the test draws, and the noise they have."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.photometry import highlight_sums, variance

Array = NDArray[np.float64]
SPOTS = np.array([[20.0, 18.0], [20.3, 25.7], [np.nan, np.nan]])


def spot(y: float, x: float, flux: float, sigma: float = 0.8) -> Array:
    """A round blur, brought to its flux."""
    rows, columns = np.ogrid[:40, :44]
    out = np.exp(-((rows - y) ** 2 + (columns - x) ** 2) / (2 * sigma**2))
    return np.asarray(flux * out / out.sum())


def sums(*pictures: Array, dark: float = 0.0) -> tuple[Array, NDArray[np.bool_]]:
    return highlight_sums(np.stack(pictures), SPOTS, dark=np.full((40, 44), dark))  # type: ignore[arg-type]


def test_one_bright_pixel_by_hand() -> None:
    picture = np.full((1, 40, 44), 30, np.uint16)
    picture[0, 20, 18] = 130
    found, full = highlight_sums(picture, np.array([[20.0, 18.0]]), dark=np.full((40, 44), 25.0))
    assert found[0, 0] == pytest.approx(100)
    assert not full[0, 0]
    picture[0, 21, 18] = 1023
    assert highlight_sums(picture, np.array([[20.0, 18.0]]), dark=np.zeros((40, 44)))[1][0, 0]


def test_the_flux_is_found_whatever_the_background() -> None:
    found, _ = sums(spot(20, 18, 5000) + 40.0, dark=12.0)
    # 2.5 px and the soft edge hold all of a blur of 0.8 px but a hundredth, and the ring has some of that
    assert found[0, 0] == pytest.approx(5000, rel=0.02)
    assert np.isnan(found[0, 2])


@given(st.floats(0, 5), st.floats(0, 5), st.floats(-50, 50))
@settings(max_examples=25)
def test_lights_that_shine_together_add_up(a: float, b: float, level: float) -> None:
    one, other = spot(20, 18, 3000), spot(20.3, 25.7, 2000)
    apart, _ = sums(one, other)
    together, _ = sums(a * one + b * other + level)
    np.testing.assert_allclose(together[0, :2], a * apart[0, :2] + b * apart[1, :2], atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_the_variance_is_that_of_many_pictures(seed: int) -> None:
    random = np.random.default_rng(seed)
    light = spot(20, 18, 4000) + spot(20.3, 25.7, 500)
    noisy = random.poisson(light * 10, (1500, 40, 44)) / 10 + random.normal(0, 1.2, (1500, 40, 44))
    found, _ = highlight_sums(noisy, SPOTS[:1], dark=np.zeros((40, 44)))  # type: ignore[arg-type]
    told = variance(np.array([4000.0]), radius_px=2.5, electrons_per_count=10, read_noise_counts=1.2)
    # 1500 numbers tell a variance to 4 %; the soft edge counts as a whole pixel or none in what is told
    assert found.var() == pytest.approx(told[0], rel=0.2)


def test_refusals() -> None:
    picture = np.zeros((1, 40, 44), np.uint16)
    with pytest.raises(KernelError, match=r"light 0 at \(3.0, 20.0\) is within 7 pixels of the border"):
        highlight_sums(picture, np.array([[20.0, 3.0]]), dark=np.zeros((40, 44)))
    with pytest.raises(KernelError, match="both must be of one camera"):
        highlight_sums(picture, SPOTS, dark=np.zeros((3, 3)))

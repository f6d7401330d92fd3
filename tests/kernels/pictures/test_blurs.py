"""Blurs: by hand, against SciPy's in float64, and beside borders and what is not known."""

from typing import Any

import numpy as np
import pytest
from scipy.ndimage import correlate1d, gaussian_filter

from lightstage.kernels.pictures import blurs

ROUNDING = 1e-6


def picture(*shape: int) -> Any:
    out = np.random.default_rng(1).random(shape, np.float32)
    out.flags.writeable = False
    return out


def test_a_mean_by_hand() -> None:
    """Borders are mirrored with their pixel once: beside 1 lies 2, twice."""
    np.testing.assert_allclose(
        blurs.box(np.array([[1.0, 2, 6]], np.float32), 3), [[5 / 3, 3, 10 / 3]], atol=ROUNDING
    )


def test_half_the_size_by_hand() -> None:
    """(6 x 1 + 4 x 2 + 4 x 2 + 6 + 6) / 16, and the row alike, of itself."""
    found = blurs.half_size(np.array([[1.0, 2, 6]], np.float32))
    np.testing.assert_allclose(found, [[34 / 16, 54 / 16]], atol=ROUNDING)


@pytest.mark.parametrize("shape", [(13, 17), (40, 9), (1, 5), (3, 2)])
@pytest.mark.parametrize("sigma", [0.3, 0.8, 2.0, 5.0])
def test_a_gaussian(shape: tuple[int, int], sigma: float) -> None:
    p = picture(*shape)
    radius = (round(8 * sigma + 1) | 1) // 2
    right = gaussian_filter(p.astype(float), sigma, mode="mirror", radius=radius)
    np.testing.assert_allclose(blurs.gaussian(p, sigma), right, atol=ROUNDING)


@pytest.mark.parametrize("shape", [(13, 17), (8, 6), (1, 5), (2, 2)])
def test_half_the_size(shape: tuple[int, int]) -> None:
    p = picture(*shape)
    taps = np.array([1, 4, 6, 4, 1]) / 16
    whole = correlate1d(correlate1d(p.astype(float), taps, 0, mode="mirror"), taps, 1, mode="mirror")
    np.testing.assert_allclose(blurs.half_size(p), whole[::2, ::2], atol=ROUNDING)


def test_what_is_not_known_is_the_mean_around_it() -> None:
    p = np.array(picture(20, 20))
    p[10, 10] = np.nan
    found = blurs.filled(p)
    np.testing.assert_allclose(found[10, 10], np.nanmean(p[7:14, 7:14]), rtol=1e-5)
    np.testing.assert_array_equal(found[np.isfinite(p)], p[np.isfinite(p)])
    np.testing.assert_array_equal(blurs.filled(np.full((9, 9), np.nan, np.float32)), 0)

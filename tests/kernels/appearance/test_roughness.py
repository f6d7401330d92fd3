"""The lobe's moments, and the noise of neighbourhoods."""

import numpy as np
import pytest

from lightstage.kernels.appearance.roughness import WINDOWS_PX, measure, summed_variance


def test_moments_by_hand() -> None:
    """One pixel: X alone is 6 of C = 10, so m_x = 2; Y with its complement 7 - 3 = 4; Z alone 5, so 0."""
    values = {"C": 10.0, "X": 6.0, "Y": 7.0, "Yc": 3.0, "Z": 5.0}
    moments = measure([{name: np.full((8, 8), value, np.float32) for name, value in values.items()}])
    np.testing.assert_allclose(moments.constant, 10)
    np.testing.assert_allclose(moments.vector, np.broadcast_to([2, 4, 0], (8, 8, 3)))


def test_a_pixel_that_one_picture_lacks_is_not_told() -> None:
    pictures = {name: np.ones((8, 8), np.float32) for name in ("C", "X", "Y", "Z")}
    pictures["Y"][3, 3] = np.nan
    moments = measure([pictures])
    assert np.isnan(moments.constant[3, 3])
    assert np.isfinite(moments.constant).sum() == 63


def test_noise_of_neighbourhoods_within_each_other_is_correlated() -> None:
    """A weighted sum of white noise under two Gaussian windows, against 400 draws."""
    weights = [np.array(weight) for weight in (0.0, 0.3, 0.7, 0.0, 0.0)]
    noise = np.random.default_rng(0).standard_normal((400, 129, 129))
    middle = []
    for sigma in WINDOWS_PX[1:3]:
        x = np.arange(-64, 65)
        window = np.exp(-(x**2) / (2 * sigma**2))
        window /= window.sum()
        middle.append(np.einsum("kyx,y,x->k", noise, window, window))
    true = np.var(0.3 * middle[0] + 0.7 * middle[1])
    deviations = [np.array(1 / np.sqrt(4 * np.pi * sigma**2)) for sigma in WINDOWS_PX]
    # the variance of 400 draws is known to 7 %; without the correlation it would be three quarters of this
    assert summed_variance(weights, deviations) == pytest.approx(true, rel=0.15)

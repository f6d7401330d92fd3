"""How bright the highlights in a picture of a mirror ball are: soft apertures of one radius around known places.

    sum_i = integral of w_i (picture - dark - background_i)        w_i = clip(radius + 1/2 - distance, 0, 1)

The background is the mean of the ring outside the aperture. A median would shrug off another highlight in the ring,
but it is not linear in the light: a leak of 2 % then reads 0.4 % too low. So sums of lights that shine together are
sums of one-light sums exactly, neighbours in aperture or ring included, and `synchronisation` separates them.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError

Array = NDArray[np.float64]


class Aperture(NamedTuple):
    """What a highlight is summed over, and how noisy the sensor is there."""

    radius_px: float
    electrons_per_count: float
    read_noise_counts: float


def highlight_sums(
    pictures: NDArray[np.uint16], positions: Array, *, dark: Array, white: int = 1023, radius_px: float = 2.5
) -> tuple[Array, NDArray[np.bool_]]:
    """Sum over each highlight.

    Args:
        pictures: (picture, y, x), counts.
        positions: (light, yx), pixels; NaN for a light that the ball does not show.
        dark: (y, x), counts: the camera's dark, better with the room light of a picture without lights in it, for
            the ring of a highlight at the ball's rim lies half outside the ball.
        white: the count at which a pixel is saturated.

    Returns:
        (picture, light) counts above the background, NaN without a position; (picture, light) whether a pixel of
        the aperture is saturated.

    Raises:
        KernelError: a highlight is too near the border of the picture.
    """
    shape = pictures.shape[1:]
    if dark.shape != shape:
        raise KernelError(f"the dark is {dark.shape} pixels and the pictures {shape}; both must be of one camera")
    reach = int(np.ceil(radius_px)) + 4
    sums = np.full((len(pictures), len(positions)), np.nan)
    saturated = np.zeros(sums.shape, np.bool_)
    for k, (y, x) in enumerate(positions):
        if np.isnan(y) or np.isnan(x):
            continue
        top, left = round(y) - reach, round(x) - reach
        if top < 0 or left < 0 or top + 2 * reach >= shape[0] or left + 2 * reach >= shape[1]:
            raise KernelError(
                f"the highlight of light {k} at ({x:.1f}, {y:.1f}) is within {reach} pixels of the border; "
                "move the ball, or leave the light out"
            )
        window = np.s_[top : top + 2 * reach + 1, left : left + 2 * reach + 1]
        rows, columns = np.ogrid[window]
        distance = np.hypot(rows - y, columns - x)
        weight = np.clip(radius_px + 0.5 - distance, 0, 1)
        ring = (distance > radius_px + 1) & (distance <= radius_px + 4)
        raw = pictures[:, window[0], window[1]]
        light = raw - dark[window]
        background = light[:, ring].mean(axis=1)
        sums[:, k] = (light * weight).sum(axis=(1, 2)) - background * weight.sum()
        saturated[:, k] = (raw[:, weight > 0] >= white).any(axis=1)
    return sums, saturated


def variance(sums: Array, *, radius_px: float, electrons_per_count: float, read_noise_counts: float) -> Array:
    """Variance of highlight sums, counts squared: shot noise, and read noise of the aperture and its ring."""
    area = np.pi * radius_px**2 + 1
    ring = np.pi * ((radius_px + 4) ** 2 - (radius_px + 1) ** 2)
    read = read_noise_counts**2 * (area + area**2 / ring)
    return np.clip(sums, 0, None) / electrons_per_count + read

"""One picture from all bands, weighted by each band's noise.

Geometry is the same in every band: r_b = a_b s + noise, with s the shading that all bands share and a_b the
band's albedo times light. The best weights for s are a_b / sigma_b^2, the same for all pictures of a point,
so any method that is linear in the pictures can run on the fused ones.
"""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.hw.illuminations import CONSTANT, pairs
from lightstage.kernels.pictures.noise import noise_model

Image = NDArray[np.float32]


def fuse(bands: Sequence[Sequence[Image]], names: Sequence[str]) -> list[Image]:
    """Fuse the bands of every illumination.

    Args:
        bands: per band, per illumination, (y, x) radiance; NaN where not valid.
        names: the illuminations.

    Returns:
        Per illumination, (y, x): the weighted mean over bands. A band in which a point is not valid does not
        count there; NaN where none is valid.
    """
    # in float64: where pictures nearly cancel, as behind a subject, their last bits are all that is left
    totals = [np.zeros(picture.shape) for picture in bands[0]]
    weights = np.zeros(totals[0].shape)
    for pictures in bands:
        by_name = dict(zip(names, pictures, strict=True))
        alpha, beta = noise_model(by_name)
        level = _level(by_name)
        usable = np.isfinite(sum(pictures, np.float32(0)))
        # smoothed, so that a pixel's own noise does not choose its weight
        smooth = cv2.GaussianBlur(np.where(usable, np.maximum(level, 0), 0).astype(np.float64), (0, 0), 1.5)
        weight = np.where(usable, smooth / (alpha + beta * smooth + 1e-30), 0)
        weights += weight
        for total, picture in zip(totals, pictures, strict=True):
            np.add(total, weight * np.where(usable, picture, 0), out=total)
    with np.errstate(invalid="ignore", divide="ignore"):
        return [(total / weights).astype(np.float32) for total in totals]


def _level(pictures: Mapping[str, Image]) -> Image:
    """The constant picture, measured or made from a pair, or twice the mean of what there is."""
    if CONSTANT in pictures:
        return pictures[CONSTANT]
    if pairs(pictures):
        gradient, opposite = pairs(pictures)[0]
        return pictures[gradient] + pictures[opposite]
    return np.asarray(2 * sum(pictures.values()) / len(pictures), np.float32)

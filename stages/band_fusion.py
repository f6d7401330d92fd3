"""One picture from all bands, weighted by each band's noise.

Geometry is the same in every band: r_b = a_b s + noise, with s the shading that all bands share and a_b the
band's albedo times light. The best weights for s are a_b / sigma_b^2, the same for all pictures of a point,
so any method that is linear in the pictures can run on the fused ones.

The noise is measured in the capture itself. A gradient and its complement add up to the constant picture
whatever the subject, so e = r_a + r_a' - r_c is noise alone, with var(e) = 3 alpha + 2 beta r_c for read noise
alpha and shot noise beta r (Foi et al. 2008, doi:10.1109/TIP.2008.2001399, for the model). Without complements
the constant picture's finest detail stands in for it (Immerkaer 1996, doi:10.1006/cviu.1996.0060).
"""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]


def noise_model(pictures: Mapping[str, Image]) -> tuple[float, float]:
    """(alpha, beta): the variance of a pixel of radiance r is alpha + beta r, in the pictures' unit.

    Args:
        pictures: one band, by illumination, (y, x).
    """
    residuals: list[tuple[Image, Image, float, float]] = []
    if "C" in pictures:
        constant = pictures["C"]
        residuals = [
            (pictures[a] + pictures[a + "c"] - constant, constant, 3.0, 2.0)
            for a in "XYZ"
            if a in pictures and a + "c" in pictures
        ]
    if not residuals:
        for picture in pictures.values():
            mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
            residuals.append((cv2.filter2D(picture, -1, mask), picture, 1.0, 1.0))
    errors = np.concatenate([e.reshape(-1) for e, _, _, _ in residuals])
    levels = np.concatenate([r.reshape(-1) for _, r, _, _ in residuals])
    _, _, reads, shots = residuals[0]
    known = np.isfinite(errors) & np.isfinite(levels)
    errors, levels = errors[known], levels[known]
    if errors.size < 64:
        return 1.0, 0.0
    order = np.argsort(levels)
    bins = np.array_split(order, min(32, errors.size // 16))
    level = np.array([np.mean(levels[b]) for b in bins])
    # the median absolute deviation does not see highlights that move or saturate
    variance = np.array([(1.4826 * np.median(np.abs(errors[b]))) ** 2 for b in bins])
    design = np.stack([np.full_like(level, reads), shots * np.maximum(level, 0)], axis=1)
    weight = 1 / np.maximum(variance, 1e-30)
    alpha, beta = np.linalg.lstsq(design * weight[:, None], variance * weight, rcond=None)[0]
    if beta < 0:
        alpha, beta = np.average(variance / reads, weights=weight), 0.0
    if alpha < 0:
        alpha, beta = 0.0, np.average(variance / np.maximum(design[:, 1], 1e-30), weights=weight)
    return float(alpha), float(beta)


def fuse(bands: Sequence[Sequence[Image]], names: Sequence[str]) -> list[Image]:
    """Fuse the bands of every illumination.

    Args:
        bands: per band, per illumination, (y, x) radiance; NaN where not valid.
        names: the illuminations.

    Returns:
        Per illumination, (y, x): the weighted mean over bands. A band in which a point is not valid does not
        count there; NaN where none is valid.
    """
    totals = [np.zeros_like(picture, dtype=np.float32) for picture in bands[0]]
    weights = np.zeros_like(totals[0])
    for pictures in bands:
        by_name = dict(zip(names, pictures, strict=True))
        alpha, beta = noise_model(by_name)
        level = _level(by_name)
        usable = np.isfinite(sum(pictures, np.float32(0)))
        # smoothed, so that a pixel's own noise does not choose its weight
        smooth = cv2.GaussianBlur(np.where(usable, np.maximum(level, 0), 0).astype(np.float32), (0, 0), 1.5)
        weight = np.where(usable, smooth / (alpha + beta * smooth + 1e-30), 0).astype(np.float32)
        weights += weight
        for total, picture in zip(totals, pictures, strict=True):
            np.add(total, weight * np.where(usable, picture, 0), out=total)
    with np.errstate(invalid="ignore", divide="ignore"):
        return [total / weights for total in totals]


def _level(pictures: Mapping[str, Image]) -> Image:
    """The constant picture, measured or made from a pair, or twice the mean of what there is."""
    if "C" in pictures:
        return pictures["C"]
    for axis in "XYZ":
        if axis in pictures and axis + "c" in pictures:
            return pictures[axis] + pictures[axis + "c"]
    return np.asarray(2 * sum(pictures.values()) / len(pictures), np.float32)

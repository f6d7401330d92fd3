"""Where the subject is: found in the constant picture when the capture brings no mask.

A dilated mask hurts depth (background normals are noise), an eroded one hardly: so the mask is tight.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage.filters import threshold_otsu

from lightstage.kernels.errors import KernelError

_LEAST_PART = 0.002
_DIM = 0.02
"""A subject is at least this part of its own brightness above the background."""

_LIT = 0.1
"""What is in a given mask and dimmer than this part of its median is background, or tells nothing."""


def find_subject(constant: NDArray[np.floating]) -> NDArray[np.bool_]:
    """The largest bright thing: threshold against the background, largest component, holes filled.

    Args:
        constant: (y, x) radiance under constant light; NaN where not valid.

    Raises:
        KernelError: nothing stands out.
    """
    known = np.isfinite(constant)
    # in float64, as below: a threshold follows, and the last bits of a blur are not the same everywhere
    values = np.where(known, constant, 0).astype(np.float64)
    smooth = cv2.GaussianBlur(values, (0, 0), 0.8)
    bright = float(np.percentile(smooth, 99))
    if not bright > 0:
        raise KernelError("no subject stands out from the background: the constant picture is black")
    dark = smooth[smooth < 0.05 * bright]
    ground, noise = 0.0, 0.0
    if dark.size <= 0.02 * smooth.size:
        # a lit backdrop, or a subject that fills the picture: split by brightness (Otsu 1979)
        split = float(threshold_otsu(smooth))
        dark = smooth[smooth < split]
        if float(np.median(dark)) > 0.3 * bright:
            dark = dark[:0]  # two shades of the subject, no background
    if dark.size > 100:
        ground = float(np.median(dark))
        noise = 1.4826 * float(np.median(np.abs(dark - ground)))
    above = smooth > ground + max(6 * noise, _DIM * (bright - ground))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(above.astype(np.uint8), connectivity=4)
    if count < 2:
        raise KernelError("no subject stands out from the background; give the capture a mask")
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    if stats[largest, cv2.CC_STAT_AREA] < _LEAST_PART * values.size:
        raise KernelError("no subject stands out from the background; give the capture a mask")
    subject = labels == largest
    outlines, _ = cv2.findContours(subject.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros(subject.shape, np.uint8)
    cv2.drawContours(filled, outlines, -1, 1, cv2.FILLED)
    return tight(filled > 0)


def lit(mask: NDArray[np.bool_], constant: NDArray[np.floating]) -> NDArray[np.bool_]:
    """A given mask without the background that it lets in: ratios of what is not lit are noise, and spread.

    Args:
        mask: (y, x), as it came with the capture.
        constant: (y, x) radiance under constant light.
    """
    if not mask.any():
        return mask
    smooth = cv2.GaussianBlur(np.where(np.isfinite(constant), constant, 0).astype(np.float64), (0, 0), 0.8)
    usual = float(np.median(smooth[mask]))
    bright = mask & (smooth > _LIT * usual)
    if bright.all() or not (mask & ~bright).any():
        return mask
    # where the background was cut away, its neighbours are half of it
    edge = cv2.dilate((mask & ~bright).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return np.asarray(bright & ~edge)


def tight(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Without the two outermost pixels: the threshold lets in one that sees the background, or next to one."""
    return np.asarray(cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=2) > 0)

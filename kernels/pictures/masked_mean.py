"""The mean around each pixel, of what is known there: a Gaussian over the picture, divided by one over the mask."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Blur = Callable[[NDArray[Any], float], NDArray[Any]]


def reflected(picture: NDArray[Any], sigma: float) -> NDArray[Any]:
    """OpenCV's Gaussian, the picture reflected at its borders."""
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma))


def ending(picture: NDArray[Any], sigma: float) -> NDArray[Any]:
    """OpenCV's Gaussian, nothing beyond the borders."""
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT))


class MaskedMean:
    """Gaussian means over a mask, of as many pictures as there are."""

    def __init__(
        self,
        known: NDArray[np.bool_],
        sigma_px: float,
        *,
        least: float = 1e-6,
        blur: Blur = reflected,
        dtype: type[np.floating[Any]] = np.float64,
    ) -> None:
        """Blur the mask.

        Args:
            known: (y, x), the pixels that count.
            sigma_px: of the Gaussian.
            least: share of the window that is known, below which means fall off to 0: far from what is known
                nothing is divided by nothing.
            blur: `reflected`, `ending`, or `blurs.gaussian`, whose bits are the same on every processor.
            dtype: in which it is computed.
        """
        self._known, self._sigma, self._blur, self._dtype = known, sigma_px, blur, dtype
        self._share = np.maximum(blur(known.astype(dtype), sigma_px), dtype(least))

    def __call__(self, picture: NDArray[Any]) -> NDArray[Any]:
        """The means, (y, x), or (y, x, channel) for such a picture; what is not known may be anything."""
        layers = (slice(None), slice(None), *[None] * (picture.ndim - 2))
        known = np.where(self._known[layers], picture, 0).astype(self._dtype, copy=False)
        return np.asarray(self._blur(known, self._sigma) / self._share[layers])

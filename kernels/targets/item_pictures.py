"""Pictures and pixels as calibration items hold them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

SCALE = 16
"""Stored value = counts x this: a mean of frames has fractions."""


def stored(counts: NDArray[Any]) -> NDArray[np.uint16]:
    """Counts as an item's picture holds them."""
    return np.clip(np.round(counts * SCALE), 0, 65535).astype(np.uint16)


def listed(mask: NDArray[np.bool_]) -> list[list[int]]:
    """(x, y) of a mask's pixels."""
    return [[int(x), int(y)] for y, x in np.argwhere(mask)]


def counts_of(stored_picture: Mapping[str, Any] | None) -> NDArray[np.float64] | None:
    """Counts (y, x) of an item's `picture` with its `scale`; None where no item is bound."""
    if stored_picture is None:
        return None
    return np.asarray(np.asarray(stored_picture["picture"].load(), np.float64) / stored_picture["scale"])


def mask_of(picture: Any) -> NDArray[np.bool_] | None:
    """Where a capture's mask (y, x) says that the target is; None where the capture has none."""
    return None if picture is None else np.asarray(picture.load()) > 0

"""What is not known takes the value of the nearest pixel that is, so that no filter sees an edge at a hole."""

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

Scalar = TypeVar("Scalar", bound=np.generic)


def nearest_fill(values: NDArray[Scalar], known: NDArray[np.bool_]) -> NDArray[Scalar]:
    """Values, with those of unknown pixels taken from the nearest known pixel (Euclidean distance).

    Args:
        values: (..., y, x).
        known: (y, x), with at least one pixel known.

    Raises:
        ValueError: nothing is known.
    """
    if known.all():
        return values
    if not known.any():
        raise ValueError("no pixel is known, so there is none to fill from")
    rows: Any
    columns: Any
    rows, columns = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return values[..., rows, columns]

"""A flat plate that faces the camera, as a material."""

import numpy as np

from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.products.material import Material

SHAPE = (16, 20)
CAMERA = Pinhole(
    SHAPE, (100.0, 100.0, 9.5, 7.5), (0.0,) * 5, np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 900.0])
)


def plate(*, albedo: float) -> Material:
    """Of one albedo in unfiltered light, without gloss; its first column is not known."""
    reflectance = np.full((1, *SHAPE), albedo)
    reflectance[:, :, 0] = np.nan
    normal = np.zeros((*SHAPE, 3))
    normal[..., 2] = 1
    return Material(
        "plate", 0, (0.0,), (None,), reflectance, True, normal, np.full(SHAPE, 900.0), np.zeros(SHAPE, np.uint8),
        CAMERA, None, {"reflectance": "r", "relief": "n", "shape": "s"},
    )  # fmt: skip

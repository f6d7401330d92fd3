"""A surface under lights that somebody chooses (`distant_lights.py`): Lambertian shading, and cast shadows.

Source: Lambert (1760).
"""

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.appearance.distant_lights import DistantLight
from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.kernels.surface.visibility import visible

Image = NDArray[np.float32]
_FAR_MM = 1e6
"""Where a distant light is put to cast shadows: its rays are parallel to a tenth of a milliradian over a face."""
_SLACK_MM = 2.0


def shade(normal: Image, lights: tuple[DistantLight, ...], seen: Image | None = None) -> Image:
    """Lambertian shading of a white surface, (y, x) float32.

    Args:
        normal: (xyz, y, x) unit vectors, world frame, NaN where there is none.
        lights: where light comes from; one behind the surface gives nothing.
        seen: (light, y, x), the part of each light that a point sees; None: all of it.
    """
    out = np.zeros(normal.shape[1:], np.float32)
    for k, light in enumerate(lights):
        facing = np.tensordot(np.array(light.direction, np.float32), normal, axes=1)
        lit = np.float32(light.strength) * np.maximum(facing, np.float32(0))
        out += lit if seen is None else lit * seen[k]
    return out


def cast_shadows(depth_mm: Image, camera: Pinhole, lights: tuple[DistantLight, ...]) -> Image:
    """(light, y, x): the part of each light that a point sees past the rest of the surface; 1 off the surface.

    Args:
        depth_mm: (y, x) camera z, NaN where there is no surface.
    """
    depth = np.asarray(depth_mm, np.float64)
    there = np.isfinite(depth)
    out = np.ones((len(lights), *depth.shape), np.float32)
    if there.any():
        lamps = np.stack([_FAR_MM * np.array(light.direction) for light in lights])
        points = camera.points(np.where(there, depth, 1.0))[there]
        out[:, there] = visible(points, depth, camera, lamps, slack_mm=_SLACK_MM).T
    return out

"""A surface under lights that somebody chooses: Lambertian shading by distant lights.

A light stands at an azimuth (right is positive) and an elevation (up is positive) as the camera sees it:
l = (sin a cos e, sin e, cos a cos e) in the world frame, so that (0, 0) is at the camera.

Source: Lambert (1760).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.kernels.surface.visibility import visible

Image = NDArray[np.float32]
_FAR_MM = 1e6
"""Where a distant light is put to cast shadows: its rays are parallel to a tenth of a milliradian over a face."""
_SLACK_MM = 2.0


class DistantLight(NamedTuple):
    """One light."""

    azimuth_deg: float
    elevation_deg: float
    strength: float

    @property
    def direction(self) -> NDArray[np.float64]:
        """(xyz), the unit vector towards the light."""
        a, e = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        return np.array([math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e)])


def parse_lights(text: str) -> tuple[DistantLight, ...]:
    """Lights from `azimuth,elevation,strength` each, with spaces between.

    Raises:
        ValueError: a number is missing or out of range, or there is no light.
    """
    found = []
    for word in text.split():
        try:
            light = DistantLight(*map(float, word.split(",")))
        except (TypeError, ValueError):
            light = DistantLight(math.nan, 0, 0)
        azimuth, elevation, strength = light
        if not (-180 <= azimuth <= 180 and -90 <= elevation <= 90 and 0 < strength <= 100):  # also false for NaN
            raise ValueError(
                f"light '{word}': expected azimuth,elevation,strength, such as -30,15,0.5: from -180 to 180 "
                "and from -90 to 90 degrees, and a strength above 0"
            )
        found.append(light)
    if not found:
        raise ValueError("no light is named; expected azimuth,elevation,strength for each, such as 0,0,1")
    return tuple(found)


def shade(normal: Image, lights: tuple[DistantLight, ...], seen: Image | None = None) -> Image:
    """Lambertian shading of a white surface, (y, x) float32.

    Args:
        normal: (xyz, y, x) unit vectors, world frame, NaN where there is none.
        lights: where light comes from; one behind the surface gives nothing.
        seen: (light, y, x), the part of each light that a point sees; None: all of it.
    """
    out = np.zeros(normal.shape[1:], np.float32)
    for k, light in enumerate(lights):
        facing = np.tensordot(light.direction.astype(np.float32), normal, axes=1)
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
        lamps = np.stack([_FAR_MM * light.direction for light in lights])
        points = camera.points(np.where(there, depth, 1.0))[there]
        out[:, there] = visible(points, depth, camera, lamps, slack_mm=_SLACK_MM).T
    return out

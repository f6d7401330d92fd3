"""Lights that somebody chooses, and how they are written. Pure Python: a stage's parameters are read with it.

A light stands at an azimuth (right is positive) and an elevation (up is positive) as the camera sees it:
l = (sin a cos e, sin e, cos a cos e) in the world frame, so that (0, 0) is at the camera.
"""

import math
from typing import NamedTuple


class DistantLight(NamedTuple):
    """One light."""

    azimuth_deg: float
    elevation_deg: float
    strength: float

    @property
    def direction(self) -> tuple[float, float, float]:
        """(xyz), the unit vector towards the light."""
        a, e = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        return math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e)


def parse_lights(text: str) -> tuple[DistantLight, ...]:
    """Lights from `azimuth,elevation,strength` each, with spaces between.

    Raises:
        ValueError: a number is missing or out of range, or there is no light.
    """
    lights = []
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
        lights.append(light)
    if not lights:
        raise ValueError("no light is named; expected azimuth,elevation,strength for each, such as 0,0,1")
    return tuple(lights)

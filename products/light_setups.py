"""The lights of relit pictures: distant ones, an environment, and those of the rig.

Light 1 makes a white surface that faces it show 1: lights from afar have their strength everywhere, the rig's have
their power at the lights' mean distance from the stage's centre, and under an environment of radiance 1 a white
surface that sees all of it shows 1. An environment is some hundred distant lights, by median cut.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.appearance.relighting import Lamps, median_cut
from lightstage.kernels.normals.near_light import Lights
from lightstage.products.errors import ProductError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Setup:
    """The lights of one picture."""

    name: str
    """Of its files."""
    text: str
    lamps: Lamps
    """(light, rgb)."""
    turning: int = 0
    """How many of the lamps, the first ones, stand for an environment."""


class Distant(NamedTuple):
    """A light from afar."""

    azimuth_deg: float
    """From the camera to the picture's right."""
    elevation_deg: float
    strength: float


def direction(azimuth_deg: float, elevation_deg: float) -> Array:
    """(xyz): the unit vector towards a light; azimuth from the camera to the picture's right, elevation up."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    across = np.cos(elevation)
    return np.array([across * np.sin(azimuth), np.sin(elevation), across * np.cos(azimuth)])


def turned(directions: Array, degrees: float) -> Array:
    """Directions (light, xyz) turned about the vertical: at 90 degrees +z comes to +x."""
    sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    x, y, z = directions.T
    return np.stack([cosine * x + sine * z, y, cosine * z - sine * x], axis=1)


def environment_lamps(radiance: NDArray[np.float32], count: int, rotate_deg: float = 0.0) -> Lamps:
    """The lights that stand for an environment, turned about the vertical.

    Args:
        radiance: (y, x, rgb), in latitude and longitude.
        count: of the lights.
        rotate_deg: at 90 what was towards the camera is at the picture's right.
    """
    directions, strength = median_cut(radiance, count)
    return Lamps.distant(turned(directions, rotate_deg), strength)


def one_picture(lights: Sequence[Distant], environment: Lamps | None, environment_text: str = "") -> list[Setup]:
    """The picture that all distant lights and an environment light together, if there are any."""
    if not lights and environment is None:
        return []
    parts, words, kinds = [], [], []
    if environment is not None:
        parts.append(environment)
        words.append(environment_text)
        kinds.append("environment")
    if lights:
        towards = np.stack([direction(light.azimuth_deg, light.elevation_deg) for light in lights])
        parts.append(Lamps.distant(towards, np.array([[light.strength] * 3 for light in lights])))
        words += ["(" + ", ".join(f"{number:g}" for number in light) + ")" for light in lights]
        kinds.append("lights")
    turning = 0 if environment is None else len(environment.places)
    return [Setup("_".join(kinds), " + ".join(words), together(parts), turning)]


def together(parts: Iterable[Lamps]) -> Lamps:
    """Several lamps as one."""
    return Lamps(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def led_pictures(asked: Iterable[str], item: Mapping[str, Any]) -> list[Setup]:
    """The pictures under the rig's lights: `L07`, `L07+L12` for both, or `all` for one of each.

    Args:
        asked: for each picture.
        item: the lights item.

    Raises:
        ProductError: the rig has no light of that name.
    """
    every = rig_lamps(item)
    setups: dict[str, Setup] = {}
    for text in asked:
        for name in list(every) if text == "all" else [text]:
            members = name.split("+")
            missing = [member for member in members if member not in every]
            if missing:
                close = get_close_matches(missing[0], every, n=1)
                hint = f"; did you mean '{close[0]}'?" if close else ""
                raise ProductError(
                    f"{text}: the rig has no light '{missing[0]}'{hint}; "
                    f"it has {next(iter(every))} to {list(every)[-1]}"
                )
            setups[name] = Setup(name, name, together([every[member] for member in members]))
    return list(setups.values())


def rig_lamps(item: Mapping[str, Any]) -> dict[str, Lamps]:
    """The rig's lights by name; a light without a place is distant."""
    lights = Lights.of(item, near=False)
    every = {}
    for k, entry in enumerate(item["lights"]):
        strength = np.full((1, 3), lights.power[k])
        if entry["position_mm"] is None:
            every[entry["id"]] = Lamps.distant(lights.position[[k]] / lights.distance, strength)
        else:
            every[entry["id"]] = Lamps(lights.position[[k]], strength, np.array([lights.distance]))
    return every

"""The parts of calibration items that kernels read: only these are in a key, so that nothing else re-runs them."""

from collections.abc import Mapping
from typing import Any


def lens_of(camera: Mapping[str, Any]) -> Mapping[str, Any]:
    """What a camera item says of where it stands and how it sees."""
    return {name: camera[name] for name in ("size_px", "K", "distortion", "world_to_camera")}


def lights_of(lights: Mapping[str, Any]) -> Mapping[str, Any]:
    """What a lights item says of places, powers and weights.

    A rig driven from measured positions has its weights from where the lights are, not from the layout.
    """
    fields = ("id", "position_mm", "direction", "power")
    measured = lights["drive"] == "measured"
    return {
        "lights": [
            {
                **{name: light[name] for name in fields},
                "drive_position": None if measured else light["drive_position"],
            }
            for light in lights["lights"]
        ]
    }


def lights_placed(lights: Mapping[str, Any]) -> bool:
    """Whether every light has a position, and not a direction alone."""
    return all(light["position_mm"] is not None for light in lights["lights"])

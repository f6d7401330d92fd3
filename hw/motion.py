"""How the head moves: it turns and shifts as a whole, and it talks.

A point at q in the head's own frame is at p = R(t) q + T(t) in the world, with R = Rz Ry Rx. Talking bends the head
inside its frame: `head.py` says how a warp does that; here is where its rows sit and how far each carries the skin.
Every channel is a sum of two sines of time with rates that share no period, so that a long performance stays within
bounds and never repeats, and is 0 at time 0, where the head is at rest.

Fast is the same course twice as far and 2.4 times as quick; talking gets quicker only, because skin cannot be
bent any further. `tests/hw/test_motion.py` holds what it comes to in pixels a picture.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightstage.hw.errors import RigError

Array = NDArray[np.float64]
_CHANNELS: dict[str, tuple[tuple[float, float, float], ...]] = {
    # amplitude (degrees or mm), Hz, phase (rad)
    # x and y go round a quarter of a period apart, so that the head never stands still
    "turn_x": ((1.9, 0.83, 0.2), (0.3, 1.87, 2.0)),
    "turn_y": ((2.1, 0.83, 1.77), (0.3, 1.61, 0.7)),
    "turn_z": ((1.2, 0.61, 1.9), (0.2, 1.43, 0.1)),
    "shift_x": ((3.2, 0.97, 2.9), (0.4, 1.93, 1.0)),
    "shift_y": ((3.0, 0.97, 1.33), (0.4, 1.71, -0.6)),
    "shift_z": ((3.2, 0.57, 1.1), (0.6, 1.27, 2.4)),
    # talking starts from the closed, resting face: no phase
    "jaw": ((2.6, 1.9, 0.0), (0.8, 3.1, 0.0)),
    "smile": ((2.0, 1.3, 0.0), (0.6, 2.3, 0.0)),
    "brow": ((1.8, 1.1, 0.0), (0.5, 2.1, 0.0)),
    "cheek": ((1.0, 1.5, 0.0), (0.3, 2.7, 0.0)),
}
_TALK = ("jaw", "smile", "brow", "cheek")
# channel, centre (mm), reach (mm), where the skin goes per mm of the channel
_MUSCLES: tuple[tuple[str, tuple[float, ...], tuple[float, ...], tuple[float, ...]], ...] = (
    ("jaw", (0, -80, 46), (64, 48, 62), (0, -1, -0.35)),
    ("jaw", (0, -60, 80), (36, 24, 30), (0, -0.4, 0)),
    ("smile", (-27, -50, 66), (32, 30, 36), (-0.8, 0.6, -0.2)),
    ("smile", (27, -50, 66), (32, 30, 36), (0.8, 0.6, -0.2)),
    ("brow", (0, 40, 62), (64, 32, 48), (0, 1, 0)),
    ("cheek", (-38, -20, 58), (32, 30, 34), (-0.6, 0, 0.8)),
    ("cheek", (38, -20, 58), (32, 30, 34), (0.6, 0, 0.8)),
)
_EXTENT: dict[str, tuple[float, float]] = {"still": (0.0, 1.0), "slow": (1.0, 1.0), "fast": (2.0, 2.4)}
"""How far the head turns and shifts, and how quickly everything goes, beside the table."""
MOTIONS = tuple(_EXTENT)


@dataclass(frozen=True)
class Pose:
    """Where the head is at one moment, and how it is bent."""

    rotation: Array
    """(3, 3), head's frame -> world."""
    shift_mm: Array
    """(xyz,)."""
    warp: Array | None
    """As `head.Warp`; None is the face at rest."""
    channels: dict[str, float]
    """Degrees and mm, by name."""

    def enter(self, points: Array) -> Array:
        """World points (..., xyz) in the head's frame, mm."""
        return np.asarray((points - self.shift_mm) @ self.rotation)

    def leave(self, points: Array) -> Array:
        """Points (..., xyz) of the head's frame in the world, mm."""
        return np.asarray(points @ self.rotation.T + self.shift_mm)


REST = Pose(np.eye(3), np.zeros(3), None, dict.fromkeys(_CHANNELS, 0.0))


def pose(motion: str, time_s: float) -> Pose:
    """The head at a moment of a motion.

    Args:
        motion: still, slow or fast.

    Raises:
        RigError: the motion is not known.
    """
    if motion not in _EXTENT:
        raise RigError(f"the motion '{motion}' is not known; expected {', '.join(MOTIONS)}")
    size, rate = _EXTENT[motion]
    if size == 0 or time_s == 0:
        return REST
    value = {}
    for name, sines in _CHANNELS.items():
        course = sum(a * (np.sin(2 * np.pi * f * rate * time_s + b) - np.sin(b)) for a, f, b in sines)
        value[name] = float(course) * (1.0 if name in _TALK else size)
    rows = [(*centre, *reach, *(value[name] * np.array(way))) for name, centre, reach, way in _MUSCLES]
    turn = _rotation(*(np.radians(value[f"turn_{axis}"]) for axis in "xyz"))
    return Pose(turn, np.array([value[f"shift_{axis}"] for axis in "xyz"]), np.array(rows, np.float64), value)


def _rotation(x: float, y: float, z: float) -> Array:
    """Rz Ry Rx, radians."""
    sx, cx, sy, cy, sz, cz = np.sin(x), np.cos(x), np.sin(y), np.cos(y), np.sin(z), np.cos(z)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)

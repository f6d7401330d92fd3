"""A rig of near lights, and what its gradients tell."""

from typing import Any

import numpy as np

from lightstage.kernels.normals.near_light import Lights, LightVectors, measure


def lights_of(positions: Any, drive: Any) -> Lights:
    return Lights(np.asarray(positions, float), np.asarray(drive, float), np.ones(len(positions)))


def read(pictures: dict[str, Any]) -> LightVectors:
    return measure([{name: picture.astype(np.float32) for name, picture in pictures.items()}])

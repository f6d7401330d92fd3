"""Where the eyes are in a picture: carried there from the virtual rig's mean head.

The mean head is laid over the normals as a whole, and the flow from it to the face carries its eyes to theirs. Eyes
are where eyeballs bulge; whether lids are open does not matter.
"""

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
import yaml
from numpy.typing import NDArray

from lightstage.hw.head import coarse_field, parts, surface
from lightstage.kernels.faces.face_flow import face_flow, landed
from lightstage.kernels.faces.face_frame import bring, filled, find_face
from lightstage.kernels.motion.flow_warp import unit

EYES = ("left_eye", "right_eye")
_MM = 1.5
"""Of a pixel of the template."""
_X, _Y = 66.0, (-95.0, 70.0)
"""What the template shows of the mean head, mm about the stage's centre: brow to chin, without ears."""
_MEAN_EYES = ((-28.0, 14.0), (28.0, 14.0))
"""Of the mean head (`hw.head`), mm."""
_CAMERA_MM = 890.0
"""From the stage's centre, as the virtual rig's."""
_FACE_MM = 70.0
"""The face lies about so far before the centre; the template's pixels are millimetres in that plane."""

Points = dict[str, NDArray[np.float64]]
"""By name, (x, y) in pixels."""


def points_of_numbers(given: Mapping[str, Sequence[float]]) -> Points:
    """Points from plain numbers."""
    return {str(name): np.array(at, float) for name, at in given.items()}


def find_points(normal: NDArray[np.float32]) -> tuple[Points, float]:
    """Eyes by normals (xyz, y, x), and how well the mean head fits, up to 1.

    Raises:
        KernelError: there is no face.
    """
    template, eyes = mean_face()
    matrix, fit = find_face(normal, template)
    oval = np.isfinite(template[0]).astype(np.float32)
    face, _ = bring(normal, matrix, oval.shape)
    flow = face_flow(filled(template), filled(unit(face)), oval, float(np.linalg.norm(eyes[1] - eyes[0])))
    at = landed(eyes, flow) @ matrix[:, :2].T + matrix[:, 2]
    return dict(zip(EYES, at, strict=True)), fit


def as_yaml(points: Mapping[str, Points]) -> str:
    """The text that `read_points` reads."""
    plain = {
        session: {name: [round(float(v), 2) for v in at] for name, at in named.items()}
        for session, named in points.items()
    }
    note = "# pixels of each session's pictures; change them, and give the file with --points\n"
    return note + yaml.safe_dump(plain, sort_keys=False, default_flow_style=None)


@cache
def mean_face() -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """The template: normals (xyz, y, x) of the mean head from the front, and its eyes (eye, xy), pixels."""
    shape = parts(0)
    x = np.arange(-_X, _X + _MM / 2, _MM)
    y = np.arange(_Y[1], _Y[0] - _MM / 2, -_MM)
    camera = np.array([0.0, 0.0, _CAMERA_MM])
    plane = np.stack(np.broadcast_arrays(x[None, :], y[:, None], _FACE_MM), axis=-1)
    rays = (plane - camera).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    distance, normal = surface(shape, coarse_field(shape), None, rays, camera)
    normal[distance < 0] = np.nan
    eyes = np.array([[(ex + _X) / _MM, (_Y[1] - ey) / _MM] for ex, ey in _MEAN_EYES])
    return normal.reshape(len(y), len(x), 3).transpose(2, 0, 1).astype(np.float32), eyes

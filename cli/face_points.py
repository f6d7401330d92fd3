"""Where the eyes of a session are: given by hand, or carried there from the virtual rig's mean head.

The mean head is laid over the normals as a whole, and the flow from it to the face carries its eyes to theirs. Eyes
are where eyeballs bulge; whether lids are open does not matter.
"""

import math
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.store.errors import RequestError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

EYES = ("left_eye", "right_eye")
_MM = 1.5
"""Of a pixel of the template."""
_X, _Y = 66.0, (-95.0, 70.0)
"""What the template shows of the mean head, mm about the stage's centre: brow to chin, without ears."""
_MEAN_EYES = ((-28.0, 14.0), (28.0, 14.0))
"""Of the mean head (`hw.head`), mm."""

Points = dict[str, "NDArray[np.float64]"]


def read_points(path: Path, sessions: Sequence[str]) -> dict[str, Points]:
    """Points by session and name from a YAML file: `session: {left_eye: [x, y], right_eye: [x, y], ...}`, pixels.

    Raises:
        RequestError: no such file, a session without eyes, or a point that is no pair of numbers.
    """
    import numpy as np

    from lightstage.store.document import load

    plain = load(path, what="a file of points").value
    if not isinstance(plain, Mapping):
        raise RequestError(
            f"{path}: expected sessions with their points, such as `s1: {{left_eye: [120, 90], ...}}`"
        )
    if not any(name in plain for name in sessions):
        listed = ", ".join(map(str, plain)) or "none"
        raise RequestError(f"{path}: has points of {listed}, and of none of the sessions ({', '.join(sessions)})")
    found: dict[str, Points] = {}
    by_name = {str(name): given for name, given in plain.items()}
    for name in sessions:
        if name not in by_name:
            continue
        given = by_name[name]
        if not isinstance(given, Mapping) or any(eye not in given for eye in EYES):
            raise RequestError(f"{path}: '{name}' needs left_eye and right_eye, each [x, y] in pixels")
        for key, value in given.items():
            if not isinstance(value, Sequence) or len(value) != 2 or not all(_is_number(v) for v in value):
                raise RequestError(f"{path}: '{name}', {key}: expected [x, y] in pixels, found {value!r}")
        points = {str(key): np.array(value, float) for key, value in given.items()}
        if points["left_eye"][0] >= points["right_eye"][0]:
            raise RequestError(
                f"{path}: '{name}': left_eye is the one at the left of the picture, so its x must be smaller"
            )
        found[name] = points
    return found


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def find_points(normal: "NDArray[np.float32]", session: str) -> tuple[Points, float]:
    """Eyes of a session by its normals (xyz, y, x), and how well the mean head fits, up to 1.

    Raises:
        RequestError: there is no face.
    """
    import numpy as np

    from lightstage.kernels.errors import KernelError
    from lightstage.kernels.faces.face_flow import face_flow, landed
    from lightstage.kernels.faces.face_frame import bring, filled, find_face
    from lightstage.kernels.motion.flow_warp import unit

    template, eyes = mean_face()
    try:
        matrix, fit = find_face(normal, template)
    except KernelError as error:
        raise RequestError(f"session '{session}': {error}; give the eyes by hand with --points FILE") from None
    oval = np.isfinite(template[0]).astype(np.float32)
    face, _ = bring(normal, matrix, oval.shape)
    flow = face_flow(filled(template), filled(unit(face)), oval, float(np.linalg.norm(eyes[1] - eyes[0])))
    at = landed(eyes, flow) @ matrix[:, :2].T + matrix[:, 2]
    return dict(zip(EYES, at, strict=True)), fit


def as_yaml(points: Mapping[str, Points]) -> str:
    """The text that `read_points` reads."""
    import yaml

    plain = {
        session: {name: [round(float(v), 2) for v in at] for name, at in named.items()}
        for session, named in points.items()
    }
    note = "# pixels of each session's pictures; change them, and give the file with --points\n"
    return note + yaml.safe_dump(plain, sort_keys=False, default_flow_style=None)


@cache
def mean_face() -> tuple[Any, Any]:
    """The template: normals (xyz, y, x) of the mean head from the front, and its eyes (eye, xy), pixels."""
    import numpy as np

    from lightstage.hw.head import coarse_field, parts, surface

    shape = parts(0)
    x = np.arange(-_X, _X + _MM / 2, _MM)
    y = np.arange(_Y[1], _Y[0] - _MM / 2, -_MM)
    camera = np.array([0.0, 0.0, 890.0])
    # the face lies some 70 mm before the centre, and that is the plane whose millimetres the pixels are
    plane = np.stack(np.broadcast_arrays(x[None, :], y[:, None], 70.0), axis=-1)
    rays = (plane - camera).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    distance, normal = surface(shape, coarse_field(shape), None, rays, camera)
    normal[distance < 0] = np.nan
    eyes = np.array([[(ex + _X) / _MM, (_Y[1] - ey) / _MM] for ex, ey in _MEAN_EYES])
    return normal.reshape(len(y), len(x), 3).transpose(2, 0, 1).astype(np.float32), eyes

"""Where the eyes of a session are: given by hand, or found by laying a mean head over the normals."""

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from store.errors import RequestError

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

    from store.document import load

    plain = load(path, what="a file of points").value
    if not isinstance(plain, Mapping):
        raise RequestError(
            f"{path}: expected sessions with their points, such as `s1: {{left_eye: [120, 90], ...}}`"
        )
    found: dict[str, Points] = {}
    for name in sessions:
        if name not in plain:
            continue
        given = plain[name]
        if not isinstance(given, Mapping) or any(eye not in given for eye in EYES):
            raise RequestError(f"{path}: '{name}' needs left_eye and right_eye, each [x, y] in pixels")
        for key, value in given.items():
            numbers = isinstance(value, list | tuple) and len(value) == 2
            if not numbers or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in value):
                raise RequestError(f"{path}: '{name}', {key}: expected [x, y] in pixels, found {value!r}")
        points = {str(key): np.array(value, float) for key, value in given.items()}
        if points["left_eye"][0] >= points["right_eye"][0]:
            raise RequestError(
                f"{path}: '{name}': left_eye is the one at the left of the picture, so its x must be smaller"
            )
        found[name] = points
    return found


def find_points(normal: "NDArray[np.float32]", session: str) -> tuple[Points, float]:
    """Eyes of a session by its normals (xyz, y, x), and how well the mean head fits, up to 1.

    Raises:
        RequestError: there is no face.
    """
    import numpy as np

    from dag.stage import StageError
    from stages.face_frame import find_face

    template, eyes = mean_face()
    try:
        matrix, fit = find_face(normal, template)
    except StageError as error:
        raise RequestError(f"session '{session}': {error}; give the eyes by hand with --points FILE") from None
    at = np.concatenate([eyes, np.ones((2, 1))], axis=1) @ matrix.T
    return dict(zip(EYES, at, strict=True)), fit


@cache
def mean_face() -> tuple[Any, Any]:
    """The template: normals (xyz, y, x) of the mean head from the front, and its eyes (eye, xy), pixels."""
    import numpy as np

    from hw.head import coarse_field, parts, surface

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

"""Pictures of a face that hold its shape, its texture, or both: the equations are in `stages/stimulus.py`.

Source: Dutta (2010), section on stimuli for a psychology experiment; Jones et al. (2010).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.appearance.colour import linear_srgb_matrix, xyz_matrix
from lightstage.kernels.appearance.distant_lights import parse_lights
from lightstage.kernels.appearance.shading import cast_shadows as shadows_of
from lightstage.kernels.appearance.shading import shade
from lightstage.kernels.surface.pinhole import Pinhole

Image = NDArray[np.float32]


def stimulus(
    normal: Mapping[int, Image],
    depth_mm: Mapping[int, Image],
    reflectance: Mapping[int, Image],
    shading: Mapping[int, Image],
    *,
    matrix: Sequence[Sequence[float]],
    camera: Pinhole | None,
    lights: str,
    cast_shadows: bool,
    texture: str,
) -> Mapping[str, Any]:
    """The three pictures of one tracking frame; each input holds it alone.

    Args:
        normal: (xyz, y, x), unit vectors in the world frame, NaN where not valid.
        depth_mm: (y, x), camera z, which only cast shadows read; empty where none was found.
        reflectance: (band, y, x), 0 to 1.
        shading: (y, x): what was divided out of the reflectance.
        matrix: (rgb, band), to linear sRGB, or (1, band), to luminance.
        camera: of the depth; None without cast shadows.
        lights, cast_shadows, texture: see StimulusParams.

    Returns:
        `image` (kind, rgb, y, x) float32, linear light: shape, texture and both; NaN where normal or reflectance
        is not valid. `stats`: the part of shape that is in shadow.
    """
    distant = parse_lights(lights)
    visibility = None
    if cast_shadows:
        assert camera is not None
        (depth,) = depth_mm.values()
        visibility = shadows_of(depth, camera, distant)
    (turned,), (skin,) = normal.values(), reflectance.values()
    shape = shade(turned, distant, visibility)
    if texture == "constant":
        (arrived,) = shading.values()
        skin = skin * arrived
    painted = np.einsum("cb,byx->cyx", np.asarray(matrix, np.float32), skin)
    valid = np.isfinite(shape) & np.isfinite(painted).all(axis=0)
    image = np.stack([np.broadcast_to(shape, painted.shape), painted, shape * painted])
    image = np.where(valid, image, np.float32(np.nan)).astype(np.float32)
    dark = float(np.mean(shape[valid] <= 0)) if valid.any() else 1.0
    return {"image": image, "stats": {"shape_in_shadow": dark}}


def prepare(
    *,
    bands_nm: Sequence[float],
    widths_nm: Sequence[float | None],
    illuminant: str,
    colour: str,
    shape: Sequence[int],
    camera: Mapping[str, Any] | None,
) -> Mapping[str, Any]:
    """The matrix from bands to colours, and the camera, for pictures of `shape` (rows, columns)."""
    if colour == "colour":
        matrix = linear_srgb_matrix(bands_nm, widths_nm, illuminant=illuminant)
    else:
        matrix = xyz_matrix(bands_nm, widths_nm, illuminant=illuminant)[1:2]
    lens = None if camera is None else Pinhole.of(camera, (int(shape[0]), int(shape[1])))
    return {"matrix": matrix.tolist(), "camera": lens}

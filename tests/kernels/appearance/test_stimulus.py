"""Stimulus pictures: the closed form, and what is not valid."""

from typing import Any

import numpy as np

from lightstage.kernels.appearance.stimulus import stimulus
from lightstage.stages.stimulus import KINDS


def normals_of(*vectors: tuple[float, float, float]) -> Any:
    """(xyz, 1, x) unit vectors."""
    rows = np.array(vectors, np.float32).T
    return (rows / np.linalg.norm(rows, axis=0))[:, None, :]


def pictures(normal: Any, reflectance: Any, **options: Any) -> Any:
    shading = np.full(normal.shape[1:], 0.5, np.float32)
    chosen: dict[str, Any] = {
        "matrix": [[1.0, 0.0], [0.0, 1.0], [0.5, 0.5]],
        "camera": None,
        "lights": "0,0,1",
        "cast_shadows": False,
        "texture": "reflectance",
    }
    return stimulus({0: normal}, {}, {0: reflectance}, {0: shading}, **{**chosen, **options})["image"]


def test_shape_texture_and_both_by_hand() -> None:
    # facing the light, 60 degrees away from it, and turned away from it
    normal = normals_of((0, 0, 1), (np.sqrt(3), 0, 1), (0, 0.6, -0.8))
    skin = np.array([[[0.8, 0.4, 0.6]], [[0.2, 0.4, 0.6]]], np.float32)
    image = pictures(normal, skin)
    shape, texture, both = (image[KINDS.index(kind)] for kind in KINDS)
    np.testing.assert_allclose(shape, np.broadcast_to([[[1, 0.5, 0]]], (3, 1, 3)), atol=1e-6)
    np.testing.assert_allclose(texture[:, 0], [[0.8, 0.4, 0.6], [0.2, 0.4, 0.6], [0.5, 0.4, 0.6]], rtol=1e-6)
    np.testing.assert_allclose(both, shape * texture, atol=1e-6)


def test_constant_texture_keeps_the_shading() -> None:
    skin = np.full((2, 1, 1), 0.8, np.float32)
    image = pictures(normals_of((0, 0, 1)), skin, texture="constant")
    np.testing.assert_allclose(image[KINDS.index("texture"), :, 0, 0], 0.4, rtol=1e-6)


def test_not_valid_stays_not_valid_and_inputs_are_not_written_to() -> None:
    normal = normals_of((0, 0, 1), (0, 0, 1))
    normal[:, 0, 0] = np.nan
    skin = np.full((2, 1, 2), 0.5, np.float32)
    skin[1, 0, 1] = np.nan
    for array in (normal, skin):
        array.flags.writeable = False
    assert np.isnan(pictures(normal, skin)).all()

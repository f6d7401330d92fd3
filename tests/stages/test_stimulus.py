"""Stimulus pictures: the closed form, shadows, colours, and what is refused."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.kernels.appearance.shading import DistantLight, cast_shadows, parse_lights, shade
from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.stages.stimulus import KINDS, StimulusParams, stimulus
from tests.conftest import Answer


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
    return stimulus([normal], [], [reflectance], [shading], **{**chosen, **options})["image"]


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


def test_azimuth_goes_right_and_elevation_up() -> None:
    np.testing.assert_allclose(DistantLight(90, 0, 1).direction, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(DistantLight(0, 90, 1).direction, [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(DistantLight(0, 0, 1).direction, [0, 0, 1], atol=1e-12)


@given(st.floats(-80, 80), st.floats(-80, 80), st.floats(0.1, 3))
def test_lights_add_up(azimuth: float, elevation: float, strength: float) -> None:
    normal = normals_of((0, 0, 1), (1, 0, 1), (0, -1, 1))
    one, other = DistantLight(azimuth, elevation, strength), DistantLight(20, -10, 1.0)
    np.testing.assert_allclose(
        shade(normal, (one, other)), shade(normal, (one,)) + shade(normal, (other,)), rtol=1e-5, atol=1e-6
    )


def test_a_wall_casts_its_shadow_to_the_far_side_only() -> None:
    """A plane at 900 mm with a wall 20 mm high in its middle, the light 45 degrees from the left: the shadow is as
    long as the wall is high, 20 pixels of 1 mm. The march's first step and slack cost about 3 of them."""
    camera = Pinhole(
        (40, 120), (900.0, 900.0, 59.5, 19.5), (0, 0, 0, 0, 0), np.diag([1.0, -1, -1]), np.array([0, 0, 900.0])
    )
    depth = np.full((40, 120), 900.0, np.float32)
    depth[:, 50:54] = 880
    seen = cast_shadows(depth, camera, (DistantLight(-45, 0, 1),))[0, 10]
    assert seen[:48].min() == 1
    assert seen[56:69].max() < 0.5
    assert seen[80:].min() == 1


def test_not_valid_stays_not_valid_and_inputs_are_not_written_to() -> None:
    normal = normals_of((0, 0, 1), (0, 0, 1))
    normal[:, 0, 0] = np.nan
    skin = np.full((2, 1, 2), 0.5, np.float32)
    skin[1, 0, 1] = np.nan
    for array in (normal, skin):
        array.flags.writeable = False
    assert np.isnan(pictures(normal, skin)).all()


@pytest.mark.parametrize("text", ["", "0,0", "0,0,0", "0,95,1", "a,b,c", "0,0,nan", "0,0,1 1,2"])
def test_a_wrong_light_is_named(text: str) -> None:
    with pytest.raises(ValueError, match="expected azimuth,elevation,strength"):
        parse_lights(text)
    with pytest.raises(ValueError, match="expected azimuth,elevation,strength"):
        StimulusParams(lights=text)


def test_the_stage_runs_on_the_virtual_rig(lightstage: Callable[..., Answer]) -> None:
    import xarray

    assert lightstage("demo", "--session", "head", "--size", "102x78", "--bands", "434,576,655").code == 0
    done = lightstage("run", "stimulus", "--session", "head", "--set", "stimulus.cast_shadows=true", "--json")
    assert done.code == 0, done.err
    opened = xarray.open_zarr(done.json["nodes"]["stimulus"]["path"], chunks=None)
    assert list(opened.kind.values) == list(KINDS)
    shape, texture, both = opened.image.values[0]
    np.testing.assert_allclose(both, shape * texture, atol=1e-6)
    assert np.isfinite(shape).sum() > 1000
    refused = lightstage("run", "stimulus", "--session", "head", "--set", "relief.fuse=none")
    assert refused.code != 0
    assert "fuse: bands" in refused.err

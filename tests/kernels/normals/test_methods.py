"""Normals of one tracking frame by any method: views, lights, fused bands."""

import numpy as np
import pytest

from lightstage.kernels.errors import KernelError
from lightstage.kernels.normals.gradient_methods import table
from lightstage.kernels.normals.methods import light_directions, normals, view_vectors
from lightstage.kernels.pictures.picture_sets import Choice
from tests.scenes import angle_deg, decoded, ideal_gradient, sphere_normals

CAMERA = {
    "size_px": [48, 48],
    "K": [[60.0, 0, 23.5], [0, 60.0, 23.5], [0, 0, 1]],
    "distortion": [0.0] * 5,
    "world_to_camera": {"R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]]},
}


def test_the_view_vector_points_to_the_camera() -> None:
    """World x right, y up: the left, upper pixel sees a point to the left and above, so v points right and down."""
    view = view_vectors(CAMERA, (48, 48))
    assert view[0, 0, 0] > 0 > view[1, 0, 0]
    assert view[2].min() > 0
    centre = view[:, 23:25, 23:25].mean(axis=(1, 2))
    np.testing.assert_allclose(centre, [0, 0, 1], atol=1e-3)
    with pytest.raises(KernelError, match="is for 48 x 48; the pictures are 30 x 20"):
        view_vectors(CAMERA, (20, 30))


def test_lights_by_position_fall_off_and_by_direction_do_not() -> None:
    item = {
        "lights": [
            {"id": "L00", "position_mm": [0, 0, 100.0], "direction": None, "power": 2.0},
            {"id": "L01", "position_mm": [200.0, 0, 0], "direction": None, "power": 1.0},
            {"id": "L02", "position_mm": [0, 150.0, 0], "direction": None, "power": 1.0},
        ]
    }
    found = light_directions(item, ["L0", "L01", "L02"])
    np.testing.assert_allclose(found, [[0, 0, 2 * 2.25], [0.5625, 0, 0], [0, 1, 0]])
    with pytest.raises(KernelError, match="has no L07"):
        light_directions(item, ["L00", "L01", "L07"])
    with pytest.raises(KernelError, match="lie in one plane"):
        light_directions(item, ["L00", "L01"])


def test_the_kernel_fuses_and_reads_the_diffuse_constant() -> None:
    truth, mask = sphere_normals()
    choice = Choice("ratio", "", ("X", "Y", "Z", "C"))
    names = table("ratio", "", choice.pictures).pictures
    one = [ideal_gradient(truth, name).astype(np.float32) for name in names]
    constant = np.full(truth.shape[1:], 7.0, np.float32)
    radiance = {(nm, name): picture for nm in (445.0, 576.0) for name, picture in zip(names, one, strict=True)}
    out = normals(radiance, {445.0: constant, 576.0: constant}, choice=choice, lights=None, view=None)
    assert angle_deg(decoded(out["normal"]), truth)[mask].max() < 0.004  # int16 steps leave 0.002 degrees
    np.testing.assert_allclose(out["albedo"], 7, rtol=1e-6)

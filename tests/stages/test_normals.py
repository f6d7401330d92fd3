"""Normals: closed forms, truth that no kernel had a part in, invariances, and refusals."""

from typing import Any

import numpy as np
import pytest

from lightstage.dag.stage import Grid, StageError
from lightstage.kernels.errors import KernelError
from lightstage.kernels.normals.gradient_methods import table
from lightstage.stages.normals import STAGE, Choice, NormalsParams, choose, light_directions, normals, view_vectors
from tests.scenes import STATIC, angle_deg, decoded, ideal_gradient, sphere_normals

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
    with pytest.raises(StageError, match="is for 48 x 48; the pictures are 30 x 20"):
        view_vectors(CAMERA, (20, 30))


@pytest.mark.parametrize(
    ("have", "expected"),
    [
        ("C X Y Z Xc Yc Zc", ("difference", "")),
        ("X Y Z Xc Yc Zc", ("difference", "")),
        ("C X Y Z", ("ratio", "")),
        ("C X Y Z Yc", ("minimal", "Y")),
        ("X Z C Y Xc", ("minimal", "X")),
        ("L00 L01 L02 L03", ("least_squares", "")),
    ],
)
def test_auto_takes_the_best_that_the_frames_support(have: str, expected: tuple[str, str]) -> None:
    choice = choose(have.split())
    assert (choice.method, choice.base) == expected


@pytest.mark.parametrize(
    ("have", "ask", "parts"),
    [
        ("C X Y", {}, ["any method needs", "the session has C, X, Y", "no method works"]),
        ("C X Y Z", {"method": "difference"}, ["difference needs X Y Z Xc Yc Zc", "method: ratio would work"]),
        ("C X Y Z Xc", {"method": "minimal", "base": "Z"}, ["minimal with base Z needs Z and Zc", "ratio"]),
        ("C X Y Z", {"correct": "qp"}, ["Xc, Yc, Zc missing", "correct: none works with ratio"]),
        ("L00 L01 L02", {"correct": "qp"}, ["gradient methods"]),
        ("L00 L01", {}, ["at least three one-light pictures"]),
    ],
)
def test_a_missing_illumination_says_what_is_needed_what_there_is_and_what_would_work(
    have: str, ask: dict[str, str], parts: list[str]
) -> None:
    with pytest.raises(KernelError) as caught:
        choose(have.split(), **ask)
    assert all(part in str(caught.value) for part in parts), str(caught.value)


def test_the_qp_correction_is_for_diffuse_light() -> None:
    """Its 1/3 and 2/3 are the diffuse lobe's; a specular lobe has up to 1/2 and 1, by its roughness."""
    sizes = {"illumination": len(STATIC), "band": 1, "component": 2, "y": 4, "x": 4}
    labels: dict[str, Any] = {
        "illumination": (("illumination",), list(STATIC)),
        "frame": (("illumination",), list(range(len(STATIC)))),
        "band": (("band",), [0.0]),
        "component": (("component",), ["diffuse", "specular"]),
    }
    stacked = Grid(sizes, labels, arrays=frozenset({"radiance"}))
    facts = {"frame_rate_hz": None, "illumination": list(STATIC), "time_s": [None] * len(STATIC), "items": []}
    with pytest.raises(StageError, match="constants of the diffuse lobe"):
        STAGE.arrange([stacked], facts, NormalsParams(correct="qp", component="specular"))
    assert STAGE.arrange([stacked], facts, NormalsParams(correct="qp")).groups


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
    with pytest.raises(StageError, match="has no L07"):
        light_directions(item, ["L00", "L01", "L07"])
    with pytest.raises(StageError, match="lie in one plane"):
        light_directions(item, ["L00", "L01"])


def test_the_kernel_fuses_and_reads_the_diffuse_constant() -> None:
    truth, mask = sphere_normals()
    choice = Choice("ratio", "", ("X", "Y", "Z", "C"))
    names = table("ratio", "", choice.pictures).pictures
    one = [ideal_gradient(truth, name).astype(np.float32) for name in names]
    constant = np.full(truth.shape[1:], 7.0, np.float32)
    out = normals(
        [*one, *one, constant, constant], choice=choice, names=names, diffuse_constant=True, lights=None, view=None
    )
    assert angle_deg(decoded(out["normal"]), truth)[mask].max() < 0.004  # int16 steps leave 0.002 degrees
    np.testing.assert_allclose(out["albedo"], 7, rtol=1e-6)

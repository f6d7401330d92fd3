"""The camera that boards were projected with."""

import numpy as np
import pytest

from lightstage.kernels.targets.camera import camera, item, verdict
from lightstage.kernels.targets.labels import CAMERA_PARAMETERS
from tests.kernels.targets.boards import POSES, SIZE, SQUARE_MM, K, seen

BOARDS = {i: seen(*pose) for i, pose in enumerate(POSES)}


@pytest.fixture(scope="module")
def arrays() -> dict:
    noise = np.random.default_rng(3)
    boards = {i: board + noise.normal(0, 0.02, board.shape) for i, board in BOARDS.items()}
    return dict(camera(boards, square_mm=SQUARE_MM, size=SIZE, homography=np.eye(3).tolist()))


def test_the_matrix_is_that_of_the_projection(arrays: dict) -> None:
    deviation = dict(zip(CAMERA_PARAMETERS, arrays["deviation"], strict=True))
    # four of its own standard deviations
    assert abs(arrays["matrix"][0, 0] - K[0, 0]) < 4 * deviation["fx"] < 40
    assert abs(arrays["matrix"][0, 2] - K[0, 2]) < 4 * deviation["cx"]
    assert arrays["rms_px"] == pytest.approx(0.02 * np.sqrt(2), rel=0.2)
    np.testing.assert_allclose(arrays["other_matrix"], arrays["matrix"], rtol=1e-6)  # the same picture


def test_the_pose_is_the_bound_one_or_the_nominal(arrays: dict) -> None:
    attrs = {"size_px": [406, 309], "parameters": {"distance_mm": 890.0}}
    nominal = item(arrays=arrays, attrs=attrs, items={})
    assert nominal["size_px"] == [406, 309]
    assert nominal["world_to_camera"] == {"R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "t_mm": [0, 0, 890]}
    pose = {"R": np.eye(3).tolist(), "t_mm": [1.0, 2.0, 3.0]}
    bound = item(arrays=arrays, attrs=attrs, items={"camera": {"world_to_camera": pose}})
    assert bound["world_to_camera"] == pose
    said = [sentence for _, sentence in verdict(arrays=arrays, labels={"parameter": CAMERA_PARAMETERS}, items={})]
    assert any("the pose is the nominal one" in sentence for sentence in said)

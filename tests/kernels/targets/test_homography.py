"""The homography that corners were moved by."""

import numpy as np
import pytest

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.homography import homography, item, verdict
from tests.kernels.targets.boards import COLUMNS, POSES, ROWS, SIZE, seen

TRUE = np.array([[1.01, 0.004, 3.0], [-0.003, 0.99, -2.0], [1e-5, -2e-5, 1.0]])
"""From the cross camera to the parallel one."""
FACTS = {"cameras": {"parallel": "CAM0", "cross": "CAM1"}}


def moved(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    image = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1) @ matrix.T
    return np.asarray(image[..., :2] / image[..., 2:])


def measured(parallel: dict, cross: dict, *, parallel_is_black: bool = True) -> dict:
    points = {("parallel", i): board for i, board in parallel.items()} | {
        ("cross", i): board for i, board in cross.items()
    }
    covariance = np.tile([1e-4, 0.0, 0.0, 1e-4], (ROWS, COLUMNS, 1))
    return dict(
        homography(
            points,
            dict.fromkeys(points, covariance),
            {name: np.array(parallel_is_black or name[0] == "cross") for name in points},
            size=SIZE,
            mount={"rotate": 0, "mirror": False},
            camera="CAM0",
        )
    )


def noisy(boards: dict, seed: int) -> dict:
    noise = np.random.default_rng(seed)
    return {i: board + noise.normal(0, 0.01, board.shape) for i, board in boards.items()}


CROSS = {i: seen(*pose) for i, pose in enumerate(POSES)}
PARALLEL = {i: moved(board, TRUE) for i, board in CROSS.items()}


def test_points_of_the_first_camera_go_where_the_second_has_them() -> None:
    arrays = measured(noisy(PARALLEL, 1), noisy(CROSS, 2))
    for i, board in PARALLEL.items():
        off = np.linalg.norm(moved(board, arrays["matrix"]) - CROSS[i], axis=-1)
        assert off.max() < 0.01  # 160 corners of 0.01 px each, at the edge of what they cover
    assert not arrays["flags"].any()
    content = item(arrays=arrays, facts=FACTS)
    assert (content["from"], content["to"]) == ("CAM0", "CAM1")
    assert verdict(arrays=arrays)[0][0] == "good"


def test_a_forgotten_turn_is_named() -> None:
    upside_down = {i: np.array(SIZE[::-1]) - 1 - board[::-1, ::-1] for i, board in PARALLEL.items()}
    with pytest.raises(KernelError, match="rotate: 180"):
        # of a board of odd by even corners the other end begins with the other colour
        measured(upside_down, CROSS, parallel_is_black=False)


def test_boards_that_disagree_are_parallax() -> None:
    apart = {i: board + np.array([0.5 * i, 0.0]) for i, board in PARALLEL.items()}
    arrays = measured(noisy(apart, 1), noisy(CROSS, 2))
    severity, sentence = verdict(arrays=arrays)[0]
    assert severity == "doubtful"
    assert "parallax" in sentence

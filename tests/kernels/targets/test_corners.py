"""Corners of a board that is drawn by hand."""

import cv2
import numpy as np

from lightstage.kernels.targets.corners import corners

SQUARE, COLUMNS, ROWS = 24, 5, 4
"""Pixels a side; inner corners."""


def board() -> np.ndarray:
    """(y, x) counts: a board in the middle of white paper, slightly blurred as a lens does."""
    y, x = np.indices((ROWS + 1, COLUMNS + 1))
    squares = np.kron((x + y) % 2, np.ones((SQUARE, SQUARE)))
    paper = np.pad(squares, 40, constant_values=1.0)
    return np.round(60 + 700 * cv2.GaussianBlur(paper, (0, 0), 0.8)).astype(np.uint16)


def measured(picture: np.ndarray, **mount: object) -> dict:
    about = {"inner_corners": [COLUMNS, ROWS], "white_level": 1023, "camera": "CAM0", "rotate": 0, "mirror": False}
    return dict(corners({0.0: picture}, **{**about, **mount}))


def test_corners_lie_between_the_squares() -> None:
    points = measured(board())["points"]
    y, x = np.mgrid[0:ROWS, 0:COLUMNS]
    # pixel (0, 0) is the centre of the first, so an edge between two pixels lies at a half
    wanted = np.stack([40 + (x + 1) * SQUARE - 0.5, 40 + (y + 1) * SQUARE - 0.5], axis=-1)
    np.testing.assert_allclose(points, wanted, atol=0.05)


def test_the_mount_is_undone() -> None:
    plain, turned = measured(board()), measured(np.rot90(board(), 2), rotate=180)
    np.testing.assert_allclose(turned["points"], plain["points"], atol=1e-6)
    assert turned["first_is_black"] == plain["first_is_black"]
    assert plain["covariance"].shape == (ROWS, COLUMNS, 4)


def test_the_mean_of_the_bands_is_measured() -> None:
    one = board()
    both = corners(
        {434.0: one, 576.0: (one // 2).astype(np.uint16)},
        inner_corners=[COLUMNS, ROWS], white_level=1023, camera="CAM0", rotate=0, mirror=False,
    )  # fmt: skip
    np.testing.assert_allclose(both["points"], measured(one)["points"], atol=0.01)

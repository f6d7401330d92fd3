"""The outline of a ball whose place is known."""

import numpy as np
import pytest

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.outline import Lens, outline, prepare, ring_radius_px
from tests.kernels.targets.spots import circle

ORTHOGRAPHIC = Lens()


def test_points_picked_by_hand_give_their_circle() -> None:
    points = circle(60.0, 50.0, 31.0)[::60]
    ball = outline({(0, 0.0): np.zeros((120, 140), np.uint16)}, lens=ORTHOGRAPHIC, mask=None, by_hand=points)
    np.testing.assert_allclose(ball["centre_px"], [60, 50], atol=1e-6)
    assert ball["radius_px"] == pytest.approx(31, abs=1e-6)
    assert ring_radius_px(ball["ring"]) == pytest.approx(31, abs=1e-3)  # its points are half a degree apart


def test_all_pictures_count_and_the_ball_is_found_in_their_mean() -> None:
    y, x = np.mgrid[0:120, 0:140]
    # a disc with soft edges, a little brighter than what is behind it: half of its light at the outline
    disc = 1 / (1 + np.exp(2 * (np.hypot(x - 64.3, y - 57.6) - 33.5)))
    counts = {(i, 0.0): np.round(400 + share * disc).astype(np.uint16) for i, share in enumerate((30, 60))}
    for picture in counts.values():
        picture.flags.writeable = False
    ball = outline(counts, lens=ORTHOGRAPHIC, mask=None, by_hand=None)
    # a tenth of a pixel: the soft edge is rounded to counts
    np.testing.assert_allclose(ball["centre_px"], [64.3, 57.6], atol=0.1)
    assert ball["radius_px"] == pytest.approx(33.5, abs=0.15)


def test_points_beyond_the_frame_are_refused() -> None:
    with pytest.raises(KernelError, match="cut by the frame"):
        outline(
            {(0, 0.0): np.zeros((60, 60), np.uint16)},
            lens=ORTHOGRAPHIC,
            mask=None,
            by_hand=circle(50.0, 30.0, 20.0)[::60],
        )


def test_a_context_becomes_numbers() -> None:
    camera = {"K": [[900, 0, 70], [0, 900, 60], [0, 0, 1]], "distortion": [0.1, 0, 0, 0, 0]}
    numbers = prepare(camera=camera, mask=None, by_hand=[[1.0, 2.0]])
    assert numbers["lens"].intrinsics.dtype == np.float64
    np.testing.assert_array_equal(numbers["lens"].distortion, [0.1, 0, 0, 0, 0])
    np.testing.assert_array_equal(numbers["by_hand"], [[1.0, 2.0]])
    assert prepare(camera=None, mask=None, by_hand=None) == {
        "lens": ORTHOGRAPHIC,
        "mask": None,
        "by_hand": None,
    }

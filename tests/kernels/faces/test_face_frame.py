"""Faces in one frame: similarity, resampling, the template's place."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.kernels.errors import KernelError
from lightstage.kernels.faces.face_frame import Frame, bring, find_face, similarity, turned

FRAME = Frame(40)


def test_the_eyes_come_to_the_frames_eyes() -> None:
    eyes = np.array([[30.0, 50], [61, 57]])
    matrix = similarity(eyes, FRAME)
    np.testing.assert_allclose(FRAME.eyes @ matrix[:, :2].T + matrix[:, 2], eyes, atol=1e-9)
    # a similarity: the columns are as long as each other and at right angles
    assert matrix[0, 0] == pytest.approx(matrix[1, 1])
    assert matrix[0, 1] == pytest.approx(-matrix[1, 0])


@settings(deadline=None, max_examples=30)
@given(st.floats(16, 200))
def test_the_frame_follows_the_eyes(eyes_px: float) -> None:
    frame = Frame(eyes_px)
    left, right = frame.eyes
    assert np.hypot(*(right - left)) == pytest.approx(eyes_px)
    oval = frame.oval()
    assert oval.max() == 1
    assert oval[0].max() == oval[:, 0].max() == 0, "the oval does not touch the border"
    np.testing.assert_allclose(oval, oval[:, ::-1], atol=1e-6)


def test_a_linear_picture_is_resampled_exactly_and_gaps_are_filled() -> None:
    y, x = np.mgrid[:120, :110].astype(np.float32)
    picture = np.stack([x + 2 * y, x - y])
    matrix = similarity(np.array([[40.0, 45], [75, 50]]), FRAME)
    out, there = bring(picture, matrix, FRAME.shape)
    v, u = np.mgrid[: FRAME.shape[0], : FRAME.shape[1]]
    at = np.stack([u, v], -1) @ matrix[:, :2].T + matrix[:, 2]
    inside = ((at > 3) & (at < (106, 116))).all(-1)
    # OpenCV places samples to 1/32 pixel along either axis, and the slopes add up to 3
    np.testing.assert_allclose(out[0][inside], (at[..., 0] + 2 * at[..., 1])[inside], atol=0.15)
    assert there[inside].all()
    picture[:, 50:60, 50:60] = np.nan
    out, there = bring(picture, matrix, FRAME.shape)
    assert np.isfinite(out).all()
    assert 0 < np.count_nonzero(~there & inside) < 200
    with pytest.raises(KernelError, match="no valid pixel"):
        bring(np.full((1, 8, 8), np.nan, np.float32), matrix, FRAME.shape)


def test_normals_turn_with_the_face() -> None:
    """A head that leans 90 degrees clockwise in the picture has its up at the picture's right."""
    matrix = similarity(np.array([[50.0, 30], [50, 70]]), FRAME)
    right = np.zeros((3, 1, 1), np.float32)
    right[0] = 1
    np.testing.assert_allclose(turned(right, matrix)[:, 0, 0], [0, 1, 0], atol=1e-6)


@pytest.mark.parametrize(("scale", "x", "y"), [(0.9, 150.0, 140.0), (1.3, 180.0, 130.0)])
def test_a_head_is_found_where_it_was_put(scale: float, x: float, y: float) -> None:
    """The mean head itself, resampled: within 2 % of the eye distance, 0.75 pixels."""
    from lightstage.products.face_points import mean_face

    template, eyes = mean_face()
    picture = np.full((3, 309, 406), np.nan, np.float32)
    v, u = np.mgrid[:309, :406]
    at = ((u - x) / scale + 44).astype(np.float32), ((v - y) / scale + 55).astype(np.float32)
    for c in range(3):
        picture[c] = cv2.remap(np.nan_to_num(template[c]), *at, cv2.INTER_LINEAR, borderValue=np.nan)
    matrix, fit = find_face(picture, template)
    found = eyes @ matrix[:, :2].T + matrix[:, 2]
    np.testing.assert_allclose(found, (eyes - (44, 55)) * scale + (x, y), atol=0.75)
    assert fit > 0.95


def test_a_sphere_is_no_face() -> None:
    from lightstage.products.face_points import mean_face

    y, x = (np.mgrid[:200, :200] - 100) / 80.0
    inside = x**2 + y**2 < 1
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    normal = np.where(inside, np.stack([x, -y, z]), np.nan).astype(np.float32)
    with pytest.raises(KernelError, match="no face"):
        find_face(normal, mean_face()[0])

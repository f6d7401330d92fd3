"""Noise, lenses and parallax, each put in by hand and each told."""

import numpy as np
import pytest
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.homography_fit import fit_homography
from lightstage.kernels.targets.residual_field import FieldCheck, check_field

Array = NDArray[np.float64]
NOISE_PX = 0.03


def boards() -> tuple[Array, NDArray[np.int_]]:
    """Corners of two boards, one to the left, one to the right and tilted."""
    x, y = np.meshgrid(np.arange(9), np.arange(6))
    one = np.stack([40 + 18 * x, 40 + 18 * y], axis=-1).reshape(-1, 2).astype(float)
    other = np.stack([220 + 16 * x - 0.5 * y, 80 + 17 * y + 0.8 * x], axis=-1).reshape(-1, 2).astype(float)
    return np.concatenate([one, other]), np.repeat([0, 1], 54)


def check(move: Array, seed: int, alone: bool = False) -> FieldCheck:
    first, board = boards()
    second = first + np.array([3.0, -2.0]) + move + np.random.default_rng(seed).normal(0, NOISE_PX, first.shape)
    if alone:
        first, second, board = first[board == 0], second[board == 0], board[board == 0]
    return check_field(fit_homography(first, second), first, board)


@pytest.mark.parametrize("seed", range(8))
def test_noise_is_noise(seed: int) -> None:
    found = check(np.zeros((108, 2)), seed)
    assert not found.distorted
    assert not found.parallax
    assert found.noise_px == pytest.approx(NOISE_PX * np.sqrt(2), rel=0.25)
    assert "the residuals are noise" in found.sentence


@pytest.mark.parametrize("seed", range(3))
def test_a_lens_is_a_smooth_field(seed: int) -> None:
    first, _ = boards()
    away = (first - [200.0, 150.0]) / 200
    found = check(3.0 * away * (away**2).sum(axis=1, keepdims=True), seed)
    assert found.distorted
    assert not found.parallax
    assert found.smooth_px > 0.1
    assert "lenses distort differently" in found.sentence


@pytest.mark.parametrize("seed", range(3))
def test_boards_that_disagree_are_parallax(seed: int) -> None:
    _, board = boards()
    # a second centre of projection moves a nearer board as a whole
    found = check(np.where(board[:, None] == 1, 1.5, 0.0) * np.array([0.0, 1.0]), seed)
    assert found.parallax
    assert not found.distorted
    assert found.parallax_px > 0.05
    assert "the boards disagree" in found.sentence


def test_one_board_says_that_it_cannot_tell() -> None:
    found = check(np.zeros((108, 2)), 0, alone=True)
    assert "one board cannot show parallax" in found.sentence
    assert found.parallax_px == 0


def test_refusal() -> None:
    first, _ = boards()
    few = first[:12]
    with pytest.raises(KernelError, match="12 corners are too few"):
        check_field(fit_homography(few, few + 1), few, np.zeros(12, int))

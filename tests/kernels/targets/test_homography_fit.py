"""Homographies between two cameras of which the test knows where each corner is."""

import numpy as np
import pytest
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.homography_fit import (
    expected_error_px,
    fit_dlt,
    fit_homography,
    homography_basis,
    transfer,
)

Array = NDArray[np.float64]
TRUE = np.array([[1.02, 0.03, -4.0], [-0.02, 0.99, 6.0], [4e-5, -3e-5, 1.0]])


def lattice(columns: int = 9, rows: int = 6, step: float = 30.0) -> Array:
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    return 40 + step * np.stack([x, y], axis=-1).reshape(-1, 2).astype(float)


def through(matrix: Array, points: Array) -> Array:
    out = []
    for x, y in points:
        a, b, c = matrix @ [x, y, 1.0]
        out.append([a / c, b / c])
    return np.array(out)


def test_by_hand() -> None:
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    np.testing.assert_allclose(fit_dlt(square, square * 2 + [3, 4]), [[2, 0, 3], [0, 2, 4], [0, 0, 1]], atol=1e-9)
    # (1, 1) goes to (1, 1) / (1 + 1): perspective
    np.testing.assert_allclose(
        transfer(np.array([[1.0, 0, 0], [0, 1, 0], [1, 0, 1]]), np.ones((1, 2))), [[0.5, 0.5]]
    )


@pytest.mark.parametrize("method", ["sampson", "geometric"])
def test_exact_corners_give_the_matrix(method: str) -> None:
    first = lattice()
    second = through(TRUE, first)
    first.flags.writeable = second.flags.writeable = False
    fit = fit_homography(first, second, method=method)  # type: ignore[arg-type]
    np.testing.assert_allclose(fit.matrix, TRUE, atol=1e-8)
    assert fit.rms_px < 1e-7


def test_noise_ends_where_the_covariance_says_and_both_costs_agree() -> None:
    first, sigma = lattice(), 0.05
    second = through(TRUE, first)
    corner = np.array([[40.0, 40.0], [280.0, 190.0], [160.0, 115.0]])
    off, told = [], []
    for seed in range(60):
        random = np.random.default_rng(seed)
        a, b = (p + random.normal(0, sigma, p.shape) for p in (first, second))
        fit = fit_homography(a, b)
        off.append(np.linalg.norm(through(fit.matrix, corner) - through(TRUE, corner), axis=1))
        told.append(expected_error_px(fit, corner))
        # 2 n numbers of noise less 8: each corner has sigma^2 in four numbers, of which two are explained
        assert fit.geometric_px == pytest.approx(sigma * np.sqrt(2), rel=0.3)
        assert fit.sampson_px == pytest.approx(fit.geometric_px, rel=1e-3)
        if seed < 3:
            other = fit_homography(a, b, method="geometric")
            np.testing.assert_allclose(through(other.matrix, corner), through(fit.matrix, corner), atol=2e-4)
    # a standard deviation of 60 trials is known to 9 %, of three points that share one fit
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(off), axis=0)), np.mean(told, axis=0), rtol=0.3)


def test_a_corner_with_a_large_covariance_hardly_counts() -> None:
    first = lattice()
    second = through(TRUE, first)
    second[10] += [5.0, -3.0]
    small = np.broadcast_to(np.eye(2) * 1e-4, (len(first), 2, 2)).copy()
    large = small.copy()
    large[10] = np.eye(2) * 1e4
    fit = fit_homography(first, second, covariance_first=small, covariance_second=large)
    assert np.linalg.norm(through(fit.matrix, first) - through(TRUE, first), axis=1).max() < 1e-3


def test_moving_both_pictures_moves_the_matrix() -> None:
    random = np.random.default_rng(5)
    first = lattice()
    second = through(TRUE, first) + random.normal(0, 0.05, first.shape)
    plain = fit_homography(first, second).matrix
    move = np.array([[1.0, 0, 70], [0, 1, -20], [0, 0, 1]])
    moved = fit_homography(first + move[:2, 2], second + move[:2, 2]).matrix
    expected = move @ plain @ np.linalg.inv(move)
    np.testing.assert_allclose(moved, expected / expected[2, 2], atol=1e-7)


def test_the_basis_is_what_the_matrix_can_do() -> None:
    first = lattice()
    basis = homography_basis(TRUE, first)
    for index in ((0, 0), (1, 2), (2, 1)):
        other = TRUE.copy()
        other[index] += 1e-6
        change = (through(other, first) - through(TRUE, first)).ravel()
        rest = change - basis @ np.linalg.lstsq(basis, change, rcond=None)[0]
        assert np.linalg.norm(rest) < 1e-3 * np.linalg.norm(change)


def test_refusals() -> None:
    with pytest.raises(KernelError, match="4 pairs of corners, not all on a line; 3 are given"):
        fit_dlt(np.zeros((3, 2)), np.zeros((3, 2)))
    line = np.stack([np.arange(8.0), np.arange(8.0)], axis=1)
    with pytest.raises(KernelError, match="lie on a line"):
        fit_dlt(line, line)

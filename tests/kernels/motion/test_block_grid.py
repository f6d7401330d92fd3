"""The step on a block grid against the dense system, put together by finite differences of its energy."""

import numpy as np
import pytest
from numpy.typing import NDArray

from lightstage.kernels.motion.block_grid import MASS, edges_of, minimise

Array = NDArray[np.float64]
ROWS, COLUMNS, SIZE = 4, 5, 2
WEIGHTS = np.array([3.0, 0.5])
TRACE = 1e-3


def energy(d: Array, hessian: Array, gradient: Array, theta: Array, edges: Array) -> float:
    """d' H d / 2 + g' d + bending of theta + d, written out cell by cell."""
    total = float((gradient * d).sum())
    for j in range(ROWS - 1):
        for i in range(COLUMNS - 1):
            corners = [d[j, i], d[j, i + 1], d[j + 1, i], d[j + 1, i + 1]]
            for p in range(4):
                for q in range(4):
                    total += 0.5 * MASS[p, q] * float(corners[p] @ hessian[j, i] @ corners[q])
    x = theta + d
    for k in range(SIZE):
        for j in range(ROWS):
            for i in range(COLUMNS):
                if 0 < i < COLUMNS - 1:
                    bend = x[j, i - 1, k] - 2 * x[j, i, k] + x[j, i + 1, k]
                    total += 0.5 * edges[0, j, i] * WEIGHTS[k] * bend**2
                if 0 < j < ROWS - 1:
                    bend = x[j - 1, i, k] - 2 * x[j, i, k] + x[j + 1, i, k]
                    total += 0.5 * edges[1, j, i] * WEIGHTS[k] * bend**2
                if i < COLUMNS - 1 and j < ROWS - 1:
                    bend = x[j, i, k] - x[j, i + 1, k] - x[j + 1, i, k] + x[j + 1, i + 1, k]
                    total += 0.5 * 2 * edges[2, j, i] * WEIGHTS[k] * bend**2
    return total + 0.5 * TRACE * float((x**2).sum())


def dense(hessian: Array, gradient: Array, theta: Array, edges: Array) -> Array:
    """The minimum of a quadratic from its values alone."""
    shape, count = (ROWS, COLUMNS, SIZE), ROWS * COLUMNS * SIZE
    units = np.eye(count).reshape(count, *shape)

    def at(d: Array) -> float:
        return energy(d, hessian, gradient, theta, edges)

    zero = at(np.zeros(shape))
    single = np.array([at(u) for u in units])
    matrix = np.array([[at(u + v) for v in units] for u in units]) - single[:, None] - single[None] + zero
    slope = single - zero - 0.5 * np.diag(matrix)
    return np.asarray(np.linalg.solve(matrix, -slope).reshape(shape))


@pytest.mark.parametrize("seed", range(3))
def test_the_step_is_the_minimum(seed: int) -> None:
    random = np.random.default_rng(seed)
    roots = random.normal(size=(ROWS - 1, COLUMNS - 1, SIZE, SIZE))
    hessian = roots @ np.swapaxes(roots, 2, 3) + 0.5 * np.eye(SIZE)
    hessian[0, 1] = 0  # a cell without a pixel
    gradient, theta = random.normal(size=(2, ROWS, COLUMNS, SIZE))
    edges = random.uniform(0.2, 1, (3, ROWS, COLUMNS))
    gradient.flags.writeable = theta.flags.writeable = False
    found = minimise(hessian, gradient, theta, WEIGHTS, edges, MASS)
    true = dense(hessian, gradient, theta, edges)
    start, end, least = (energy(d, hessian, gradient, theta, edges) for d in (0 * true, found, true))
    # conjugate gradients end early: what nothing but the data of many cells holds is left to the next step
    assert (end - least) < 0.03 * (start - least)
    assert np.linalg.norm(found - true) < 0.3 * np.linalg.norm(true)


def test_a_plane_does_not_bend_and_a_fold_is_an_edge() -> None:
    j, i = np.mgrid[:6, :7].astype(float)
    plane = np.stack([2 * i - 3 * j + 1, 0.5 * j], axis=-1)
    np.testing.assert_allclose(edges_of(plane, WEIGHTS, 0.1), 1)
    fold = np.stack([np.abs(i - 3), 0 * i], axis=-1)
    found = edges_of(fold, WEIGHTS, 0.5)
    # at the fold the second difference is 2: 3 x 2^2 over the limit of 1/2
    np.testing.assert_allclose(found[0, :, 3], 1 / (1 + 12 / 0.5))
    np.testing.assert_allclose(np.delete(found[0], 3, axis=1), 1)
    np.testing.assert_allclose(found[1], 1)


def test_the_masses_of_a_cell_are_integrals_of_bilinear_functions() -> None:
    u = (np.arange(200) + 0.5) / 200
    y, x = np.meshgrid(u, u, indexing="ij")
    bases = [(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y]
    np.testing.assert_allclose(MASS, [[np.mean(a * b) for b in bases] for a in bases], atol=1e-5)

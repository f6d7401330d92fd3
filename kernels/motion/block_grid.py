"""Fields on the nodes of a block grid that bend little: the linear algebra of `joint_flow`.

One Gauss-Newton step is the minimum over d of

    d^T H d / 2 + g^T d + sum lambda_k |second differences of (theta + d)_k|^2 / 2 ,

H the data's matrix, constant within a cell and spread over its four nodes as bilinear elements are, g the data's
gradient at the nodes. `edges_of` weighs second differences down where the field has an edge. Conjugate gradients
(Hestenes & Stiefel 1952) solve the system, with the nodes' own blocks as preconditioner; one thread, so results do
not depend on their number.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

# no "contract", a product and a sum in one step, no "arcp", one over a divisor times, no "reassoc", sums in lanes:
# they end in other last bits from processor to processor, and gain nothing that can be measured here
FLAGS = {"nogil": True, "cache": True, "error_model": "numpy", "fastmath": {"nsz"}}
MASS = np.array([[4, 2, 2, 1], [2, 4, 1, 2], [2, 1, 4, 2], [1, 2, 2, 4]]) / 36.0
"""Integrals of the products of a cell's four bilinear basis functions."""
_TRACE = 1e-3
"""Keeps a motion that no pixel tells at rest."""


@njit(**FLAGS)
def _bent(x: NDArray[np.float64], weights: NDArray[np.float64], edges: NDArray[np.float64]) -> NDArray[np.float64]:
    """The bending term's gradient at x (row, column, D)."""
    rows, columns, size = x.shape
    out = np.zeros_like(x)
    for j in range(rows):
        for i in range(columns):
            for k in range(size):
                if 0 < i < columns - 1:
                    d = edges[0, j, i] * weights[k] * (x[j, i - 1, k] - 2 * x[j, i, k] + x[j, i + 1, k])
                    out[j, i - 1, k] += d
                    out[j, i, k] -= 2 * d
                    out[j, i + 1, k] += d
                if 0 < j < rows - 1:
                    d = edges[1, j, i] * weights[k] * (x[j - 1, i, k] - 2 * x[j, i, k] + x[j + 1, i, k])
                    out[j - 1, i, k] += d
                    out[j, i, k] -= 2 * d
                    out[j + 1, i, k] += d
                if i < columns - 1 and j < rows - 1:
                    d = x[j, i, k] - x[j, i + 1, k] - x[j + 1, i, k] + x[j + 1, i + 1, k]
                    d *= 2 * edges[2, j, i] * weights[k]
                    out[j, i, k] += d
                    out[j, i + 1, k] -= d
                    out[j + 1, i, k] -= d
                    out[j + 1, i + 1, k] += d
    return out


@njit(**FLAGS)
def edges_of(x: NDArray[np.float64], weights: NDArray[np.float64], limit: float) -> NDArray[np.float64]:
    """Robust weights (3, row, column) of the second differences along x, along y, and mixed."""
    rows, columns, size = x.shape
    out = np.ones((3, rows, columns))
    for j in range(rows):
        for i in range(columns):
            across, down, mixed = 0.0, 0.0, 0.0
            for k in range(size):
                if 0 < i < columns - 1:
                    across += weights[k] * (x[j, i - 1, k] - 2 * x[j, i, k] + x[j, i + 1, k]) ** 2
                if 0 < j < rows - 1:
                    down += weights[k] * (x[j - 1, i, k] - 2 * x[j, i, k] + x[j + 1, i, k]) ** 2
                if i < columns - 1 and j < rows - 1:
                    mixed += (
                        2 * weights[k] * (x[j, i, k] - x[j, i + 1, k] - x[j + 1, i, k] + x[j + 1, i + 1, k]) ** 2
                    )
            out[0, j, i], out[1, j, i], out[2, j, i] = (
                1 / (1 + across / limit),
                1 / (1 + down / limit),
                1 / (1 + mixed / limit),
            )
    return out


@njit(**FLAGS)
def _applied(
    hessian: NDArray[np.float64],
    x: NDArray[np.float64],
    weights: NDArray[np.float64],
    edges: NDArray[np.float64],
    mass: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(data + bending + a trace of the identity) x; a cell's data matrix is taken as constant within it."""
    rows, columns, size = x.shape
    out: NDArray[np.float64] = _bent(x, weights, edges) + _TRACE * x
    product = np.zeros((4, size))
    for j in range(rows - 1):
        for i in range(columns - 1):
            h = hessian[j, i]
            if h[0, 0] == 0.0 and h[1, 1] == 0.0:
                continue
            for q in range(4):
                for e in range(size):
                    total = 0.0
                    for f in range(size):
                        total += h[e, f] * x[j + (q >> 1), i + (q & 1), f]
                    product[q, e] = total
            for r in range(4):
                for e in range(size):
                    total = 0.0
                    for q in range(4):
                        total += mass[r, q] * product[q, e]
                    out[j + (r >> 1), i + (r & 1), e] += total
    return out


@njit(**FLAGS)
def minimise(
    hessian: NDArray[np.float64],
    gradient: NDArray[np.float64],
    theta: NDArray[np.float64],
    weights: NDArray[np.float64],
    edges: NDArray[np.float64],
    mass: NDArray[np.float64],
) -> NDArray[np.float64]:
    """The Gauss-Newton step: conjugate gradients, with the diagonal blocks as preconditioner."""
    rows, columns, size = theta.shape
    blocks = np.zeros((rows, columns, size, size))
    for j in range(rows - 1):
        for i in range(columns - 1):
            for q in range(4):
                blocks[j + (q >> 1), i + (q & 1)] += mass[q, q] * hessian[j, i]
    for j in range(rows):
        for i in range(columns):
            for k in range(size):
                blocks[j, i, k, k] += 14 * weights[k] + _TRACE
            blocks[j, i] = np.linalg.inv(blocks[j, i])
    step = np.zeros_like(theta)
    rest = -(gradient + _bent(theta, weights, edges) + _TRACE * theta)
    direction = _by_blocks(blocks, rest)
    energy = np.sum(rest * direction)
    first = energy
    for _ in range(60):
        if energy <= 1e-4 * first:
            break
        pushed = _applied(hessian, direction, weights, edges, mass)
        length = energy / np.sum(direction * pushed)
        step += length * direction
        rest -= length * pushed
        turned = _by_blocks(blocks, rest)
        after = np.sum(rest * turned)
        direction = turned + (after / energy) * direction
        energy = after
    return step


@njit(**FLAGS)
def _by_blocks(blocks: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float64]:
    rows, columns, size = x.shape
    out = np.zeros_like(x)
    for j in range(rows):
        for i in range(columns):
            for e in range(size):
                for f in range(size):
                    out[j, i, e] += blocks[j, i, e, f] * x[j, i, f]
    return out

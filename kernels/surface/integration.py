"""Depth from normals: perspective, masked, aware of discontinuities.

A plane through the point z r with normal n gives for the neighbour's ray r' (rays with r_z = 1)

    (n . r) (L' - L) = -n . (r' - r),        L = log z

one equation per pixel and side (left, right, up, down), so the depth is known up to one factor. Where the
surface breaks, one of the two sides is wrong: bilateral weights let the side win towards which the present
depth changes less (Cao et al. 2022, doi:10.1007/978-3-031-19769-7_32), found by reweighted least squares. Each
system is solved by conjugate gradients on scipy.sparse, preconditioned with pyamg's classical multigrid.

Limits: parts of the mask that do not touch have an unknown ratio of depths; they keep that of `start`.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STIFFNESS = 2.0
"""k of Cao et al.: how fast the better side takes all."""
_GRAZING = 0.03
"""Least |n . r|: a surface seen edge-on says nothing of its depth."""
_TOLERANCE = 1e-8
"""Of the solver: so far that neither its last step nor the multigrid it was given shows in the depth."""
_LOOSE = 1e-9
"""Stiffness of what nothing holds: parts that touch nothing, and the free mean."""


def integrate(
    normal: Array,
    mask: NDArray[np.bool_],
    rays: Array,
    *,
    start: Array | None = None,
    rounds: int = 6,
    stiffness: float = STIFFNESS,
) -> Array:
    """Log depth from normals.

    Args:
        normal: (y, x, xyz) unit normals in the camera's frame (x right, y down, z forward).
        mask: (y, x), where there is a surface; the normals must be finite there.
        rays: (y, x, xyz) rays of the pixels in the camera's frame, r_z = 1.
        start: (y, x) log depth to begin from.
        rounds: of reweighting, all of them done: where they ended early, a last bit would decide on which side.
        stiffness: 0 gives plain least squares.

    Returns:
        (y, x) log depth, mean 0 in the mask, NaN outside it.
    """
    out = np.full(mask.shape, np.nan)
    if not mask.any():
        return out
    sides = _sides(normal, mask, rays)
    z = np.zeros(int(mask.sum())) if start is None else np.where(np.isfinite(start), start, 0)[mask]
    pixel = _pixel(rays)
    z = _solve(sides, [np.full(z.size, 0.5)] * 4, z)
    for _ in range(rounds - 1 if stiffness else 0):
        z = _solve(sides, _weights(sides, z, pixel, stiffness), z)
    out[mask] = z - z.mean()
    return out


def softest(
    normal: Array, mask: NDArray[np.bool_], rays: Array, log_depth: Array, count: int
) -> tuple[Array, Array, float]:
    """The shapes that normals hold least, beside the factor of the whole.

    Args:
        normal, mask, rays: as of `integrate`; the mask in one piece.
        log_depth: (y, x), by which breaks are told.
        count: how many shapes.

    Returns:
        (number, point) shapes, the softest first, each of unit length; the energy that a unit of each costs
        (number,); the variance of the equations' misfit.
    """
    import scipy.sparse
    from scipy.sparse.linalg import eigsh

    sides = _sides(normal, mask, rays)
    z = log_depth[mask]
    weights = _weights(sides, z, _pixel(rays), STIFFNESS)
    system: Any = scipy.sparse.identity(z.size, format="csr") * _LOOSE
    misfit = 0.0
    for (matrix, right), weight in zip(sides, weights, strict=True):
        system = system + matrix.T @ scipy.sparse.diags(weight) @ matrix
        misfit += float((weight * (matrix @ z - right) ** 2).sum())
    count = min(count, z.size - 2)
    # from the same vector each time, or the solver would draw one
    energy, shapes = eigsh(system.tocsc(), k=count + 1, sigma=-100 * _LOOSE, which="LM", v0=np.ones(z.size))
    order = np.argsort(energy, kind="stable")[1:]
    return np.ascontiguousarray(shapes[:, order].T), energy[order], misfit / (2 * z.size)


def _sides(normal: Array, mask: NDArray[np.bool_], rays: Array) -> list[tuple[Any, Array]]:
    """The equations to the right, left, down and up."""
    n = normal[mask]
    facing = np.minimum(np.einsum("ij,ij->i", n, rays[mask]), -_GRAZING)
    return [_side(n, facing, mask, rays, step) for step in ((0, 1), (0, -1), (1, 0), (-1, 0))]


def _weights(sides: list[tuple[Any, Array]], z: Array, pixel: float, stiffness: float) -> list[Array]:
    """Of each side's equations: the side towards which depth changes less wins."""
    moved = [((matrix @ z) / pixel) ** 2 for matrix, _ in sides]
    right_wins, down_wins = _better(moved[1] - moved[0], stiffness), _better(moved[3] - moved[2], stiffness)
    return [right_wins, 1 - right_wins, down_wins, 1 - down_wins]


def _pixel(rays: Array) -> float:
    """Usual step between the rays of neighbours."""
    for axis in (1, 0):
        if rays.shape[axis] > 1:
            return float(np.median(np.linalg.norm(np.diff(rays, axis=axis)[..., :2], axis=-1)))
    return 1.0


def _better(advantage: Array, stiffness: float) -> Array:
    return np.asarray(1 / (1 + np.exp(-np.clip(stiffness * advantage, -50, 50))))


def _side(
    n: Array, facing: Array, mask: NDArray[np.bool_], rays: Array, step: tuple[int, int]
) -> tuple[Any, Array]:
    """The equations of one side: (sparse matrix, right side); rows without a neighbour are empty."""
    import scipy.sparse

    number = np.full(mask.shape, -1)
    number[mask] = np.arange(n.shape[0])
    beside = np.full(mask.shape, -1)
    towards = np.zeros_like(rays)
    (rows_here, rows_there), (columns_here, columns_there) = (_shifted(s) for s in step)
    beside[rows_here, columns_here] = number[rows_there, columns_there]
    towards[rows_here, columns_here] = rays[rows_there, columns_there] - rays[rows_here, columns_here]
    neighbour = beside[mask]
    rows = np.flatnonzero(neighbour >= 0)
    factor = facing[rows]
    matrix = scipy.sparse.csr_matrix(
        (np.r_[factor, -factor], (np.r_[rows, rows], np.r_[neighbour[rows], rows])), shape=(n.shape[0],) * 2
    )
    return matrix, np.where(neighbour >= 0, -np.einsum("ij,ij->i", n, towards[mask]), 0.0)


def _shifted(step: int) -> tuple[slice, slice]:
    """Slices of what has a neighbour `step` away, and of those neighbours."""
    return {
        0: (slice(None), slice(None)),
        1: (slice(0, -1), slice(1, None)),
        -1: (slice(1, None), slice(0, -1)),
    }[step]


def _solve(sides: list[tuple[Any, Array]], weights: list[Array], start: Array) -> Array:
    import pyamg
    import scipy.sparse
    from scipy.sparse.linalg import cg

    size = start.size
    system: Any = scipy.sparse.identity(size, format="csr") * _LOOSE
    right = _LOOSE * start
    for (matrix, side), weight in zip(sides, weights, strict=True):
        weighted = matrix.T @ scipy.sparse.diags(weight)
        system = system + weighted @ matrix
        right = right + weighted @ side
    multigrid = pyamg.ruge_stuben_solver(system.tocsr(), max_coarse=500)
    z, _ = cg(system, right, x0=start, M=multigrid.aspreconditioner(), rtol=_TOLERANCE, maxiter=60)
    return np.asarray(z)

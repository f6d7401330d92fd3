"""The homography from one camera to the other, from the corners of one or several boards.

    minimal DLT:  A h = 0, |h| = 1, coordinates normalised       (start)
    sampson:      min Σ eᵀ (J Jᵀ)⁻¹ e                            e = x' × H x, J = ∂e/∂(x, y, x', y')
    geometric:    min Σ |x - x̂|² + |x' - H x̂|²  over H and x̂    (gold standard)

The corners of both cameras carry error, so the error is counted in both. Sampson's is the first-order value of the
geometric error and needs no x̂; here both reach the same H, and Sampson is the cheaper one. Every corner may have
its covariance: then all of the above is in units of sigma.

Two cameras behind a beam splitter see a scene of any depth through one homography only if their centres of
projection coincide. What remains shows in the residuals: `verdict` says whether they are noise.

Sources: Hartley & Zisserman (2004), Multiple View Geometry, alg. 4.2, 4.3, sections 4.2.4, 4.2.6 and 5.2;
Hartley (1997), doi:10.1109/34.601246 (normalisation); Dutta (2010) 3.2.3.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError

Array = NDArray[np.float64]
Method = Literal["sampson", "geometric"]


@dataclass(frozen=True)
class Fit:
    """A homography and how well it holds."""

    matrix: Array
    """(3, 3), last element 1: (x, y, 1) of the first camera to the second."""
    covariance: Array
    """(8, 8) of the elements h11..h32, from the residuals' own spread."""
    residual: Array
    """(n, xy) transfer residual H x - x', pixels of the second camera."""
    rms_px: float
    """Root mean square distance |H x - x'|."""
    geometric_px: float
    """Root of the mean of |x - x̂|² + |x' - H x̂|²: what the maximum-likelihood estimate minimises."""
    sampson_px: float
    """The same by Sampson's approximation."""


def transfer(matrix: Array, points: Array) -> Array:
    """Points (..., xy) through a homography."""
    mapped = points @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(mapped[..., :2] / mapped[..., 2:])


def fit_dlt(first: Array, second: Array) -> Array:
    """Normalised direct linear transform (alg. 4.2).

    Args:
        first, second: (n, xy) of the same corners.

    Returns:
        (3, 3), last element 1.

    Raises:
        KernelError: fewer than four pairs, or all on a line.
    """
    if len(first) < 4:
        raise KernelError(f"a homography needs 4 pairs of corners, not all on a line; {len(first)} are given")
    (t, a), (u, b) = _normalised(first), _normalised(second)
    ones, zeros = np.ones((len(a), 1)), np.zeros((len(a), 3))
    p = np.concatenate([a, ones], 1)
    rows = np.concatenate([np.hstack([p, zeros, -b[:, :1] * p]), np.hstack([zeros, p, -b[:, 1:] * p])])
    _, strengths, vectors = np.linalg.svd(rows)
    if strengths[7] < 1e-9 * strengths[0]:
        raise KernelError("the corners lie on a line, so they do not give a homography; show the whole board")
    matrix = np.linalg.inv(u) @ vectors[-1].reshape(3, 3) @ t
    return np.asarray(matrix / matrix[2, 2])


def _normalised(points: Array) -> tuple[Array, Array]:
    centre = points.mean(0)
    scale = np.sqrt(2) / max(float(np.linalg.norm(points - centre, axis=1).mean()), 1e-12)
    matrix = np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1]])
    return matrix, (points - centre) * scale


def fit_homography(
    first: Array,
    second: Array,
    *,
    covariance_first: Array | None = None,
    covariance_second: Array | None = None,
    method: Method = "sampson",
    iterations: int = 30,
) -> Fit:
    """Maximum-likelihood homography.

    Args:
        first, second: (n, xy) of the same corners, pixels.
        covariance_first, covariance_second: (n, 2, 2), pixels squared; without them all corners count alike.

    Raises:
        KernelError: too few corners, or all on a line.
    """
    (t, a), (u, b) = _normalised(first), _normalised(second)
    eye = np.broadcast_to(np.eye(2), (len(a), 2, 2))
    # one typical variance: only the ratios between corners weigh, the scale comes from the residuals
    unit = 1.0
    if covariance_first is not None and covariance_second is not None:
        unit = float(np.median(np.trace(covariance_first + covariance_second, axis1=1, axis2=2))) / 4
    va = (eye if covariance_first is None else covariance_first / unit) * t[0, 0] ** 2
    vb = (eye if covariance_second is None else covariance_second / unit) * u[0, 0] ** 2
    start = u @ fit_dlt(first, second) @ np.linalg.inv(t)
    h = start.ravel()[:8] / start[2, 2]
    moved = a.copy()
    for _ in range(iterations):
        normal, right, moved = _equations(h, a, b, va, vb, moved, method)
        step = np.linalg.solve(normal, right)
        h = h + step
        if np.abs(step).max() < 1e-13:
            break
    # polish the corrected corners for the figures; they cost one 2 x 2 system each
    for _ in range(4):
        *_, moved = _equations(h, a, b, va, vb, moved, "geometric")
    normal, *_ = _equations(h, a, b, va, vb, moved, "geometric")
    inner = np.append(h, 1.0).reshape(3, 3)
    matrix = np.linalg.inv(u) @ inner @ t
    scale = matrix[2, 2]
    matrix = matrix / scale
    jacobian = _denormalise(t, u, matrix, scale)
    residual = transfer(matrix, first) - second
    geometric = _cost(a - moved, va) + _cost(b - transfer(inner, moved), vb)
    sampson = _sampson(inner, a, b, va, vb)
    freedom = max(2 * len(a) - 8, 1)
    return Fit(
        matrix=matrix,
        covariance=jacobian @ np.linalg.inv(normal) @ jacobian.T * float(geometric.sum()) / freedom,
        residual=residual,
        rms_px=float(np.sqrt((residual**2).sum(1).mean())),
        geometric_px=float(np.sqrt(geometric.mean())),
        sampson_px=float(np.sqrt(sampson.mean())),
    )


def _jacobians(h: Array, points: Array) -> tuple[Array, Array, Array]:
    """H x (n, xy), its derivative by h (n, 2, 8) and by x (n, 2, 2)."""
    matrix = np.append(h, 1.0).reshape(3, 3)
    mapped = points @ matrix[:, :2].T + matrix[:, 2]
    w = mapped[:, 2]
    y = mapped[:, :2] / w[:, None]
    by_h = np.zeros((len(points), 2, 8))
    p = np.concatenate([points, np.ones((len(points), 1))], 1) / w[:, None]
    by_h[:, 0, 0:3] = by_h[:, 1, 3:6] = p
    by_h[:, :, 6:8] = -y[:, :, None] * p[:, None, :2]
    by_x = (matrix[None, :2, :2] - y[:, :, None] * matrix[None, None, 2, :2]) / w[:, None, None]
    return y, by_h, by_x


def _equations(
    h: Array, a: Array, b: Array, va: Array, vb: Array, moved: Array, method: Method
) -> tuple[Array, Array, Array]:
    """Gauss-Newton's normal equations for h with x̂ eliminated, and the next x̂.

    Linearised about x̂, x' - H x̂ - J (x - x̂) has the covariance S = V' + J V Jᵀ. About x̂ = x that is Sampson's
    error; iterating x̂ makes it the gold standard's.
    """
    about = a if method == "sampson" else moved
    y, by_h, by_x = _jacobians(h, about)
    e = b - y - np.einsum("nij,nj->ni", by_x, a - about)
    information = np.linalg.inv(vb + by_x @ va @ np.swapaxes(by_x, 1, 2))
    weighted = np.swapaxes(by_h, 1, 2) @ information
    normal = np.einsum("nij,njk->ik", weighted, by_h)
    right = np.einsum("nij,nj->i", weighted, e)
    gain = va @ np.swapaxes(by_x, 1, 2) @ information
    return normal, right, a + np.einsum("nij,nj->ni", gain, e)


def _cost(error: Array, covariance: Array) -> Array:
    """Squared error of every corner; the caller's unit of covariance is one pixel squared."""
    return np.asarray(np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error))


def _sampson(matrix: Array, a: Array, b: Array, va: Array, vb: Array) -> Array:
    """Squared Sampson error (section 4.2.6, eq. 4.12) of the algebraic error x' × H x, first two rows."""
    p = np.concatenate([a, np.ones((len(a), 1))], 1)
    m = p @ matrix.T
    e = np.stack([b[:, 1] * m[:, 2] - m[:, 1], m[:, 0] - b[:, 0] * m[:, 2]], 1)
    by_a = np.stack([b[:, 1:] * matrix[2, :2] - matrix[1, :2], matrix[0, :2] - b[:, :1] * matrix[2, :2]], 1)
    by_b = np.zeros((len(a), 2, 2))
    by_b[:, 0, 1], by_b[:, 1, 0] = m[:, 2], -m[:, 2]
    spread = by_a @ va @ np.swapaxes(by_a, 1, 2) + by_b @ vb @ np.swapaxes(by_b, 1, 2)
    return np.asarray(np.einsum("ni,nij,nj->n", e, np.linalg.inv(spread), e))


def _denormalise(t: Array, u: Array, matrix: Array, scale: float) -> Array:
    """d(h in pixels) / d(h normalised), (8, 8)."""
    columns = []
    for k in range(8):
        unit = np.zeros(9)
        unit[k] = 1
        d = np.linalg.inv(u) @ unit.reshape(3, 3) @ t / scale
        columns.append((d - matrix * d[2, 2]).ravel()[:8])
    return np.stack(columns, 1)


def homography_basis(matrix: Array, points: Array) -> Array:
    """(2n, 8): how x' changes with the elements of H; what a homography can follow, to first order."""
    scale = np.ptp(points, axis=0).max()
    centred = np.array([[scale, 0, points[:, 0].mean()], [0, scale, points[:, 1].mean()], [0, 0, 1]])
    inner = matrix @ centred
    _, by_h, _ = _jacobians((inner / inner[2, 2]).ravel()[:8], (points - centred[:2, 2]) / scale)
    return np.asarray(by_h.reshape(-1, 8))


def expected_error_px(fit: Fit, points: Array) -> Array:
    """Standard deviation of H x (root of both axes' variances) at points (n, xy): where the boards tell little."""
    _, by_h, _ = _jacobians(fit.matrix.ravel()[:8], points)
    return np.asarray(np.sqrt(np.einsum("nij,jk,nik->n", by_h, fit.covariance, by_h)))

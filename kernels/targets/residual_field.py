"""What the residuals of a homography say: noise, lens distortion or parallax.

    e = smooth(x) + board(x) + noise

The bases are made orthogonal to the derivatives of the homography, so they hold only what no homography can follow,
and are judged by the F statistic. One plane seen from two centres is always a homography: one board shows lens
distortion, never parallax; two boards at different depth or tilt show both.

Sources: Hartley & Zisserman (2004), Multiple View Geometry, sections 7.4 (distortion), 13.1 (plane-induced
homography, parallax).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as f_distribution

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.homography_fit import Fit, homography_basis

Array = NDArray[np.float64]
MATTERS_PX = 0.05
"""A smooth residual below this (root mean square) is called noise, however significant: it moves no result."""


@dataclass(frozen=True)
class FieldCheck:
    """The residuals, taken apart."""

    smooth: Array
    """(n, xy) part of the residual that a cubic polynomial follows, pixels."""
    smooth_px: float
    noise_px: float
    board_px: Array
    """(board, xy) mean residual of every board."""
    parallax_px: float
    """Largest difference between two boards' own fields, root mean square; 0 for one board."""
    distorted: bool
    parallax: bool
    sentence: str


def check_field(fit: Fit, first: Array, board: NDArray[np.int_], *, degree: int = 3) -> FieldCheck:
    """Take the residuals apart: smooth over the picture, different between boards, noise.

    Args:
        fit: of all boards together.
        first: (n, xy) the corners it was fitted to.
        board: (n,) which board each belongs to.
    """
    boards = int(board.max()) + 1
    if len(first) < 2 * (degree + 1) * (degree + 2) // 2:
        raise KernelError(f"{len(first)} corners are too few to tell a smooth residual from noise; use more boards")
    scaled = (first - first.mean(0)) / np.ptp(first, axis=0).max()
    x, y = scaled.T
    powers = np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], 1)
    tangent = homography_basis(fit.matrix, first)
    e = fit.residual.reshape(-1)
    smooth, p_smooth, rest = _part(e, tangent, np.kron(powers, np.eye(2)))
    known = np.concatenate([tangent, np.kron(powers, np.eye(2))], 1)
    apart, p_parallax = np.zeros_like(e), 1.0
    if boards > 1:
        # offset and slope of every board's own: what a second centre of projection does to planes
        own = np.stack([x**i * y**j * (board == k) for k in range(boards) for i, j in ((0, 0), (1, 0), (0, 1))], 1)
        # judged both before the polynomial (which may follow depth) and after it (which cannot)
        apart, p_before, _ = _part(e, tangent, np.kron(own, np.eye(2)))
        _, p_after, rest = _part(e, known, np.kron(own, np.eye(2)))
        p_parallax = max(p_before, p_after)
    means = np.stack([fit.residual[board == k].mean(0) for k in range(boards)])
    parallax = p_parallax < 1e-4 and _rms(apart) > MATTERS_PX
    distorted = not parallax and p_smooth < 1e-4 and _rms(smooth) > MATTERS_PX
    if parallax:
        sentence = (
            f"the boards disagree by {_rms(apart):.2f} px above the noise of {_rms(rest):.3f} px: parallax; the "
            "cameras' centres do not coincide, so the homography holds only near the boards' depth"
        )
    elif distorted:
        sentence = (
            f"a smooth residual of {_rms(smooth):.2f} px remains above the noise of {_rms(rest):.3f} px: the "
            "cameras' lenses distort differently; a homography cannot follow it"
        )
    else:
        sentence = f"the residuals are noise ({fit.rms_px:.3f} px): one homography holds where the boards were"
        if boards == 1:
            sentence += "; one board cannot show parallax, add one at another depth and tilt"
    return FieldCheck(
        smooth.reshape(-1, 2), _rms(smooth), _rms(rest), means, _rms(apart), distorted, parallax, sentence
    )


def _rms(field: Array) -> float:
    return float(np.sqrt((field.reshape(-1, 2) ** 2).sum(1).mean()))


def _part(e: Array, known: Array, basis: Array) -> tuple[Array, float, Array]:
    """The part of e in `basis` outside `known`, its p value by the F statistic, and what remains."""
    q, _ = np.linalg.qr(known / np.maximum(np.linalg.norm(known, axis=0), 1e-300))
    e = e - q @ (q.T @ e)
    free = basis - q @ (q.T @ basis)
    u, s, _ = np.linalg.svd(free, full_matrices=False)
    u = u[:, s > 1e-6 * np.linalg.norm(basis, axis=0).max()]
    part = u @ (u.T @ e)
    rest = e - part
    freedom = e.size - q.shape[1] - u.shape[1]
    if u.shape[1] == 0 or freedom <= 0:
        return part, 1.0, rest
    ratio = (part @ part / u.shape[1]) / max(rest @ rest / freedom, 1e-300)
    return part, float(f_distribution.sf(ratio, u.shape[1], freedom)), rest

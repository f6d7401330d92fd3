"""The outline of a ball as a conic, and the ball's centre in space.

    x' C x = 0          the outline, a conic in pixels
    K' C K = M diag(a, a, b) M'          S_c = +-M (0, 0, d)',   d = R sqrt(1 + |a| / |b|)

a and b have opposite signs, so the (a + b) / b that is often printed is right only for their sizes; of the two
signs of S_c the one before the camera counts. The rays u_k to the outline lie on a cone about S_c, u_k . w = 1
with w = S_c / sqrt(d^2 - R^2): with K this is fitted instead of the ellipse, three unknowns for five, and a lens
distortion is undone exactly on the points. Without K the camera is taken as orthographic.

Sources: Wong, Schnieders, Li (2008), doi:10.1007/978-3-540-88682-2_48 (sphere centre); Fitzgibbon, Pilu, Fisher
(1999), doi:10.1109/34.765658, in the stable form of Halir, Flusser (1998) (ellipse); Dutta (2010) 3.1.2.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError

Floats = NDArray[np.float64]


class Outline(NamedTuple):
    """Outline of a ball; pixel (0, 0) is the centre of the top-left pixel."""

    conic: Floats
    """(3, 3), in pixels without lens distortion, unit Frobenius norm."""
    ring_px: Floats
    """(720, xy): the outline as it lies in the picture, lens distortion included."""
    centre_px: Floats
    """(xy) of the ellipse, without lens distortion; not the image of the ball's centre."""
    radius_px: float
    """Square root of the product of its semi-axes: the ball's radius for an orthographic camera."""
    points_px: Floats
    """(point, xy): what was fitted, as in the picture."""
    used: NDArray[np.bool_]
    """(point): False where the robust fit left it out."""
    rms_px: float
    """Of the used points."""
    seen: float
    """Part of the outline that has used points."""


def outline_of_points(
    points_px: Floats, *, intrinsics: Floats | None = None, distortion: Floats | None = None,
    weights: Floats | None = None, frame: tuple[int, ...] | None = None,
) -> Outline:  # fmt: skip
    """Robust outline through points (point, xy), picked by hand or found; six or more.

    Starts from the best of 300 random triples (Fischler, Bolles 1981), then reweights (Tukey).

    Raises:
        KernelError: too few points, or no ellipse through them, or it leaves the frame (y, x).
    """
    if len(points_px) < 6:
        raise KernelError(f"{len(points_px)} points do not make an outline; pick six or more around the ball")
    weights = np.ones(len(points_px)) if weights is None else weights
    plain = _undistorted(points_px, intrinsics, distortion)
    error = _start(plain, weights)
    conic, scale = np.zeros((3, 3)), 0.0
    for _ in range(20):
        scale = max(1.4826 * float(np.median(error[error < np.inf])), 0.05)
        robust = weights * np.clip(1 - (error / (4.7 * scale)) ** 2, 0, None) ** 2
        if np.count_nonzero(robust) < 6:
            raise KernelError("no ellipse fits the points of the outline; pick others, or more")
        conic = _ellipse(plain, robust) if intrinsics is None else _cone(plain, robust, intrinsics)
        error = np.abs(_distance(conic, plain))
    used = error < 3 * scale
    centre, axes, angle = _geometry(conic)
    turn = np.radians(np.arange(720) / 2)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    around = centre + (np.stack([np.cos(turn), np.sin(turn)], 1) * axes) @ rotation.T
    ring = _distorted(around, intrinsics, distortion)
    if frame is not None:
        low, high = ring.min(0), ring.max(0)
        if (low < 0).any() or high[0] > frame[1] - 1 or high[1] > frame[0] - 1:
            raise KernelError("the ball is cut by the frame; the whole ball must be in the picture")
    spread = plain[used] - centre
    # twelve degrees hold a point at least, however coarse the points are
    sectors = np.unique(np.floor(np.degrees(np.arctan2(spread[:, 1], spread[:, 0])) / 12) % 30)
    rms = float(np.sqrt(np.mean(error[used] ** 2)))
    return Outline(conic, ring, centre, float(np.sqrt(axes.prod())), points_px, used, rms, sectors.size / 30)


def sphere_centre(conic: Floats, intrinsics: Floats, radius_mm: float) -> Floats:
    """Centre of the ball in the camera's frame, (xyz) mm (Wong 2008), from its outline in pixels."""
    values, vectors = np.linalg.eigh(intrinsics.T @ conic @ intrinsics)
    # the eigenvalue that stands alone in its sign belongs to the axis
    signs = np.sign(values)
    alone = int(np.flatnonzero(signs != np.sign(signs.sum()))[0])
    pair = -np.delete(values, alone) / values[alone]
    distance = radius_mm * np.sqrt(1 + np.sqrt(pair.prod()))
    axis = vectors[:, alone]
    return np.asarray(axis * np.sign(axis[2]) * distance)


def _undistorted(points: Floats, intrinsics: Floats | None, distortion: Floats | None) -> Floats:
    if intrinsics is None or distortion is None or not np.any(distortion):
        return points
    return np.asarray(
        cv2.undistortPoints(points[:, None], intrinsics, np.asarray(distortion, np.float64), P=intrinsics)[:, 0]
    )


def _distorted(points: Floats, intrinsics: Floats | None, distortion: Floats | None) -> Floats:
    if intrinsics is None or distortion is None or not np.any(distortion):
        return points
    rays = np.column_stack([points, np.ones(len(points))]) @ np.linalg.inv(intrinsics).T
    bent = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), intrinsics, np.asarray(distortion, np.float64))[0]
    return np.asarray(bent[:, 0])


def _start(points: Floats, weights: Floats) -> Floats:
    """Distances (px) from the circle through three points that fits most others."""
    random = np.random.default_rng(0)
    best, least = np.full(len(points), np.inf), np.inf
    for _ in range(300):
        a, b, c = points[random.choice(len(points), 3, replace=False)]
        matrix = 2 * np.array([b - a, c - a])
        if abs(np.linalg.det(matrix)) < 1e-6:
            continue
        centre = np.linalg.solve(matrix, [b @ b - a @ a, c @ c - a @ a])
        error = np.abs(np.linalg.norm(points - centre, axis=1) - np.linalg.norm(a - centre))
        cost = float((weights * np.minimum(error, 3.0)).sum())
        if cost < least:
            best, least = error, cost
    return best


def _ellipse(points: Floats, weights: Floats) -> Floats:
    """Direct least-squares ellipse (Halir, Flusser 1998), as a conic (3, 3)."""
    middle = np.average(points, axis=0, weights=weights)
    scale = float(np.sqrt(np.average(((points - middle) ** 2).sum(1), weights=weights)))
    x, y = ((points - middle) / scale).T
    root = np.sqrt(weights)[:, None]
    quadratic, linear = np.stack([x * x, x * y, y * y], 1) * root, np.stack([x, y, np.ones_like(x)], 1) * root
    s1, s2, s3 = quadratic.T @ quadratic, quadratic.T @ linear, linear.T @ linear
    back = -np.linalg.solve(s3, s2.T)
    reduced = s1 + s2 @ back
    _, vectors = np.linalg.eig(np.array([reduced[2] / 2, -reduced[1], reduced[0] / 2]))
    vectors = np.real(vectors)
    kind = 4 * vectors[0] * vectors[2] - vectors[1] ** 2
    if not (kind > 0).any():
        raise KernelError("no ellipse fits the points of the outline; pick others, or more")
    top = vectors[:, int(kind.argmax())]
    a, b, c, d, e, f = np.concatenate([top, back @ top])
    conic = np.array([[a, b / 2, d / 2], [b / 2, c, e / 2], [d / 2, e / 2, f]])
    to = np.array([[1 / scale, 0, -middle[0] / scale], [0, 1 / scale, -middle[1] / scale], [0, 0, 1]])
    conic = to.T @ conic @ to
    return np.asarray(conic / np.linalg.norm(conic))


def _cone(points: Floats, weights: Floats, intrinsics: Floats) -> Floats:
    """Conic (3, 3) of the cone of rays u . w = 1, by least squares in w."""
    inverse = np.linalg.inv(intrinsics)
    rays = np.column_stack([points, np.ones(len(points))]) @ inverse.T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    root = np.sqrt(weights)
    w = np.linalg.lstsq(rays * root[:, None], root, rcond=None)[0]
    conic = inverse.T @ (np.outer(w, w) - np.eye(3)) @ inverse
    return np.asarray(conic / np.linalg.norm(conic))


def _distance(conic: Floats, points: Floats) -> Floats:
    """Distance (px) of points to a conic, to first order (Sampson)."""
    homogeneous = np.column_stack([points, np.ones(len(points))])
    image = homogeneous @ conic
    return np.asarray((image * homogeneous).sum(1) / (2 * np.linalg.norm(image[:, :2], axis=1)))


def _geometry(conic: Floats) -> tuple[Floats, Floats, float]:
    """Centre (xy), semi-axes (2) and angle of the first (radians) of an ellipse."""
    shape, linear = conic[:2, :2], conic[:2, 2]
    if np.linalg.det(shape) <= 0:
        raise KernelError("no ellipse fits the points of the outline; pick others, or more")
    centre = -np.linalg.solve(shape, linear)
    values, vectors = np.linalg.eigh(shape)
    axes: Floats = np.sqrt(-(linear @ centre + conic[2, 2]) / values)
    return np.asarray(centre, np.float64), axes, float(np.arctan2(vectors[1, 0], vectors[0, 0]))

"""From a highlight on a mirror ball to the ray that leads to its light, and back.

    L = 2 (N . V) N - V        N = (H - S_c) / R,  V from the highlight H towards the camera
    p = H + s L,   |p| = stage radius        one ball;      sum P_k (p - H_k) / sigma_k^2 = 0,   P_k = I - L_k L_k'
                                             several balls, or one at several places: no radius needed

Must have run before: ball_outline, highlights. Source: Dutta (2010) 3.1.2, whose V has the other sign by a slip.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def light_rays(
    at_px: Floats, centre_mm: Floats, radius_mm: float, intrinsics: Floats, *, distortion: Floats | None = None
) -> tuple[Floats, Floats]:
    """Highlights to rays: where on the ball (light, xyz) mm and unit direction to the light, camera frame.

    NaN rows stay NaN; a highlight outside the ball's outline is taken at its rim, where it must be.
    """
    flat = np.asarray(at_px, np.float64)
    if distortion is not None and np.any(distortion):
        bent = np.asarray(distortion, np.float64)
        flat = np.asarray(cv2.undistortPoints(flat[:, None], intrinsics, bent, P=intrinsics)[:, 0], np.float64)
    view = np.column_stack([flat, np.ones(len(flat))]) @ np.linalg.inv(intrinsics).T
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    along = view @ centre_mm
    under = along**2 - centre_mm @ centre_mm + radius_mm**2
    point = view * (along - np.sqrt(np.maximum(under, 0)))[:, None]
    normal = point - centre_mm
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return point, _mirrored(normal, -view)


def orthographic_directions(at_px: Floats, centre_px: Floats, radius_px: float) -> Floats:
    """Unit directions (light, xyz) to distant lights, x right, y up, z to the camera, which is distant too."""
    x, y = ((at_px - centre_px) / radius_px).T
    normal = np.stack([x, -y, np.sqrt(np.maximum(1 - x * x - y * y, 0))], 1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return _mirrored(normal, np.broadcast_to([0.0, 0.0, 1.0], normal.shape))


def ray_sigma(
    at_px: Floats, sigma_px: Floats, centre_mm: Floats, radius_mm: float, intrinsics: Floats, *,
    distortion: Floats | None = None,
) -> Floats:  # fmt: skip
    """Standard deviation (light) of the direction in radians: hundredths of a pixel are degrees at the rim."""
    ball = intrinsics @ centre_mm
    inward = ball[:2] / ball[2] - at_px
    # infinity, not its first order: at the rim the error is as large as the way to the rim allows
    inward = inward / np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), 1e-9) * sigma_px[:, None]
    _, ray = light_rays(at_px, centre_mm, radius_mm, intrinsics, distortion=distortion)
    _, moved_ray = light_rays(at_px + inward, centre_mm, radius_mm, intrinsics, distortion=distortion)
    return angle(ray, moved_ray)


def to_world(point: Floats, direction: Floats, turn: Floats, t_mm: Floats) -> tuple[Floats, Floats]:
    """Camera frame to world, with X_camera = turn X_world + t."""
    return (point - t_mm) @ turn, direction @ turn


def on_stage(point: Floats, direction: Floats, radius_mm: float) -> Floats:
    """Where rays from inside meet the stage's sphere about the world's origin, (light, xyz) mm."""
    along = (point * direction).sum(1)
    reach = np.sqrt(along**2 - (point**2).sum(1) + radius_mm**2) - along
    return np.asarray(point + direction * reach[:, None])


def triangulate(points: Floats, directions: Floats, sigma_rad: Floats) -> tuple[Floats, Floats]:
    """Positions nearest to the rays of several balls, or of one ball at several places.

    Args:
        points, directions: (ball, light, xyz), world frame, mm and unit; NaN where not seen.
        sigma_rad: (ball, light).

    Returns:
        (light, xyz) mm and their standard deviation (light) in the worst direction; NaN with fewer than two rays.
    """
    count = points.shape[1]
    position, sigma = np.full((count, 3), np.nan), np.full(count, np.nan)
    for k in range(count):
        rays = np.isfinite(directions[:, k, 0])
        if rays.sum() < 2:
            continue
        distance = np.ones(int(rays.sum()))
        # twice: the error across a ray grows with its length, which is known after the first
        for _ in range(2):
            matrix, vector = across_rays(points[rays, k], directions[rays, k], sigma_rad[rays, k] * distance)
            position[k] = np.linalg.solve(matrix, vector)
            distance = np.linalg.norm(position[k] - points[rays, k], axis=1)
        sigma[k] = 1 / np.sqrt(np.linalg.eigvalsh(matrix)[0])
    return position, sigma


def predicted_px(position_mm: Floats, centre_mm: Floats, radius_mm: float, intrinsics: Floats) -> Floats:
    """Where lights at (light, xyz), camera frame, show on the ball: (light, xy) px without lens distortion."""
    to_light = position_mm - centre_mm
    c = -centre_mm / np.linalg.norm(centre_mm)
    far = to_light / np.linalg.norm(to_light, axis=1, keepdims=True)
    side = far - (far @ c)[:, None] * c
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-12)
    low, high = np.zeros(len(far)), np.arccos(np.clip(far @ c, -1, 1))
    for _ in range(60):
        middle = (low + high) / 2
        normal = np.cos(middle)[:, None] * c + np.sin(middle)[:, None] * side
        point = centre_mm + radius_mm * normal
        more = angle(normal, -point) < angle(normal, position_mm - point)
        low, high = np.where(more, middle, low), np.where(more, high, middle)
    image = point @ intrinsics.T
    return np.asarray(image[:, :2] / image[:, 2:])


def _mirrored(normal: Floats, view: Floats) -> Floats:
    return np.asarray(2 * (normal * view).sum(1, keepdims=True) * normal - view)


def across_rays(points: Floats, directions: Floats, sigma_mm: Floats) -> tuple[Floats, Floats]:
    """Sum of P / sigma^2 and of P H / sigma^2 over rays."""
    project = (np.eye(3) - directions[:, :, None] * directions[:, None]) / sigma_mm[:, None, None] ** 2
    return project.sum(0), np.einsum("bij,bj->i", project, points)


def angle(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1)))

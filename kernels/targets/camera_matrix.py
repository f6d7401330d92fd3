"""Camera matrix and lens distortion from pictures of a checkerboard (Zhang 2000, doi:10.1109/34.888718).

    x ~ K distort([R | t] X)        distort: 1 + k1 r² + k2 r⁴ + k3 r⁶, and tangential p1, p2 (OpenCV's order)

OpenCV's calibrateCamera gives the start (focal length only); the estimate is the most probable one given the
corners and what is known of any such lens (`PRIOR`):

    min Σ |x - x̂|² / σ² + Σ (θ_k - θ0_k)² / s_k²

One to three boards determine little: a principal point or a distortion left free swallows the noise, and the focal
length goes with it (one board: f 3 to 45 % wrong). With many boards the priors weigh nothing. Parameters that the
boards say less about than the prior are named in `fixed`.

The other camera behind the beam splitter shares the centre of projection, so its matrix follows from the
homography: x0 ~ H⁻¹ x1 = (H⁻¹ K1) X = (K0 R01) X, an RQ decomposition (Hartley & Zisserman 2004, section 6.2.4).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import rq

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.labels import CAMERA_PARAMETERS

Array = NDArray[np.float64]

PRIOR = {"fy": 0.002, "cx": 0.02, "cy": 0.02, "k1": 0.1, "k2": 0.3, "p1": 0.003, "p2": 0.003, "k3": 1.0}
"""One sigma of what is known without boards: aspect 1 +- 0.2 %, principal point in the middle +- 2 % of the width
(a mounted lens), a lens without much distortion."""
_TOLD = 0.7
"""A parameter counts as told by the boards if its deviation is below this part of its prior one."""


@dataclass(frozen=True)
class CameraFit:
    """Intrinsics of one camera."""

    matrix: Array
    """(3, 3), pixels; (0, 0) is the centre of the top-left pixel."""
    distortion: Array
    """(5,) k1 k2 p1 p2 k3."""
    deviation: dict[str, float]
    """Standard deviation of fx, fy, cx, cy (pixels), k1, k2, p1, p2, k3, prior included."""
    fixed: tuple[str, ...]
    """Parameters that rest on the prior, because these boards cannot tell."""
    residual: Array
    """(picture, row, column, xy) measured - predicted, pixels."""
    rms_px: float
    picture_rms_px: Array
    """(picture,) root mean square distance."""
    rotations: Array
    """(picture, 3, 3) board to camera."""
    translations_mm: Array
    """(picture, 3)."""
    sentence: str


def fit_camera(corners: Sequence[Array], *, square_mm: float, shape: tuple[int, int]) -> CameraFit:
    """Camera matrix from one or more boards.

    Args:
        corners: per picture (row, column, xy), pixels; any order of the corners that is not mirrored.
        square_mm: side of a square; it scales the translations only.
        shape: (rows, columns) of the pictures.

    Raises:
        KernelError: no board, boards of different kinds, or boards seen too nearly frontally.
    """
    if not corners:
        raise KernelError("a camera matrix needs at least one picture of a checkerboard; none is given")
    lattices = {points.shape for points in corners}
    if len(lattices) > 1:
        raise KernelError(f"the pictures show boards of different sizes ({sorted(lattices)}); use one board")
    matrix, distortion, deviation, turns, shifts, residual = _calibrate(corners, square_mm, shape)
    if deviation["fx"] > 0.1 * matrix[0, 0]:
        raise KernelError(
            f"the focal length is {matrix[0, 0]:.0f} +- {deviation['fx']:.0f} px, that is, unknown: the board is "
            "seen too nearly frontally; tilt it by 20 to 40 degrees, about both axes, in three or more pictures"
        )
    squared = (residual**2).sum(-1)
    prior = _priors(matrix[0, 0], shape)
    fixed = tuple(
        name for name, width in zip(CAMERA_PARAMETERS[1:], prior, strict=True) if deviation[name] > _TOLD * width
    )
    sentence = (
        f"f = {matrix[0, 0]:.1f} +- {deviation['fx']:.1f} px from {len(corners)} picture(s), "
        f"{np.sqrt(squared.mean()):.3f} px root mean square"
    )
    if fixed:
        sentence += f"; these boards cannot tell {', '.join(fixed)}, so they stay near {_held(fixed)}"
    return CameraFit(
        matrix=matrix,
        distortion=distortion,
        deviation=deviation,
        fixed=fixed,
        residual=residual,
        rms_px=float(np.sqrt(squared.mean())),
        picture_rms_px=np.sqrt(squared.mean((1, 2))),
        rotations=turns,
        translations_mm=shifts,
        sentence=sentence,
    )


def other_camera(homography: Array, matrix: Array) -> tuple[Array, Array]:
    """Intrinsics of the camera that a homography comes from.

    Args:
        homography: (3, 3) first camera (mount undone) to the reference camera, distortion removed.
        matrix: (3, 3) camera matrix of the reference camera.

    Returns:
        (3, 3) camera matrix of the first camera, last element 1, and (3, 3) rotation from the reference camera's
        frame to its own. A difference of focal length and a turn about the axis separate well; an offset of the
        principal point and a small tilt hardly do: the camera matrix has the first, by the orthogonality of R.
    """
    upper, rotation = rq(np.linalg.inv(homography) @ matrix)
    signs = np.diag(np.sign(np.diag(upper)))
    upper, rotation = upper @ signs, signs @ rotation
    if np.linalg.det(rotation) < 0:
        rotation = -rotation
    return np.asarray(upper / upper[2, 2]), np.asarray(rotation)


_Result = tuple[Array, Array, dict[str, float], Array, Array, Array]


def _calibrate(corners: Sequence[Array], square_mm: float, shape: tuple[int, int]) -> _Result:
    rows, columns = corners[0].shape[:2]
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    # double precision: OpenCV rounds projections of a single-precision board to 3e-5 px, and the fit ends early
    board = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3).astype(np.float64) * square_mm
    measured = [points.reshape(-1, 2) for points in corners]
    middle = (np.array(shape[::-1]) - 1) / 2
    pictures = [points.astype(np.float32)[:, None] for points in measured]
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_FIX_ASPECT_RATIO
    flags |= cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    f = 2.5 * max(shape)
    start = np.array([[f, 0, middle[0]], [0, f, middle[1]], [0, 0, 1]])
    _, start, _, turns, shifts = cv2.calibrateCamera(
        [board.astype(np.float32)] * len(pictures), pictures, shape[::-1], start, np.zeros(5), flags=flags
    )
    # inner parameters: log fx, log fy / fx, cx, cy, k1 k2 p1 p2 k3, then turn and shift of every board
    inner = np.array([np.log(start[0, 0]), 0, *middle, 0, 0, 0, 0, 0])
    prior_value = inner.copy()
    poses = [np.concatenate([np.ravel(turn), np.ravel(shift)]) for turn, shift in zip(turns, shifts, strict=True)]
    noise, damping, best = 0.1, 1e-4, np.inf
    for _ in range(100):
        normal, right, residual, cost, weights = _equations(
            board, measured, inner, poses, prior_value, noise, shape
        )
        if cost <= best * (1 + 1e-12):
            done = best - cost < 1e-9 * cost
            best, damping = cost, max(damping / 10, 1e-12)
            kept = inner, poses, normal, right, residual, weights
            freedom = 2 * residual.shape[0] * residual.shape[1] - 6 * len(poses) - 1
            estimate = max(float(np.sqrt((residual**2).sum() / max(freedom, 1))), 1e-4)
            if done and abs(estimate / noise - 1) < 0.01:
                break
            if done or not np.isfinite(best):
                # another noise weighs the prior anew
                noise, best = estimate, np.inf
                continue
        else:
            damping *= 10
        inner, poses, normal, right, residual, weights = kept
        damped = normal + damping * np.diag(np.diag(normal))
        step = np.linalg.solve(damped, right)
        inner = inner + step[:9]
        poses = [pose + step[9 + 6 * k : 15 + 6 * k] for k, pose in enumerate(poses)]
    inner, poses, normal, _, residual, _ = kept
    matrix, distortion = _unpacked(inner)
    spread = np.linalg.inv(normal)[:9, :9] * noise**2
    scale = np.eye(9)
    scale[0, 0] = matrix[0, 0]
    scale[1, :2] = matrix[1, 1]
    deviation = dict(zip(CAMERA_PARAMETERS, np.sqrt(np.diag(scale @ spread @ scale.T)).tolist(), strict=True))
    rotations = np.stack([cv2.Rodrigues(pose[:3])[0] for pose in poses])
    residual = residual.reshape(len(poses), rows, columns, 2)
    return matrix, distortion, deviation, rotations, np.stack([pose[3:] for pose in poses]), residual


def _unpacked(inner: Array) -> tuple[Array, Array]:
    f = np.exp(inner[0])
    return np.array([[f, 0, inner[2]], [0, f * np.exp(inner[1]), inner[3]], [0, 0, 1]]), inner[4:9]


def _equations(
    board: Array, measured: Sequence[Array], inner: Array, poses: Sequence[Array], prior: Array,
    noise: float, shape: tuple[int, int],
) -> tuple[Array, Array, Array, float, Array]:  # fmt: skip
    """Normal equations (times σ²), residuals (picture, corner, xy) and cost."""
    matrix, distortion = _unpacked(inner)
    size = 9 + 6 * len(poses)
    normal, right = np.zeros((size, size)), np.zeros(size)
    residuals = []
    for k, (points, pose) in enumerate(zip(measured, poses, strict=True)):
        there, by = cv2.projectPoints(board, pose[:3], pose[3:], matrix, distortion)
        error = (points - there.reshape(-1, 2)).ravel()
        own = np.zeros((error.size, 15))
        # OpenCV's columns: turn, shift, fx, fy, cx, cy, distortion; fx and fy both follow the logarithm of f
        own[:, 0] = by[:, 6] * matrix[0, 0] + by[:, 7] * matrix[1, 1]
        own[:, 1] = by[:, 7] * matrix[1, 1]
        own[:, 2:4], own[:, 4:9], own[:, 9:] = by[:, 8:10], by[:, 10:15], by[:, :6]
        where = np.r_[0:9, 9 + 6 * k : 15 + 6 * k]
        normal[np.ix_(where, where)] += own.T @ own
        right[where] += own.T @ error
        residuals.append(error.reshape(-1, 2))
    spread = _priors(np.exp(inner[0]), shape)
    spread[0] = PRIOR["fy"]
    weights = (noise / spread) ** 2
    off = (prior - inner)[1:9]
    normal[np.arange(1, 9), np.arange(1, 9)] += weights
    right[1:9] += weights * off
    residual = np.stack(residuals)
    return normal, right, residual, float((residual**2).sum() + (weights * off**2).sum()), weights


def _priors(f: float, shape: tuple[int, int]) -> Array:
    """Prior deviation of fy, cx, cy (pixels), k1, k2, p1, p2, k3."""
    scale = {"fy": f, "cx": shape[1], "cy": shape[1]}
    return np.array([PRIOR[name] * scale.get(name, 1.0) for name in CAMERA_PARAMETERS[1:]])


def _held(fixed: Sequence[str]) -> str:
    parts = []
    if "cx" in fixed:
        parts.append("the picture's middle")
    if "fy" in fixed:
        parts.append("square pixels")
    if any(name[0] in "kp" for name in fixed):
        parts.append("0")
    return ", ".join(parts)

"""The reference camera from checkerboards: the kernel of `stages/calibration/camera.py`.

The estimate is in `camera_matrix.py`.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.targets.camera_matrix import fit_camera, other_camera
from lightstage.kernels.targets.labels import CAMERA_PARAMETERS
from lightstage.kernels.targets.verdicts import Verdict


def camera(
    points: Mapping[int, NDArray[np.float64]],
    *,
    square_mm: float,
    size: Sequence[int],
    homography: Sequence[Sequence[float]] | None,
) -> Mapping[str, NDArray[Any]]:
    """Intrinsics from all boards.

    Args:
        points: (row, column, xy) by frame, pixels.
        square_mm: side of a square.
        size: (rows, columns) of the pictures, mount undone.
        homography: (3, 3) of the other camera to this one; None when it is not known.

    Returns:
        see the declaration.

    Raises:
        KernelError: boards seen too nearly frontally, or of different kinds.
    """
    boards = [np.asarray(board) for board in points.values()]
    fit = fit_camera(boards, square_mm=square_mm, shape=(size[0], size[1]))
    other = np.full((3, 3), np.nan)
    if homography is not None:
        other, _ = other_camera(np.asarray(homography, float), fit.matrix)
    return {
        "matrix": fit.matrix,
        "distortion": fit.distortion,
        "deviation": np.array([fit.deviation[name] for name in CAMERA_PARAMETERS]),
        "held": np.array([name in fit.fixed for name in CAMERA_PARAMETERS]),
        "points": np.stack(boards),
        "residual": fit.residual,
        "rms_px": np.array(fit.rms_px),
        "other_matrix": other,
    }


def item(
    *, arrays: Mapping[str, Any], attrs: Mapping[str, Any], items: Mapping[str, Mapping[str, Any]]
) -> Mapping[str, Any]:
    """The camera item: the pose of the one that is bound, or straight before the stage."""
    pose = {"R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "t_mm": [0, 0, attrs["parameters"]["distance_mm"]]}
    if "camera" in items:
        pose = {name: items["camera"]["world_to_camera"][name] for name in ("R", "t_mm")}
    return {
        "item": "camera",
        "size_px": [int(length) for length in attrs["size_px"]],
        "K": [[float(v) for v in line] for line in arrays["matrix"]],
        "distortion": [float(v) for v in arrays["distortion"]],
        "world_to_camera": {
            "R": [[float(v) for v in line] for line in pose["R"]],
            "t_mm": [float(v) for v in pose["t_mm"]],
        },
        "residuals": {"rms_px": round(float(arrays["rms_px"]), 4)},
    }


def verdict(
    *, arrays: Mapping[str, Any], labels: Mapping[str, Any], items: Mapping[str, Mapping[str, Any]]
) -> Verdict:
    """How well the camera is known, and what the boards could not tell."""
    matrix, deviation = arrays["matrix"], arrays["deviation"]
    pictures = arrays["residual"].shape[0]
    findings: Verdict = [
        (
            "good",
            f"f = {matrix[0, 0]:.1f} +- {deviation[0]:.1f} px, centre ({matrix[0, 2]:.1f}, {matrix[1, 2]:.1f}) "
            f"from {pictures} picture(s); corners are off by {float(arrays['rms_px']):.3f} px "
            "(root mean square)",
        )
    ]
    held = [name for name, fixed in zip(labels["parameter"], arrays["held"], strict=True) if fixed]
    if held:
        sentence = (
            f"these boards cannot tell {', '.join(held)}: more pictures, tilted and over the whole frame, would"
        )
        findings.append(("doubtful", sentence))
    other = arrays["other_matrix"]
    if np.isfinite(other).all():
        findings.append(("good", f"through the homography, the other camera has f = {other[0, 0]:.1f} px"))
    if "camera" not in items:
        sentence = (
            "the pose is the nominal one: bind the rig's camera item first, or correct world_to_camera by hand"
        )
        findings.append(("doubtful", sentence))
    return findings

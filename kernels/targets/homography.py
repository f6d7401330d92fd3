"""One camera's picture in the other's, from checkerboards: the kernel of `stages/calibration/homography.py`.

The estimate is in `homography_fit.py`, pairs and a forgotten mount in `mount_check.py`; `residual_field.py` says
whether noise, distortion or parallax is left.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.board_corners import Corners
from lightstage.kernels.targets.homography_fit import expected_error_px, fit_homography
from lightstage.kernels.targets.mount_check import check_mount, pair_corners
from lightstage.kernels.targets.residual_field import MATTERS_PX, check_field
from lightstage.kernels.targets.verdicts import Verdict

_CORNER_PX = 0.1
"""What the matrix may be uncertain by in the picture's corners before more boards are asked for."""
_SURE_OF_MOUNT = 1.5
"""The next best mount must be so many times as far off for the boards to tell the two apart."""


def homography(
    points: Mapping[tuple[str, int], NDArray[np.float64]],
    covariance: Mapping[tuple[str, int], NDArray[np.float64]],
    first_is_black: Mapping[tuple[str, int], NDArray[np.bool_]],
    *,
    size: Sequence[int],
    mount: Mapping[str, Any],
    camera: str,
    method: Literal["sampson", "geometric"] = "sampson",
) -> Mapping[str, NDArray[Any]]:
    """One homography for all boards.

    Args:
        points: (row, column, xy) by polarisation and frame, mounts undone: the parallel camera is the first.
        covariance: (row, column, value) of the same.
        first_is_black: () of the same.
        size: (rows, columns) of the first camera's pictures, mount undone.
        mount: rotate and mirror of the first camera, as declared.
        camera: its name, for errors.
        method: sampson or geometric.

    Returns:
        see the declaration.

    Raises:
        KernelError: the declared mount is wrong.
    """
    first, second = (
        [
            Corners(
                np.asarray(points[name]),
                np.asarray(covariance[name]).reshape(*np.shape(covariance[name])[:2], 2, 2),
                np.zeros(np.shape(points[name])[:2]),
                bool(first_is_black[name]),
            )
            for name in points
            if name[0] == polarisation
        ]
        for polarisation in ("parallel", "cross")
    )
    check = check_mount(
        first, second, shape=(size[0], size[1]), rotate=mount["rotate"], mirror=mount["mirror"], camera=camera
    )
    if not check.right:
        raise KernelError(check.sentence)
    a, b, _, _, board = pair_corners(first, second)
    fit = fit_homography(a, b, method=method)
    other = fit_homography(a, b, method="geometric" if method == "sampson" else "sampson")
    field = check_field(fit, a, board.astype(np.int64))
    y, x = np.mgrid[0 : size[0] : 9j, 0 : size[1] : 9j]
    corners = np.stack([x, y], axis=-1).reshape(-1, 2)
    return {
        "matrix": fit.matrix,
        "points": a,
        "residual": fit.residual,
        "board": board.astype(np.int64),
        "smooth": field.smooth,
        "rms_px": np.array(fit.rms_px),
        "sampson_px": np.array(fit.sampson_px if method == "sampson" else other.sampson_px),
        "geometric_px": np.array(other.geometric_px if method == "sampson" else fit.geometric_px),
        "expected_px": np.array(float(expected_error_px(fit, corners).max())),
        "smooth_px": np.array(field.smooth_px),
        "parallax_px": np.array(field.parallax_px),
        "noise_px": np.array(field.noise_px),
        "flags": np.array([field.distorted, field.parallax]),
        "mount_doubt": np.array(check.runner_up),
    }


def item(*, arrays: Mapping[str, Any], facts: Mapping[str, Any]) -> Mapping[str, Any]:
    """The homography item."""
    return {
        "item": "homography",
        "from": facts["cameras"]["parallel"],
        "to": facts["cameras"]["cross"],
        "matrix": [[float(v) for v in line] for line in arrays["matrix"]],
        "residuals": {name: round(float(arrays[name]), 5) for name in ("rms_px", "sampson_px", "geometric_px")},
    }


def verdict(*, arrays: Mapping[str, Any]) -> Verdict:
    """Noise, lens distortion or parallax, and how well the corners of the picture are known."""
    px = {name: float(values) for name, values in arrays.items() if values.ndim == 0}
    boards = int(arrays["board"].max()) + 1
    distorted, parallax = (bool(v) for v in arrays["flags"])
    findings: Verdict = []
    if parallax:
        sentence = (
            f"the boards disagree by {px['parallax_px']:.2f} px above the noise of {px['noise_px']:.3f} px: "
            "parallax; the cameras' centres do not coincide, so the homography holds only near the boards' depth"
        )
        findings.append(("doubtful", sentence))
    elif distorted:
        sentence = (
            f"a smooth residual of {px['smooth_px']:.2f} px remains above the noise of {px['noise_px']:.3f} px: "
            "the cameras' lenses distort differently; a homography cannot follow it"
        )
        findings.append(("doubtful", sentence))
    else:
        sentence = (
            f"the residuals are noise ({px['rms_px']:.3f} px; more than {MATTERS_PX:g} px of anything smooth would "
            f"be said): one homography holds where the {boards} board(s) were"
        )
        findings.append(("good", sentence))
    if boards == 1:
        sentence = "one board cannot show parallax: add one at another depth and tilt"
        findings.append(("doubtful", sentence))
    errors = (
        f"Sampson error {px['sampson_px']:.4f} px, geometric error {px['geometric_px']:.4f} px; expected error in "
        f"the picture's corners up to {px['expected_px']:.3f} px"
    )
    if px["expected_px"] > _CORNER_PX:
        findings.append(("doubtful", f"{errors}: put boards nearer to the corners"))
    else:
        findings.append(("good", errors))
    if px["mount_doubt"] < _SURE_OF_MOUNT:
        sentence = (
            "another mount of the first camera fits nearly as well: put the board nearer to the picture's edge"
        )
        findings.append(("doubtful", sentence))
    return findings

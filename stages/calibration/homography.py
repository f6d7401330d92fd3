"""homography: where a point of one camera's picture lies in the other's, from checkerboards.

The kernels are in `homography_fit.py` (estimate), `mount_check.py` (pairs, and a forgotten mount) and
`residual_field.py` (noise, distortion or parallax).

Must have run before: corners. Sources: Hartley & Zisserman (2004), and those of the kernels.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lightstage.dag.stage import (
    Arrangement,
    Finding,
    Grid,
    Group,
    Input,
    Items,
    Output,
    Params,
    Result,
    Stage,
    StageError,
)
from lightstage.kernels.targets.board_corners import Corners
from lightstage.kernels.targets.homography_fit import expected_error_px, fit_homography
from lightstage.kernels.targets.mount_check import check_mount, pair_corners
from lightstage.kernels.targets.residual_field import MATTERS_PX, check_field
from lightstage.stages.calibration.session import need_target

_CORNER_PX = 0.1
"""What the matrix may be uncertain by in the picture's corners before more boards are asked for."""


class HomographyParams(Params):
    """Parameters of `homography`."""

    method: Literal["sampson", "geometric"] = Field(
        "sampson", description="the error that is minimised; both end alike, Sampson's is cheaper"
    )


def homography(
    points: Sequence[NDArray[np.float64]],
    covariance: Sequence[NDArray[np.float64]],
    first_is_black: Sequence[NDArray[np.bool_]],
    *,
    size: Sequence[int],
    mount: Mapping[str, Any],
    camera: str,
    method: Literal["sampson", "geometric"] = "sampson",
) -> Mapping[str, NDArray[Any]]:
    """One homography for all boards.

    Args:
        points: (row, column, xy): all boards of the first camera, then all of the second, mounts undone.
        covariance: (row, column, value) of the same.
        first_is_black: () of the same.
        size: (rows, columns) of the first camera's pictures, mount undone.
        mount: rotate and mirror of the first camera, as declared.
        camera: its name, for errors.
        method: sampson or geometric.

    Returns:
        see the declaration.

    Raises:
        StageError: the declared mount is wrong.
    """
    found = [
        Corners(np.asarray(p), np.asarray(c).reshape(*np.shape(c)[:2], 2, 2), np.zeros(np.shape(p)[:2]), bool(b))
        for p, c, b in zip(points, covariance, first_is_black, strict=True)
    ]
    half = len(found) // 2
    first, second = found[:half], found[half:]
    check = check_mount(
        first, second, shape=(size[0], size[1]), rotate=mount["rotate"], mirror=mount["mirror"], camera=camera
    )
    if not check.right:
        raise StageError(check.sentence)
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


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: HomographyParams) -> Arrangement:
    (found,) = grids
    need_target(facts, "checkerboard", "measuring the homography")
    cameras = list(found.along("polarisation"))
    if cameras != ["parallel", "cross"]:
        raise StageError(
            f"measuring the homography needs boards seen by the parallel and the cross camera; this capture has "
            f"{', '.join(cameras)}"
        )
    frames = found.sizes["frame"]
    pieces = [{"frame": i, "polarisation": p} for p in (0, 1) for i in range(frames)]
    corners = frames * found.sizes["row"] * found.sizes["column"]
    sizes = {"all": 1, "line": 3, "entry": 3, "corner": corners, "xy": 2, "flag": 2}
    reads = dict.fromkeys(("points", "covariance", "first_is_black"), pieces)
    return Arrangement(Grid(sizes, {}), (Group(reads, {"boards": frames}),))


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: HomographyParams
) -> Mapping[str, Any]:
    name = facts["cameras"]["parallel"]
    mount = facts["mount"].get(name, {"rotate": 0, "mirror": False})
    rows, columns = facts["shape"]
    turned = mount["rotate"] in (90, 270)
    return {"size": [columns, rows] if turned else [rows, columns], "mount": mount, "camera": name}


def _item(result: Result) -> Mapping[str, Any]:
    """The homography item."""
    return {
        "item": "homography",
        "from": result.facts["cameras"]["parallel"],
        "to": result.facts["cameras"]["cross"],
        "matrix": [[float(v) for v in line] for line in result.arrays["matrix"]],
        "residuals": {
            name: round(float(result.arrays[name]), 5) for name in ("rms_px", "sampson_px", "geometric_px")
        },
    }


def _verdict(result: Result) -> list[Finding]:
    a = {name: float(result.arrays[name]) for name in result.arrays if result.arrays[name].ndim == 0}
    boards = int(result.arrays["board"].max()) + 1
    distorted, parallax = (bool(v) for v in result.arrays["flags"])
    findings = []
    if parallax:
        sentence = (
            f"the boards disagree by {a['parallax_px']:.2f} px above the noise of {a['noise_px']:.3f} px: "
            "parallax; the cameras' centres do not coincide, so the homography holds only near the boards' depth"
        )
        findings.append(Finding("doubtful", sentence))
    elif distorted:
        sentence = (
            f"a smooth residual of {a['smooth_px']:.2f} px remains above the noise of {a['noise_px']:.3f} px: the "
            "cameras' lenses distort differently; a homography cannot follow it"
        )
        findings.append(Finding("doubtful", sentence))
    else:
        sentence = (
            f"the residuals are noise ({a['rms_px']:.3f} px; more than {MATTERS_PX:g} px of anything smooth would "
            f"be said): one homography holds where the {boards} board(s) were"
        )
        findings.append(Finding("good", sentence))
    if boards == 1:
        sentence = "one board cannot show parallax: add one at another depth and tilt"
        findings.append(Finding("doubtful", sentence))
    errors = (
        f"Sampson error {a['sampson_px']:.4f} px, geometric error {a['geometric_px']:.4f} px; expected error in "
        f"the picture's corners up to {a['expected_px']:.3f} px"
    )
    if a["expected_px"] > _CORNER_PX:
        findings.append(Finding("doubtful", f"{errors}: put boards nearer to the corners"))
    else:
        findings.append(Finding("good", errors))
    if a["mount_doubt"] < 1.5:
        sentence = (
            "another mount of the first camera fits nearly as well: put the board nearer to the picture's edge"
        )
        findings.append(Finding("doubtful", sentence))
    return findings


STAGE = Stage(
    name="homography",
    version=1,
    summary="one camera's picture in the other's",
    params=HomographyParams,
    inputs={
        "points": Input("points", ("frame", "polarisation", "row", "column", "xy"), "group"),
        "covariance": Input("covariance", ("frame", "polarisation", "row", "column", "value"), "group"),
        "first_is_black": Input("first_is_black", ("frame", "polarisation"), "group"),
    },
    outputs={
        "matrix": Output(("all", "line", "entry"), "float64", ("line", "entry")),
        "points": Output(("all", "corner", "xy"), "float64", ("corner", "xy"), {"units": "pixel"}),
        "residual": Output(("all", "corner", "xy"), "float64", ("corner", "xy"), {"units": "pixel"}),
        "smooth": Output(("all", "corner", "xy"), "float64", ("corner", "xy"), {"units": "pixel"}),
        "board": Output(("all", "corner"), "int64", ("corner",)),
        **{
            name: Output(("all",), "float64", (), {"units": "pixel"})
            for name in (
                "rms_px",
                "sampson_px",
                "geometric_px",
                "expected_px",
                "smooth_px",
                "parallax_px",
                "noise_px",
                "mount_doubt",
            )
        },
        "flags": Output(("all", "flag"), "bool", ("flag",), {"meanings": "distorted parallax"}),
    },
    blocks=("all",),
    arrange=_arrange,
    context=_context,
    prepared=("size", "mount", "camera"),
    kernel=homography,
    item=_item,
    verdict=_verdict,
)

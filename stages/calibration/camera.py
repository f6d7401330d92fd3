"""camera: intrinsics of the reference camera from pictures of a checkerboard.

The kernel is in `camera_matrix.py`. Where the camera stands to the stage a board does not tell: the pose of the
camera item that is bound is kept, or the nominal one is written (straight before the stage, `distance_mm` away).

Must have run before: corners. Source: Zhang (2000), and those of the kernel.
"""

from collections.abc import Mapping, Sequence
from typing import Any

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
    Needs,
    Output,
    Params,
    Result,
    Stage,
)
from lightstage.kernels.targets.camera_matrix import NAMES, fit_camera, other_camera
from lightstage.stages.calibration.session import need_target, reference


class CameraParams(Params):
    """Parameters of `camera`."""

    distance_mm: float = Field(890.0, gt=0, description="nominal way from the camera to the stage's centre")


def camera(
    points: Sequence[NDArray[np.float64]], *, square_mm: float, size: Sequence[int], homography: Any
) -> Mapping[str, NDArray[Any]]:
    """Intrinsics from all boards.

    Args:
        points: per picture (row, column, xy), pixels.
        square_mm: side of a square.
        size: (rows, columns) of the pictures, mount undone.
        homography: (3, 3) of the other camera to this one; None when it is not known.

    Returns:
        see the declaration.

    Raises:
        StageError: boards seen too nearly frontally, or of different kinds.
    """
    fit = fit_camera([np.asarray(p) for p in points], square_mm=square_mm, shape=(size[0], size[1]))
    other = np.full((3, 3), np.nan)
    if homography is not None:
        other, _ = other_camera(np.asarray(homography, float), fit.matrix)
    return {
        "matrix": fit.matrix,
        "distortion": fit.distortion,
        "deviation": np.array([fit.deviation[name] for name in NAMES]),
        "held": np.array([name in fit.fixed for name in NAMES]),
        "points": np.stack([np.asarray(p) for p in points]),
        "residual": fit.residual,
        "rms_px": np.array(fit.rms_px),
        "other_matrix": other,
    }


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: CameraParams) -> Arrangement:
    (found,) = grids
    need_target(facts, "checkerboard", "measuring the camera")
    which = reference(found)
    frames = found.sizes["frame"]
    sizes = {
        "all": 1, "picture": frames, "line": 3, "entry": 3, "coefficient": 5, "parameter": len(NAMES),
        "row": found.sizes["row"], "column": found.sizes["column"], "xy": 2,
    }  # fmt: skip
    pieces = [{"frame": i, "polarisation": which} for i in range(frames)]
    labels = {"parameter": (("parameter",), list(NAMES))}
    return Arrangement(Grid(sizes, labels), (Group({"points": pieces}, {}),))


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: CameraParams
) -> Mapping[str, Any]:
    return {
        "square_mm": facts["target"]["square_mm"],
        "size": list(upright_shape(facts)),
        "homography": items["homography"]["matrix"] if "homography" in items else None,
    }


def upright_shape(facts: Mapping[str, Any]) -> tuple[int, int]:
    """(rows, columns) of the reference camera's pictures, mount undone."""
    rows, columns = facts["shape"]
    name = facts["cameras"].get("cross") or next(iter(facts["cameras"].values()))
    turned = facts["mount"].get(name, {"rotate": 0})["rotate"] in (90, 270)
    return (columns, rows) if turned else (rows, columns)


def _item(result: Result) -> Mapping[str, Any]:
    """The camera item."""
    rows, columns = upright_shape(result.facts)
    pose = {"R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "t_mm": [0, 0, result.attrs["parameters"]["distance_mm"]]}
    if "camera" in result.items:
        pose = {name: result.items["camera"]["world_to_camera"][name] for name in ("R", "t_mm")}
    return {
        "item": "camera",
        "size_px": [columns, rows],
        "K": [[float(v) for v in line] for line in result.arrays["matrix"]],
        "distortion": [float(v) for v in result.arrays["distortion"]],
        "world_to_camera": {
            "R": [[float(v) for v in r] for r in pose["R"]],
            "t_mm": [float(v) for v in pose["t_mm"]],
        },
        "residuals": {"rms_px": round(float(result.arrays["rms_px"]), 4)},
    }


def _verdict(result: Result) -> list[Finding]:
    matrix, deviation = result.arrays["matrix"], result.arrays["deviation"]
    names = list(result.labels["parameter"])
    pictures = result.arrays["residual"].shape[0]
    findings = [
        Finding(
            "good",
            f"f = {matrix[0, 0]:.1f} +- {deviation[0]:.1f} px, centre ({matrix[0, 2]:.1f}, {matrix[1, 2]:.1f}) "
            f"from {pictures} picture(s); corners are off by {float(result.arrays['rms_px']):.3f} px "
            "(root mean square)",
        )
    ]
    held = [name for name, fixed in zip(names, result.arrays["held"], strict=True) if fixed]
    if held:
        sentence = (
            f"these boards cannot tell {', '.join(held)}: more pictures, tilted and over the whole frame, would"
        )
        findings.append(Finding("doubtful", sentence))
    other = result.arrays["other_matrix"]
    if np.isfinite(other).all():
        findings.append(Finding("good", f"through the homography, the other camera has f = {other[0, 0]:.1f} px"))
    if "camera" not in result.items:
        sentence = (
            "the pose is the nominal one: bind the rig's camera item first, or correct world_to_camera by hand"
        )
        findings.append(Finding("doubtful", sentence))
    return findings


STAGE = Stage(
    name="camera",
    version=1,
    summary="the reference camera from checkerboards",
    params=CameraParams,
    inputs={"points": Input("points", ("frame", "polarisation", "row", "column", "xy"), "group")},
    calibration={"homography": Needs(why="nothing is said of the other camera")},
    outputs={
        "matrix": Output(("all", "line", "entry"), "float64", ("line", "entry"), {"units": "pixel"}),
        "distortion": Output(("all", "coefficient"), "float64", ("coefficient",)),
        "deviation": Output(("all", "parameter"), "float64", ("parameter",)),
        "held": Output(("all", "parameter"), "bool", ("parameter",)),
        "points": Output(
            ("all", "picture", "row", "column", "xy"),
            "float64",
            ("picture", "row", "column", "xy"),
            {"units": "pixel"},
        ),
        "residual": Output(
            ("all", "picture", "row", "column", "xy"),
            "float64",
            ("picture", "row", "column", "xy"),
            {"units": "pixel"},
        ),
        "rms_px": Output(("all",), "float64", (), {"units": "pixel"}),
        "other_matrix": Output(("all", "line", "entry"), "float64", ("line", "entry"), {"units": "pixel"}),
    },
    blocks=("all",),
    arrange=_arrange,
    context=_context,
    prepared=("square_mm", "size", "homography"),
    kernel=camera,
    item=_item,
    verdict=_verdict,
)

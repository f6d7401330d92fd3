"""register: both cameras as signal on the cross camera's grid.

    response = (flat - dark) / F          signal = (raw - dark) / response

dark and flat are as stored, in sensor orientation. F is ONE constant for both cameras, the smoothed maximum
of the reference camera's flat - dark: the cameras' relative gain is in their flats, and the split subtracts
one camera from the other. Then mount and homography together move each pixel once (Keys' cubic convolution,
`resampling.py`). The reference camera is not resampled at all.

Must have run before: capture. Limits: one homography for the whole picture, so parallax between the cameras
stays; hot pixels are not interpolated.

Source: Dutta (2010) 3.2.3; Hartley & Zisserman (2004) for the homography's convention.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import Field

from lightstage.dag.stage import Arrangement, Grid, Input, Items, Needs, Output, Params, Stage, StageError
from lightstage.hw.cameras import reference_camera
from lightstage.kernels.encodings import SIGNAL_STEP


class RegisterParams(Params):
    """Parameters of `register`."""

    flat_smoothing_percent: float = Field(
        2.0,
        gt=0,
        le=25,
        description="sigma of the smoothing before the flat's maximum, in percent of the width",
    )


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: RegisterParams
) -> Mapping[str, Any]:
    cameras = [facts["cameras"][polarisation] for polarisation in facts["polarisation"]]
    reference = reference_camera(facts["cameras"])
    plain_mount = {"rotate": 0, "mirror": False}
    return {
        "cameras": cameras,
        "reference": reference,
        "mounts": {camera: facts["mount"].get(camera, plain_mount) for camera in cameras},
        "shape": list(facts["shape"]),
        "white_level": facts["white_level"],
        "dark": _slice(items, "dark", ("scale",), cameras),
        "flat": _slice(items, "flat", ("scale", "dark_included"), cameras),
        "homography": _homography(items, cameras, reference),
    }


def _slice(items: Items, kind: str, values: Sequence[str], cameras: Sequence[str]) -> Mapping[str, Any] | None:
    """Only the cameras of this session: a picture of another camera cannot change the result."""
    item = items.get(kind)
    if item is None:
        return None
    missing = [camera for camera in cameras if camera not in item["pictures"]]
    if missing:
        raise StageError(f"the {kind} item has no picture of {missing[0]} (it has {', '.join(item['pictures'])})")
    return {name: item[name] for name in values} | {"pictures": {c: item["pictures"][c] for c in cameras}}


def _homography(items: Items, cameras: Sequence[str], reference: str) -> list[list[float]] | None:
    if len(cameras) == 1:
        return None
    (other,) = [camera for camera in cameras if camera != reference]
    item = items.get("homography")
    if item is None:
        raise StageError(
            f"the session has two cameras and no homography item; {other} cannot be brought to {reference}'s grid "
            "(bind one with `lightstage calibration use FILE --session S`)"
        )
    matrix = item["matrix"]
    if (item["from"], item["to"]) == (reference, other):
        matrix = _adjugate(matrix)
    elif (item["from"], item["to"]) != (other, reference):
        raise StageError(
            f"the homography goes from {item['from']} to {item['to']}; one from {other} to {reference} is needed"
        )
    # one scale for equal maps; a map that sends the origin to infinity has a 0 in that place
    largest = max(abs(value) for row in matrix for value in row)
    corner = matrix[2][2]
    scale = corner if abs(corner) > 1e-9 * largest else largest
    return [[value / scale + 0.0 for value in row] for row in matrix]  # no -0, which would be another text


def _adjugate(m: Sequence[Sequence[float]]) -> list[list[float]]:
    """The inverse but for its scale, (3, 3)."""
    return [
        [
            m[(j + 1) % 3][(i + 1) % 3] * m[(j + 2) % 3][(i + 2) % 3]
            - m[(j + 1) % 3][(i + 2) % 3] * m[(j + 2) % 3][(i + 1) % 3]
            for j in range(3)
        ]
        for i in range(3)
    ]


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: RegisterParams) -> Arrangement:
    (raw,) = grids
    reference = reference_camera(facts["cameras"])
    turned = facts["mount"].get(reference, {}).get("rotate", 0) in (90, 270)
    y, x = raw.sizes["y"], raw.sizes["x"]
    sizes = dict(raw.sizes) | ({"y": x, "x": y} if turned else {})
    return Arrangement(Grid(sizes, raw.labels, {"units": "counts", "reference_camera": reference}))


STAGE = Stage(
    name="register",
    version=1,
    summary="dark, flat, and both cameras on one grid",
    params=RegisterParams,
    inputs={"raw": Input("raw", ("frame", "band", "polarisation", "y", "x"))},
    calibration={
        "dark": Needs(why="the sensor's offset stays in the signal"),
        "flat": Needs(why="vignetting and the cameras' relative gain stay in the signal"),
        "homography": Needs(why="a second camera cannot be registered"),
    },
    outputs={
        "signal": Output(
            ("frame", "band", "polarisation", "y", "x"),
            "float32",
            attrs={"units": "counts", "rounded_to": SIGNAL_STEP},
        ),
        "valid": Output(("frame", "band", "y", "x"), "bool"),
    },
    blocks=("frame", "band"),
    arrange=_arrange,
    context=_context,
    prepare="lightstage.kernels.pictures.registration:prepare",
    prepared=("views", "grid", "white_level"),
    kernel="lightstage.kernels.pictures.registration:register",
)

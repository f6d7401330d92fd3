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
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lightstage.dag.stage import Arrangement, Grid, Input, Items, Needs, Output, Params, Stage, StageError
from lightstage.kernels.pictures.resampling import STEP, correct, reorient, undone_shape, view_fraction, warp

_BRIGHTEST_DARK = 0.9
"""Of the white level: with less than a tenth of the range left nothing can be measured."""


class RegisterParams(Params):
    """Parameters of `register`."""

    flat_smoothing_percent: float = Field(
        2.0,
        gt=0,
        le=25,
        description="sigma of the smoothing before the flat's maximum, in percent of the width",
    )


class View(NamedTuple):
    """What one camera needs to be brought to the reference grid."""

    dark: NDArray[np.float32]
    """(y, x), counts."""
    gain: NDArray[np.float32]
    """(y, x), 1 / response."""
    rotate: int
    mirror: bool
    to_source: NDArray[np.float64] | None
    """(3, 3) reference pixel to this camera's, mount undone; None for the reference camera, which only turns."""


def register(
    raw: NDArray[np.uint16], *, views: Sequence[View], grid: tuple[int, int], white_level: int
) -> Mapping[str, Any]:
    """Bring the pictures of one frame and band to the reference grid.

    Args:
        raw: (polarisation, y, x), counts.
        views: one per polarisation.
        grid: rows and columns of the reference grid.
        white_level: the count at which the sensor saturates.

    Returns:
        `signal` (polarisation, y, x) float32, counts of a sensor with a response of 1; NaN where that camera
        saturated or did not see the point. `valid` (y, x): every camera saw the point and none saturated.
    """
    signal = np.empty((len(views), *grid), np.float32)
    for picture, view, out in zip(raw, views, signal, strict=True):
        corrected = correct(picture, view.dark, view.gain, white_level)
        # turning moves whole pixels and changes none; the homography is the one resampling
        turned = reorient(corrected, view.rotate, view.mirror)
        out[...] = turned if view.to_source is None else warp(turned, view.to_source, *grid)
    # NaN is the only value that is not equal to itself
    valid = signal[0] == signal[0]
    for other in signal[1:]:
        valid &= other == other
    return {"signal": signal, "valid": valid}


def _prepare(
    *,
    cameras: Sequence[str],
    reference: str,
    mounts: Mapping[str, Mapping[str, Any]],
    shape: Sequence[int],
    white_level: int,
    dark: Mapping[str, Any] | None,
    flat: Mapping[str, Any] | None,
    homography: Sequence[Sequence[float]] | None,
    flat_smoothing_percent: float,
) -> Mapping[str, Any]:
    size = (int(shape[0]), int(shape[1]))
    darks = {camera: _dark(camera, dark, size, white_level) for camera in cameras}
    gains = _gains(cameras, reference, darks, flat, size, flat_smoothing_percent)
    grid = undone_shape(mounts[reference]["rotate"], size)
    views = []
    for camera in cameras:
        rotate, mirror = mounts[camera]["rotate"], mounts[camera]["mirror"]
        to_source = None
        if camera != reference:
            undone = undone_shape(rotate, size)
            to_source = np.linalg.inv(np.asarray(homography, float))
            seen = view_fraction(to_source, undone, grid)
            if seen < 0.1:
                raise StageError(
                    f"the homography puts {camera} out of view: it covers {seen:.0%} of {reference}'s picture; "
                    f"measure it again, with the mount undone ({undone[1]} x {undone[0]})"
                )
        views.append(View(darks[camera], gains[camera], rotate, mirror, to_source))
    return {"views": tuple(views), "grid": grid, "white_level": white_level}


def _picture(kind: str, camera: str, item: Mapping[str, Any], size: tuple[int, int]) -> NDArray[np.float32]:
    pixels = np.asarray(item["pictures"][camera].load())
    if pixels.shape != size:
        raise StageError(
            f"the {kind} of {camera} is {pixels.shape[1]} x {pixels.shape[0]}; "
            f"the pictures are {size[1]} x {size[0]}"
        )
    return np.asarray(pixels / item["scale"], np.float32)


def _dark(
    camera: str, item: Mapping[str, Any] | None, size: tuple[int, int], white_level: int
) -> NDArray[np.float32]:
    if item is None:
        return np.zeros(size, np.float32)
    dark = _picture("dark", camera, item, size)
    level = float(np.median(dark))
    if level >= _BRIGHTEST_DARK * white_level:
        raise StageError(
            f"the dark of {camera} is at {level:.0f} of {white_level} counts, so it leaves no room for light; "
            "capture it again with the lens covered, or set its scale right"
        )
    return dark


def _gains(
    cameras: Sequence[str],
    reference: str,
    darks: Mapping[str, NDArray[np.float32]],
    item: Mapping[str, Any] | None,
    size: tuple[int, int],
    smoothing_percent: float,
) -> dict[str, NDArray[np.float32]]:
    if item is None:
        return {camera: np.ones(size, np.float32) for camera in cameras}
    lit = {}
    for camera in cameras:
        flat = _picture("flat", camera, item, size)
        lit[camera] = flat - darks[camera] if item["dark_included"] else flat
        wrong = ~(lit[camera] > 0)
        if wrong.any():
            y, x = np.argwhere(wrong)[0]
            raise StageError(
                f"the flat of {camera} is not above its dark at {int(wrong.sum())} pixel(s), the first at "
                f"x={x}, y={y}; a flat must show light everywhere: capture it again, or set dark_included right"
            )
    sigma = smoothing_percent / 100 * size[1]
    # in float64: a last bit of the blur would be one of every gain
    scale = float(cv2.GaussianBlur(lit[reference].astype(np.float64), (0, 0), sigma).max())
    return {camera: (scale / values).astype(np.float32) for camera, values in lit.items()}


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: RegisterParams
) -> Mapping[str, Any]:
    cameras = [facts["cameras"][polarisation] for polarisation in facts["polarisation"]]
    reference = facts["cameras"].get("cross", cameras[0])
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
    matrix = np.asarray(item["matrix"], float)
    if (item["from"], item["to"]) == (reference, other):
        matrix = np.linalg.inv(matrix)
    elif (item["from"], item["to"]) != (other, reference):
        raise StageError(
            f"the homography goes from {item['from']} to {item['to']}; one from {other} to {reference} is needed"
        )
    # one scale for equal maps; a map that sends the origin to infinity has a 0 in that place
    largest = np.abs(matrix).max()
    scale = matrix[2, 2] if abs(matrix[2, 2]) > 1e-9 * largest else largest
    return [[float(value) for value in row] for row in matrix / scale]


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: RegisterParams) -> Arrangement:
    (raw,) = grids
    cameras = facts["cameras"]
    reference = cameras.get("cross", next(iter(cameras.values())))
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
            ("frame", "band", "polarisation", "y", "x"), "float32", attrs={"units": "counts", "rounded_to": STEP}
        ),
        "valid": Output(("frame", "band", "y", "x"), "bool"),
    },
    blocks=("frame", "band"),
    arrange=_arrange,
    context=_context,
    prepare=_prepare,
    prepared=("views", "grid", "white_level"),
    kernel=register,
)

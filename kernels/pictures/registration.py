"""Both cameras on one grid: the equations are in `stages/register.py`, the resampling in `resampling.py`.

Source: Dutta (2010) 3.2.3; Hartley & Zisserman (2004) for the homography's convention.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError
from lightstage.kernels.pictures.resampling import correct, reorient, undone_shape, view_fraction, warp

_BRIGHTEST_DARK = 0.9
"""Of the white level: with less than a tenth of the range left nothing can be measured."""


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


def prepare(
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
                raise KernelError(
                    f"the homography puts {camera} out of view: it covers {seen:.0%} of {reference}'s picture; "
                    f"measure it again, with the mount undone ({undone[1]} x {undone[0]})"
                )
        views.append(View(darks[camera], gains[camera], rotate, mirror, to_source))
    return {"views": tuple(views), "grid": grid, "white_level": white_level}


def _picture(kind: str, camera: str, item: Mapping[str, Any], size: tuple[int, int]) -> NDArray[np.float32]:
    pixels = np.asarray(item["pictures"][camera].load())
    if pixels.shape != size:
        raise KernelError(
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
        raise KernelError(
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
            raise KernelError(
                f"the flat of {camera} is not above its dark at {int(wrong.sum())} pixel(s), the first at "
                f"x={x}, y={y}; a flat must show light everywhere: capture it again, or set dark_included right"
            )
    sigma = smoothing_percent / 100 * size[1]
    # in float64: a last bit of the blur would be one of every gain
    scale = float(cv2.GaussianBlur(lit[reference].astype(np.float64), (0, 0), sigma).max())
    return {camera: (scale / values).astype(np.float32) for camera, values in lit.items()}

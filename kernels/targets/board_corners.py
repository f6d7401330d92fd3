"""Inner corners of a checkerboard in one picture, to a few hundredths of a pixel.

OpenCV's sector-based detector finds the lattice; `corner_fit.py` measures each corner on it.

Limits: all inner corners are in the picture and uncovered, with some paper around the outer squares. Pixel (0, 0)
is the centre of the top-left pixel.

Source: Duda & Frese (2018), Accurate detection and localization of checkerboard corners for calibration, BMVC.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.corner_fit import refine_corners

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Corners:
    """The inner corners of one board."""

    points: Array
    """(row, column, xy), pixels. Rows and columns run so that x then y turn as in the picture (clockwise seen),
    and the columns run as nearly to the right as this allows."""
    covariance: Array
    """(row, column, 2, 2), pixels squared, from the fit's own residuals."""
    blur_px: Array
    """(row, column) sigma of the edges; the lens alone; 0.1, the least, is a perfectly sharp picture."""
    first_is_black: bool
    """Whether the square before the first corner (the outer one of the board's first corner) is black."""


def undo_mount(image: NDArray[Any], *, rotate: int, mirror: bool) -> NDArray[Any]:
    """The picture (y, x) with its mount undone: turned clockwise by `rotate` degrees, then mirrored left-right."""
    turned = np.rot90(image, k=-(rotate // 90))
    return np.ascontiguousarray(turned[:, ::-1] if mirror else turned)


def undo_mount_points(points: Array, shape: tuple[int, int], *, rotate: int, mirror: bool) -> Array:
    """Pixel positions (..., xy) of a picture of `shape` (rows, columns), as `undo_mount` moves them."""
    rows, columns = shape
    x, y = points[..., 0], points[..., 1]
    x, y = {
        0: (x, y),
        90: (rows - 1 - y, x),
        180: (columns - 1 - x, rows - 1 - y),
        270: (y, columns - 1 - x),
    }[rotate % 360]
    width = rows if rotate in (90, 270) else columns
    return np.stack([width - 1 - x if mirror else x, y], -1)


def find_corners(
    image: NDArray[Any],
    *,
    inner_corners: tuple[int, int],
    white_level: int | None = None,
    camera: str = "the picture",
) -> Corners:
    """Find a board and measure its inner corners.

    Args:
        image: (y, x), linear counts of any range; its mount may be undone or not.
        inner_corners: inner corners along the board's two sides, as (columns, rows).
        white_level: the count at which the sensor saturates; None if that is not known.
        camera: what to call the picture in an error.

    Raises:
        KernelError: no board is found, it leaves the frame, or it has another number of corners.
    """
    columns, rows = inner_corners
    if min(inner_corners) < 3:
        raise KernelError(f"a board of {columns} x {rows} inner corners is too small; 3 x 3 are the least")
    start = _detect(image, inner_corners)
    if start is not None:
        start = _without_false_line(np.asarray(image, float), start, inner_corners)
    if start is None or sorted(start.shape[:2]) != sorted(inner_corners):
        raise KernelError(_why_not(image, start, inner_corners, camera))
    if start.shape[:2] != (rows, columns):
        start = np.swapaxes(start, 0, 1)
    lattice = upright(start)
    points, covariance, blur = refine_corners(np.asarray(image, float), lattice)
    step = np.linalg.norm(np.diff(points, axis=1), axis=-1).min()
    moved = np.linalg.norm(points - lattice, axis=-1)
    if not np.isfinite(points).all() or moved.max() > max(1.0, 0.2 * step):
        y, x = np.unravel_index(int(np.nan_to_num(moved, nan=np.inf).argmax()), moved.shape)
        raise KernelError(
            f"{camera}: corner {x},{y} of the board is not a clean crossing near x={lattice[y, x, 0]:.0f}, "
            f"y={lattice[y, x, 1]:.0f}; keep reflections and fingers off the board and the picture in focus"
        )
    bright = float(np.percentile(_squares(np.asarray(image, float), points), 75))
    if white_level is not None and bright >= white_level:
        raise KernelError(
            f"{camera}: the board's white squares saturate (at {white_level}), which moves its edges by up to a "
            "quarter of a pixel; expose less"
        )
    return Corners(points, covariance, blur, _first_is_black(np.asarray(image, float), points))


def _eight_bits(image: NDArray[Any]) -> list[NDArray[np.uint8]]:
    """Counts to 8 bits for the detector: as they are, and their square root for dark pictures.

    The range runs from 1 % to 99.9 % of the picture, so that hot pixels and glints do not set it. Never
    CALIB_CB_NORMALIZE_IMAGE: where most of the picture is black it spreads the noise over the whole range.
    """
    low, high = np.percentile(image, [1, 99.9])
    unit = np.clip((image.astype(np.float64) - low) / max(high - low, 1e-9), 0, 1)
    return [np.asarray(np.round(values * 255), np.uint8) for values in (unit, np.sqrt(unit))]


def _detect(image: NDArray[Any], inner_corners: tuple[int, int]) -> Array | None:
    """The lattice (row, column, xy) to half a pixel, this large or larger, or None; the cheap search first."""
    linear, root = _eight_bits(image)
    for picture, factor, flags in (
        (linear, 1, 0),
        (linear, 1, cv2.CALIB_CB_EXHAUSTIVE),
        (root, 1, cv2.CALIB_CB_EXHAUSTIVE),
        (linear, 2, cv2.CALIB_CB_EXHAUSTIVE),
        (cv2.equalizeHist(linear), 1, cv2.CALIB_CB_EXHAUSTIVE),
    ):
        larger = cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
        # CALIB_CB_LARGER: otherwise a part of a larger board passes for the board that was asked for
        flags |= cv2.CALIB_CB_LARGER
        complete, points, meta = cv2.findChessboardCornersSBWithMeta(larger, inner_corners, flags)
        if complete and sum(meta.shape[:2]) == sum(inner_corners) + 1:
            # one line too many may be the frame or a table's edge: ask for the exact board
            exact, inner, _ = cv2.findChessboardCornersSBWithMeta(
                larger, inner_corners, flags & ~cv2.CALIB_CB_LARGER
            )
            if exact:
                points, meta = inner, np.empty(inner_corners[::-1])
        if complete:
            # resize keeps the picture's outline, so centres move by half a pixel's difference
            return ((np.asarray(points, float) + 0.5) / factor - 0.5).reshape(*meta.shape[:2], 2)
    return None


def upright(lattice: Array) -> Array:
    """The lattice (row, column, xy) in the order of `Corners.points`: never mirrored, most nearly upright."""
    along, down = _axes(lattice)
    if along[0] * down[1] - along[1] * down[0] < 0:
        lattice = lattice[:, ::-1]
    return max(turns(lattice), key=lambda grid: float(_axes(grid)[0][0] + _axes(grid)[1][1]))


def turns(lattice: Array) -> list[Array]:
    """The orders of a lattice (row, column, ...) that do not mirror it: two, or four where it is square."""
    out = [lattice, lattice[::-1, ::-1]]
    if lattice.shape[0] == lattice.shape[1]:
        swapped = np.swapaxes(lattice, 0, 1)
        out += [swapped[::-1], swapped[:, ::-1]]
    return out


def _axes(lattice: Array) -> tuple[Array, Array]:
    """Mean unit vectors along the columns' and the rows' numbers."""
    along = (lattice[:, -1] - lattice[:, 0]).mean(0)
    down = (lattice[-1] - lattice[0]).mean(0)
    return along / np.linalg.norm(along), down / np.linalg.norm(down)


def _without_false_line(image: Array, lattice: Array, inner_corners: tuple[int, int]) -> Array:
    """Drop an outer line that is no line of corners (a table's edge): its fits are far worse than all others'."""
    if sum(lattice.shape[:2]) != sum(inner_corners) + 1:
        return lattice
    _, covariance, _ = refine_corners(image, lattice)
    spread = np.nan_to_num(np.trace(covariance, axis1=2, axis2=3), nan=np.inf)
    for axis in (0, 1):
        for end in (0, -1):
            rest = np.delete(lattice, end, axis)
            worse = np.median(np.take(spread, end, axis)) > 16 * np.median(np.delete(spread, end, axis))
            if worse and sorted(rest.shape[:2]) == sorted(inner_corners):
                return rest
    return lattice


def _squares(image: Array, points: Array) -> Array:
    """(row, column) values at the middles of the inner squares."""
    centres = (points[:-1, :-1] + points[1:, :-1] + points[:-1, 1:] + points[1:, 1:]) / 4
    x, y = np.round(centres[..., 0]).astype(int), np.round(centres[..., 1]).astype(int)
    return np.asarray(image[y, x])


def _first_is_black(image: Array, points: Array) -> bool:
    """Compare the two colours of squares over the whole board."""
    values = _squares(image, points)
    even = (np.add.outer(np.arange(values.shape[0]), np.arange(values.shape[1])) % 2) == 0
    # the square before the first corner touches the first inner square by its corner: same colour
    return bool(np.median(values[even]) < np.median(values[~even]))


def _why_not(image: NDArray[Any], lattice: Array | None, inner_corners: tuple[int, int], camera: str) -> str:
    """The sentence for a board that was not found as asked."""
    asked = f"{inner_corners[0]} x {inner_corners[1]}"
    if lattice is None:
        lattice = _detect(image, (3, 3))
    # nine crossings in a row are found in noise and in faces, too
    if lattice is None or lattice[..., 0].size < 15:
        return (
            f"{camera}: no checkerboard was found (one with {asked} inner corners is declared); the whole board "
            "must be seen, in focus, not saturated, with a bright margin of one square around it"
        )
    rows, columns = lattice.shape[:2]
    fits = (np.sort(lattice.shape[:2]) <= np.sort(inner_corners)).all()
    # two steps beyond the last corner found lies the outer edge of the square after the next corner
    ends = [2 * lattice[k] - lattice[k - 2 if k else 2] for k in (0, -1)]
    ends += [2 * lattice[:, k] - lattice[:, k - 2 if k else 2] for k in (0, -1)]
    outer = np.concatenate([end.reshape(-1, 2) for end in ends])
    if fits and not ((outer >= 0) & (outer <= np.array(image.shape[::-1]) - 1)).all():
        return (
            f"{camera}: the board is partly out of the frame; {columns} x {rows} of its {asked} inner corners are "
            "seen; move it so that all its squares are in the picture"
        )
    if fits:
        return (
            f"{camera}: only {columns} x {rows} of the {asked} inner corners declared are seen; uncover the board "
            "and avoid reflections, or set target.inner_corners to what the board has"
        )
    return (
        f"{camera}: the board shows {columns} x {rows} inner corners where {asked} are declared; "
        "set target.inner_corners to what the board has (corners inside the pattern, not squares)"
    )

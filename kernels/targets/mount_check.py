"""Pairs of corners of both cameras, and whether the declared mount is right.

With the right mount undone the cameras see nearly the same picture, so the corners nearly coincide, and the
squares' colours agree. All eight ways to turn and mirror the first camera are tried with every order of the corners
that keeps the colours; the one with the least distance is right. The lattice alone cannot tell a mirrored board
from an upright one (the homography would be perfect, of the wrong picture), so the colours are what detects a
forgotten mirror: the determinant of the map in the colours' order is negative.

    rows, columns (inner)    half a turn keeps the colours    a mirror keeps the colours
    both odd                 yes                              never: always detected
    one odd, one even        no                               along one side: told by position
    both even                yes                              both: told by position

Sources: Hartley & Zisserman (2004), Multiple View Geometry, section 2.4 (orientation of a map).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.targets.board_corners import Corners, undo_mount_points

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MountCheck:
    """Which mount of the first camera agrees with the second."""

    right: bool
    rotate: int
    mirror: bool
    """The mount that fits best; the declared one if `right`."""
    distance_px: float
    """Mean distance of the corners under it (the offset between the cameras)."""
    runner_up: float
    """Distance of the next best mount over that of the best: below 1.5 the boards cannot tell them apart."""
    determinant: float
    """Sign and size of the linear part from the declared mount's corners to the second camera's: 1 if right."""
    sentence: str


def pair_corners(first: Sequence[Corners], second: Sequence[Corners]) -> tuple[Array, Array, Array, Array, Array]:
    """Pairs of all boards in one order, both mounts undone rightly (`check_mount`).

    Returns:
        points of the first (n, xy) and second camera, their covariances (n, 2, 2), and the board of every
        pair (n,).
    """
    out: list[list[Array]] = [[], [], [], [], []]
    for k, (a, b) in enumerate(zip(first, second, strict=True)):
        orders = _orders(a)
        _, best = min(
            (float(np.linalg.norm(a.points.reshape(-1, 2)[o] - b.points.reshape(-1, 2), axis=1).mean()), i)
            for i, (o, _) in enumerate(orders)
        )
        order = orders[best][0]
        parts = (
            a.points.reshape(-1, 2)[order],
            b.points.reshape(-1, 2),
            a.covariance.reshape(-1, 2, 2)[order],
            b.covariance.reshape(-1, 2, 2),
            np.full(order.size, k, float),
        )
        for into, part in zip(out, parts, strict=True):
            into.append(part)
    p, q, c, d, e = (np.concatenate(parts) for parts in out)
    return p, q, c, d, e.astype(int)


def _orders(corners: Corners) -> list[tuple[NDArray[np.intp], bool]]:
    """Every order of the lattice (flat index) that keeps its shape, and `first_is_black` in it."""
    rows, columns = corners.points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    out = []
    for turned in [index, index.T] if rows == columns else [index]:
        for flip_y in (False, True):
            for flip_x in (False, True):
                order = turned[:: -1 if flip_y else 1, :: -1 if flip_x else 1]
                # the square beyond the far end is `rows` (columns) squares away
                swaps = (flip_y and rows % 2 == 1) != (flip_x and columns % 2 == 1)
                out.append((order.ravel(), corners.first_is_black != swaps))
    return out


def check_mount(
    first: Sequence[Corners],
    second: Sequence[Corners],
    *,
    shape: tuple[int, int],
    rotate: int,
    mirror: bool,
    camera: str = "CAM0",
) -> MountCheck:
    """Compare the declared mount of the first camera with the seven others.

    Args:
        first, second: the boards' corners, mounts undone as declared, the reference camera's rightly.
        shape: (rows, columns) of the first camera's picture, mount undone.
        rotate, mirror: the declared mount, to name the right one.
    """
    distances: dict[tuple[int, bool], float] = {}
    determinants: list[float] = []
    for turn in (0, 90, 180, 270):
        for flip in (False, True):
            total = 0.0
            for a, b in zip(first, second, strict=True):
                moved = undo_mount_points(a.points, shape, rotate=turn, mirror=flip).reshape(-1, 2)
                target = b.points.reshape(-1, 2)
                tries = [
                    (float(np.linalg.norm(moved[order] - target, axis=1).mean()), order)
                    for order, black in _orders(a)
                    if black == b.first_is_black
                ]
                distance, order = min(tries, key=lambda pair: pair[0])
                total += distance / len(first)
                if (turn, flip) == (0, False):
                    determinants.append(_determinant(a.points.reshape(-1, 2)[order], target))
            distances[turn, flip] = total
    ranked = sorted(distances, key=lambda key: distances[key])
    best, declared = distances[ranked[0]], distances[0, False]
    right = ranked[0] == (0, False) or declared < max(2 * best, 0.02 * float(np.hypot(*shape)))
    turn, flip = (0, False) if right else ranked[0]
    # mirrored first, a further turn counts the other way round
    named = ((rotate + (-turn if mirror else turn)) % 360, mirror != flip)
    other = min(distances[key] for key in distances if key != (turn, flip))
    ratio = other / max(distances[turn, flip], 1e-9)
    doubt = "" if ratio > 1.5 else "; another mount fits nearly as well: put the board nearer to the picture's edge"
    if right:
        sentence = (
            f"the mount of {camera} is right: its corners lie {declared:.1f} px from the other camera's{doubt}"
        )
    else:
        sentence = (
            f"the mount of {camera} is wrong: with rotate: {rotate}, mirror: {str(mirror).lower()} its corners lie "
            f"{declared:.0f} px from the other camera's, with rotate: {named[0]}, mirror: {str(named[1]).lower()} "
            f"{best:.1f} px{doubt}"
        )
    return MountCheck(right, *named, distances[turn, flip], ratio, float(np.median(determinants)), sentence)


def _determinant(a: Array, b: Array) -> float:
    """Determinant of the affine map a -> b."""
    linear, *_ = np.linalg.lstsq(a - a.mean(0), b - b.mean(0), rcond=None)
    return float(np.linalg.det(linear))

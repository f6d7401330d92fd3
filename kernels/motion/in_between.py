"""Normals between tracking frames: both neighbours' normals carried to a frame's own grid, and their mean.

With f_T the flow of tracking frame T to frame i (x on T lies at x + f_T(x) on i) and g_T its inverse,

    n_i^T(y) = n_T(y + g_T(y)) ,      n_i ~ sum over T of w_T c_T n_i^T

c_T is the flow's confidence, 0 where T does not see the point, and w_T the nearness in time. A point that one side
does not see comes from the other alone. With both sides at hand the mean also follows the subject's rotation as far
as it is linear in time; a warp does not turn normals.

Source: Wilson et al. (2010) and Dutta (2010) 5.2.1, whose printed weights favour the farther tracking frame; these
favour the nearer.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.motion.flow_warp import Image, Interpolation, Inverse, invert, unit, warp, warp_vectors


class Side(NamedTuple):
    """One tracking frame's normals on another frame's grid."""

    normal: Image
    """(xyz, y, x), NaN where the tracking frame does not see the point."""
    confidence: Image
    """(y, x), 0 to 1; 0 where `normal` is NaN."""


def nearness(frame: float, tracking: Sequence[float]) -> NDArray[np.float64]:
    """Weights of the tracking frames that flank a frame: linear in time, 1 in sum.

    Args:
        frame: its index or time.
        tracking: one or two indices or times of tracking frames.

    Returns:
        1 for a single tracking frame. For two, each weighs the other's distance: frame 5 between 3 and 6 has 1/3
        and 2/3.

    Raises:
        ValueError: none, more than two, or two at the same place.
    """
    if len(tracking) == 1:
        return np.ones(1)
    if len(tracking) != 2 or tracking[0] == tracking[1]:
        raise ValueError(f"the tracking frames are {list(tracking)}; one or two different ones must flank a frame")
    away = np.abs(np.asarray(tracking, float) - frame)
    return np.asarray(away[::-1] / away.sum())


def carry(
    normal: Image,
    flow: Image,
    confidence: Image | None = None,
    *,
    interpolation: Interpolation = "cubic",
    negated: bool = False,
) -> Side:
    """Bring a tracking frame's normals to the grid of the picture that `flow` leads to.

    Args:
        normal: (xyz, y, x) unit normals on the tracking frame's grid; NaN where there is none.
        flow: (xy, y, x), pixels, on the same grid: x there lies at x + flow(x) in the picture.
        confidence: (y, x), 0 to 1, of the flow; 1 if absent.
        interpolation: see `flow_warp.warp`.
        negated: take -flow for the inverse, which it is not (the thesis', for comparison).
    """
    inverse = Inverse(-flow, np.asarray(np.isfinite(flow).all(axis=0))) if negated else invert(flow, confidence)
    carried = warp_vectors(normal, inverse.flow, interpolation=interpolation)
    known = inverse.valid & (carried[0] == carried[0])
    if confidence is None:
        sure = known.astype(np.float32)
    else:
        sure = warp(np.asarray(confidence, np.float32), inverse.flow, interpolation="linear")
        known &= sure > 0
        sure = np.where(known, sure, np.float32(0))
    return Side(np.where(known, carried, np.float32(np.nan)), sure)


def blend(sides: Sequence[Side], weights: Sequence[float]) -> Side:
    """The weighted mean direction of the sides that see a point, and the weighted mean of their confidence.

    Args:
        sides: one or more, on one grid.
        weights: one a side, not negative, 1 in sum. A side with weight 0 still fills where no other sees the point.

    Returns:
        Unit normals, NaN where no side sees the point or the directions cancel. A point that one side alone sees
        has no more confidence than that side's share.

    Raises:
        ValueError: there is not one weight a side.
    """
    if len(sides) != len(weights):
        raise ValueError(f"there are {len(sides)} sides and {len(weights)} weights; each side must have one")
    total = np.zeros_like(sides[0].normal)
    sure = np.zeros_like(sides[0].confidence)
    for side, weight in zip(sides, weights, strict=True):
        # a tiny share is next to nothing beside another side, and everything where there is none
        share = np.float32(max(weight, 1e-6)) * side.confidence
        total += share * np.where(side.confidence > 0, side.normal, np.float32(0))
        sure += share
    # of opposite directions there is no mean
    normal = unit(total)
    return Side(normal, np.where(np.isnan(normal[0]), np.float32(0), np.minimum(sure, np.float32(1))))

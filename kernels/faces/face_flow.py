"""Which place of one face is which place of another, and what lies between the two.

Both faces stand in one frame (`face_frame.py`). The flow d lives on the first face's grid: what the first shows at
x, the second shows at x + d(x). It is a sheet of cubic B-splines with coefficients c, and minimises

    sum_x w(x) rho( |s_2(x + d(x)) - s_1(x)|^2 ) + a |grad c|^2 + b |laplace c|^2 ,

s the sideways parts (x and y) of the normals, w the oval, rho the Cauchy loss: from coarse sheets and smooth
normals to finer ones, by Gauss-Newton steps. Normals do not depend on skin or light, so faces of any skin are
compared, and what has the same slope on both lies at the same part of a nose, a lip or a cheek.

At level t between the faces, what is at x of the first stands at x + t d(x): both faces are brought there, normals
are mixed as vectors and made unit again. Level 0 is the first face itself; level 1 is the second.

Limits: a smooth flow does not tear, so a fold that only one face has is pressed together. Where both are smooth, as
on a forehead, the flow follows what is around. What texture shows and shape does not (an iris, a brow's edge) is
not seen. Normals keep their direction where the flow stretches, so a surface between two is not exactly integrable.

Sources: Rueckert et al. (1999), doi:10.1109/42.796284, for sheets of B-splines; Blanz, Vetter (1999),
doi:10.1145/311535.311556, who put faces in correspondence by flow; Bookstein (1989), doi:10.1109/34.24792, for
thin-plate splines.
"""

from typing import Any, NamedTuple

import cv2
import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from skimage.transform import ThinPlateSplineTransform

from lightstage.kernels.errors import KernelError
from lightstage.kernels.faces.face_frame import filled
from lightstage.kernels.motion.flow_warp import invert, unit, warp

Array = NDArray[np.float64]
Image = NDArray[np.float32]


class _Level(NamedTuple):
    """A sheet; lengths are parts of the eye distance."""

    spacing: float
    smooth: float


_LEVELS = (_Level(0.8, 0.12), _Level(0.4, 0.08), _Level(0.25, 0.05), _Level(0.16, 0.03))
_EYES_PX = 40.0
"""The eye distance at which faces are compared; finer detail is pores and noise."""
_ROUNDS = 15
_ENOUGH_PX = 0.01
_STIFF, _BEND = 0.002, 0.02
"""a and b, for lengths in pixels of the sheet: found on heads whose correspondence is known."""
_SOFT = 0.3
"""A difference of slopes above this (about 17 degrees) counts less: it is something that one face alone has."""


class Between(NamedTuple):
    """Where the pictures of a level are pulled from, both (xy, y, x) in pixels on the level's own grid."""

    first: Image
    second: Image


def face_flow(first: Image, second: Image, oval: Image, eyes_px: float) -> Image:
    """The flow from one face to another.

    Args:
        first, second: (xyz, y, x) unit normals in one frame, finite everywhere.
        oval: (y, x), 0 to 1: where faces are compared. Outside of it the flow goes on smoothly.
        eyes_px: eye distance of the frame; it decides what is coarse.

    Returns:
        (xy, y, x) float32, pixels: first(x) shows what second(x + flow(x)) shows.
    """
    rows, columns = oval.shape
    factor = min(1.0, _EYES_PX / eyes_px)
    size = round(columns * factor), round(rows * factor)
    weight = np.asarray(cv2.resize(oval, size, interpolation=cv2.INTER_AREA), np.float64)
    small = [cv2.resize(np.moveaxis(n[:2], 0, 2), size, interpolation=cv2.INTER_AREA) for n in (first, second)]
    eyes = eyes_px * factor
    flow = np.zeros((2, size[1], size[0]))
    for level in _LEVELS:
        smooth_first, smooth_second = (
            np.asarray(cv2.GaussianBlur(s, (0, 0), level.smooth * eyes), np.float32) for s in small
        )
        flow = _refined(flow, smooth_first, smooth_second, weight, level.spacing * eyes)
    grown = [cv2.resize(f, (columns, rows), interpolation=cv2.INTER_CUBIC) for f in flow]
    return np.stack([grown[0] * (columns / size[0]), grown[1] * (rows / size[1])]).astype(np.float32)


def landed(points: Array, flow: Image) -> Array:
    """(point, xy): where points of the first face are on the second."""
    at = points[:, 0].astype(np.float32), points[:, 1].astype(np.float32)
    moves = [cv2.remap(f, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).ravel() for f in flow]
    return np.asarray(points + np.stack(moves, axis=1), np.float64)


def through_points(flow: Image, first: Array, second: Array) -> Image:
    """The flow, changed so that it leads from points of the first face to those of the second (point, xy).

    What the flow lacks there is spread by a thin-plate spline, which holds the border of the frame.

    Raises:
        KernelError: two points of one face are the same.
    """
    rows, columns = flow.shape[1:]
    across, down = np.meshgrid(np.linspace(0, columns - 1, 4), np.linspace(0, rows - 1, 4))
    edge = (across % (columns - 1) == 0) | (down % (rows - 1) == 0)
    held = np.stack([across[edge], down[edge]], axis=1)
    lacking = second - landed(first, flow)
    start = np.concatenate([first, held])
    apart = np.linalg.norm(start[:, None] - start[None], axis=2) + np.eye(len(start)) * columns
    if apart.min() < 1e-6:
        raise KernelError("two points of one face are the same; each needs a place of its own")
    spline = ThinPlateSplineTransform.from_estimate(start, start + np.concatenate([lacking, 0 * held]))
    y, x = np.mgrid[:rows, :columns]
    grid = np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float64)
    return np.asarray(flow + (spline(grid) - grid).T.reshape(2, rows, columns), np.float32)


def between(flow: Image, level: float) -> Between:
    """Where to pull both faces from, for the geometry at a level; 0 is the first face's, 1 the second's."""
    to_first = filled(invert(np.float32(level) * flow).flow)
    return Between(to_first, to_first + filled(warp(flow, to_first)))


def pulled(picture: Image, flow: Image) -> Image:
    """A picture (channel, y, x) pulled along a flow; what comes from outside takes the nearest value."""
    return filled(warp(picture, flow))


def mixed_normals(first: Image, second: Image, level: float) -> Image:
    """Unit normals (xyz, y, x) between two; level 0 is the first. Opposite vectors at level 1/2 give the first."""
    mixed = unit(np.float32(1 - level) * first + np.float32(level) * second)
    return np.where(np.isfinite(mixed), mixed, first)


def _refined(flow: Array, first: Image, second: Image, weight: Array, spacing: float) -> Array:
    """Gauss-Newton steps on one sheet, which is added to the flow so far."""
    basis, cost = _sheet(weight.shape, spacing)
    y, x = np.mgrid[: weight.shape[0], : weight.shape[1]]
    own = _slopes(first)
    start, sheet = flow, np.zeros((2, basis.shape[1]))
    for _ in range(_ROUNDS):
        at = np.float32(x + flow[0]), np.float32(y + flow[1])
        moved = cv2.remap(second, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        off = (moved - first).astype(np.float64).reshape(-1, 2)
        # the mean of both faces' slopes converges from farther away than either (Malis 2004)
        slope = (own + _slopes(moved)) / 2
        loss = weight.ravel() / (1 + (off**2).sum(axis=1) / _SOFT**2)
        xx, xy, yy = (_summed(basis, loss * (slope[i] * slope[j]).sum(axis=1)) for i, j in ((0, 0), (0, 1), (1, 1)))
        side = [basis.T @ (loss * (a * off).sum(axis=1)) + cost @ s for a, s in zip(slope, sheet, strict=True)]
        hessian = scipy.sparse.bmat([[xx + cost, xy], [xy, yy + cost]])
        step = scipy.sparse.linalg.spsolve(hessian.tocsc(), -np.concatenate(side)).reshape(2, -1)
        sheet = sheet + step
        flow = start + (basis @ sheet.T).T.reshape(flow.shape)
        if np.abs(step).max() < _ENOUGH_PX:
            break
    return flow


def _slopes(picture: Image) -> Array:
    """(xy, pixel, channel): derivatives of (y, x, channel)."""
    down, across = np.gradient(picture.astype(np.float64), axis=(0, 1))
    return np.stack([across, down]).reshape(2, -1, picture.shape[2])


def _summed(basis: Any, weight: Array) -> Any:
    return basis.T @ scipy.sparse.diags(weight) @ basis


def _sheet(shape: tuple[int, ...], spacing: float) -> tuple[Any, Any]:
    """(pixel, coefficient) cubic B-splines, and (coefficient, coefficient) what bending them costs."""
    axes, rises = [], []
    for length in shape:
        count = int(np.ceil((length - 1) / spacing)) + 3
        knots = np.arange(-3.0, count + 1)
        axes.append(BSpline.design_matrix(np.arange(length) / spacing, knots, 3))
        difference = scipy.sparse.diags([-1.0, 1.0], [0, 1], shape=(count - 1, count))
        rises.append(difference.T @ difference)
    same = [scipy.sparse.identity(axis.shape[1]) for axis in axes]
    rise = scipy.sparse.kron(rises[0], same[1]) + scipy.sparse.kron(same[0], rises[1])
    cost = spacing**2 * (_STIFF * rise + _BEND * rise @ rise)
    return scipy.sparse.kron(axes[0], axes[1], format="csr"), cost.tocsr()

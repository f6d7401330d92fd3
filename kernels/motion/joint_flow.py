"""The motion of a subject through pictures under different light: a joint Gauss-Newton solve, coarse to fine.

With c the tracking frame (constant light) and p_i picture i, taken at time t_i, the flow of each picture is a sum
of few fields that all pictures share,

    u_i(x) = sum_k B_ik theta_k(x) .

`follow` takes B_ik = tau_i^k, k = 1..K, tau_i = t_i / max|t|: one motion for the whole window, its velocity,
acceleration and jerk. `joint` gives a pair a field each (tau and tau^2 of two pictures span the same), `nudge` one
picture its own. theta lives on the nodes of a block grid and is bilinear between them. Minimised are

    complement  sum |h(p_a)(x + u_a) + h(p_a')(x + u_a') - h(c)(x)|^2 / c      light adds: r_a + r_a' = c
    direct      sum |n(p_i)(x + u_i) - n(c)(x)|^2 c                            fine texture is that of the albedo
    bending     sum lambda_k |second differences of theta_k|^2                 motion is smooth, but for its edges

all with robust norms, each term with its own scale, measured by the median of its residuals. n divides by the local
mean (sigma 2 px) and takes off what is smooth once more: that removes the gain between a gradient and constant
light, and shading that stays where it is while the subject moves. h keeps 40 % of what is smoother than 4 px, for
the same reason: a subject that turns changes its shading, so the complement constraint holds less well for what is
smooth.

The complement constraint fixes u + v and hardly sees u - v (its gradient is that of the pictures' difference). What
decides u - v are the direct terms and, in `follow`, the tracking frames before and after, whose light is the same.

`doubt_px` predicts the error of a flow: how far the solution moves when the bending term is taken ten times as
strong or as weak, and a part of the motion itself near the subject's rim and the picture's border, where flows are
only extended from inside.

Sources: Wilson et al. (2010), ACM TOG 29(2), for the complement constraint; Dutta (2010) chapter 4; Negahdaripour
(1998), doi:10.1109/34.713362, for brightness change; Lucas & Kanade (1981). The terms together are ours.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from lightstage.kernels.motion.block_grid import FLAGS, MASS, edges_of, minimise
from lightstage.kernels.pictures import blurs
from lightstage.kernels.pictures.keys_cubic import weights_and_slopes
from lightstage.kernels.pictures.masked_mean import MaskedMean

Image = NDArray[np.float32]
DARK = 0.03
"""Of the bright end of c: what is darker is taken for background."""
_SIGMA_PX, _SMOOTH_PX, _KEPT_SMOOTH = 2.0, 4.0, 0.4
_PREFILTER_PX = 0.8
"""Noise and aliasing at the sampling limit say nothing about motion, and pull flows to whole pixels."""
_MARGIN_PX = 2
"""The rim is not used: what is beyond it does not move with it."""
_DIRECT = 0.15
"""Weight of the direct terms of gradient pictures: their texture holds some of the relief's shading."""
_EDGE = 5.0
"""Bending energy from which a place counts as an edge of the motion."""
_ADAPTED = 0.1
"""Weight of bending times its median, where the weight is adapted."""
_START_PX = 1 / 16
"""Steps of a start: it comes from OpenCV, whose last bits differ between processors."""
_ROOT_FLOOR = np.float32(0.02)
_LEAST_SHARE = 1e-3
"""Of a window that is lit: where less is, a mean is over nearly nothing."""
_RIM_PART = np.float32(2.1)
_SWAY = 5.2
"""So much larger than these two is the error: nine in ten of the pixels that are wrong by more than a pixel have
more doubt than that."""


class Flows(NamedTuple):
    """Flows of the pictures of one window."""

    flow: Image
    """(picture, xy, y, x), pixels on the tracking frame's grid: aligned(x) = picture(x + flow(x))."""
    doubt_px: Image
    """(picture, y, x): predicted error of the flow, pixels."""


class Features(NamedTuple):
    """One level of a pyramid for `match`: what two pictures show of the same things, feature by feature."""

    fixed: Image
    """(feature, y, x), on the grid of the flow."""
    moving: Image
    """(feature, y, x), of the other picture."""
    weight: Image
    """(feature, y, x): 1 / the standard deviation of fixed(x) - moving(x + flow(x)); 0 where that says nothing."""
    known: NDArray[np.bool_]
    """(y, x): where the other picture is known."""
    subject: NDArray[np.bool_]
    """(y, x), on the grid of the flow."""


class _Terms(NamedTuple):
    basis: Image  # (picture, field)
    pairs: NDArray[np.int64]  # (pair, 2)
    single: NDArray[np.int64]  # pictures with a direct term
    weight: NDArray[np.float64]  # of each direct term
    target: NDArray[np.int64]  # which of a level's targets each picture is held against


class _Level(NamedTuple):
    root: Image
    """(target, y, x): what direct terms are weighted with, and the first one complements by its inverse"""
    smooth_less: Image
    """h(c)"""
    fine: Image
    """(target, y, x): n(c)"""
    pictures: Image
    """(picture, y, x, 2): h and n of each"""
    known: NDArray[np.bool_]
    """(picture, y, x)"""
    subject: NDArray[np.bool_]


def joint(
    constant: Image, gradient: Image, complement: Image, *, times: tuple[float, float] = (-1.0, 1.0)
) -> tuple[Image, Image]:
    """Flows u, v of a gradient and its complement to the constant picture, each (xy, y, x) in pixels.

    Args:
        constant: c, (y, x), radiance in any unit; NaN where not valid.
        gradient: r_a. complement: r_a'. times: when they were taken; c at 0.
    """
    flows = joint_flows(constant, [gradient, complement], times=times)
    return flows.flow[0], flows.flow[1]


def joint_flows(constant: Image, pair: Sequence[Image], *, times: Sequence[float]) -> Flows:
    """`joint`, with doubt."""
    terms = _Terms(_powers(times, 2), np.array([[0, 1]]), np.arange(2), np.full(2, _DIRECT), np.zeros(2, np.int64))
    return _solve(
        constant, pair, terms, bending=(60.0, 600.0), warps=(6, 4, 2), bounds=((20.0, 80.0), (300.0, 5000.0))
    )


def follow(
    constant: Image,
    pictures: Sequence[Image],
    *,
    times: Sequence[float],
    steady: Sequence[bool],
    pairs: Sequence[tuple[int, int]],
) -> Flows:
    """One motion for all pictures of a tracking frame's window.

    Args:
        constant: c, (y, x), radiance in any unit; NaN where not valid.
        pictures: the window's other pictures, and the tracking frames before and after it.
        times: when each was taken, in any unit, c at 0.
        steady: whether a picture was taken under constant light.
        pairs: indices of pictures that are complements of each other.

    Returns:
        Flows of all pictures, in their order. The number of fields follows from the number of distinct times: 1 for
        one, up to 3.
    """
    fields = min(3, len(set(times)))
    direct = np.where(np.asarray(steady, bool), 1.0, _DIRECT)
    terms = _Terms(
        _powers(times, fields),
        np.array(pairs, np.int64).reshape(-1, 2),
        np.arange(len(pictures)),
        direct,
        np.zeros(len(pictures), np.int64),
    )
    start = _between_tracking_frames(constant, pictures, times, steady, fields)
    bending = (60.0, 180.0, 180.0)[:fields]
    if start is None:
        return _solve(constant, pictures, terms, bending=bending, warps=(8, 6))
    return _solve(constant, pictures, terms, bending=bending, warps=(8, 6), levels=2, start=start)


def nudge(constant: Image, picture: Image, start: Image) -> Flows:
    """The flow of one picture by itself, from a start that is nearly right; (xy, y, x) in pixels."""
    return _solve(constant, [picture], _alone(1), bending=(200.0,), warps=(3, 3), levels=2, start=start)


def match(
    levels: Sequence[Features],
    *,
    factors: Sequence[float],
    bending: float,
    warps: Sequence[int],
    bounds: tuple[float, float] | None = None,
) -> Flows:
    """The one flow between two pictures that several features of them share, from zero.

    Args:
        levels: from the full size down, each half as large as the one before.
        factors: of each feature, beside the scale that its residuals are measured to have.
        bending: weight of the flow's second differences.
        warps: the Gauss-Newton steps per level from the coarsest, the last one for all finer levels.
        bounds: of that weight, when it is to follow from how much the flow bends.

    Returns:
        Flows of one picture: moving(x + flow(x)) shows what fixed(x) shows.
    """

    def level(k: int) -> _Level:
        at = levels[k]
        both = np.stack([np.zeros_like(at.moving), at.moving], axis=-1)
        known = np.ascontiguousarray(np.broadcast_to(at.known, at.moving.shape))
        return _Level(at.weight, np.zeros_like(at.weight[0]), at.fixed, both, known, _inner(at.subject))

    terms = _alone(len(factors))._replace(weight=np.asarray(factors, np.float64))
    flows = _descended(
        level,
        levels[0].subject,
        len(levels),
        terms,
        bending=(bending,),
        warps=warps,
        bounds=None if bounds is None else (bounds,),
    )
    return Flows(flows.flow[:1], flows.doubt_px[:1])


def _alone(count: int) -> _Terms:
    """Direct terms of so many pictures with one flow, each against its own target."""
    return _Terms(
        np.ones((count, 1), np.float32),
        np.empty((0, 2), np.int64),
        np.arange(count),
        np.ones(count),
        np.arange(count),
    )


def _powers(times: Sequence[float], fields: int) -> Image:
    tau = np.asarray(times, float) / np.abs(times).max()
    return np.stack([tau**k for k in range(1, fields + 1)], axis=1).astype(np.float32)


def _between_tracking_frames(
    constant: Image, pictures: Sequence[Image], times: Sequence[float], steady: Sequence[bool], fields: int
) -> Image | None:
    """Fields (2 field, y, x) from dense flow between tracking frames, where light is the same; None without any.

    The block grid alone loses fast parts that are small, such as a jaw, on its coarse levels.
    """
    others = [i for i, same in enumerate(steady) if same]
    if not others or fields < 2:
        return None
    bright = _bright_end(constant)
    dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    dis.setFinestScale(0 if constant.size < 300_000 else 1)
    dis.setVariationalRefinementIterations(10)
    target = _eight_bits(constant, bright)
    far = float(np.abs(times).max())
    rows, flows = [], []
    for i in others:
        flow = dis.calc(target, _eight_bits(pictures[i], bright), None)
        flows.append(np.moveaxis(flow, 2, 0))
        rows.append([times[i] / far, (times[i] / far) ** 2][: len(others)])
    start = np.zeros((2 * fields, *constant.shape), np.float32)
    known = np.linalg.pinv(np.array(rows))[:fields]
    start[: 2 * len(known)] = np.einsum("ki,icyx->kcyx", known, np.stack(flows)).reshape(-1, *constant.shape)
    return start


def _eight_bits(picture: Image, bright: float) -> NDArray[np.uint8]:
    return np.asarray(np.clip(np.nan_to_num(picture) * (220 / bright), 0, 255), np.uint8)


def _bright_end(constant: Image) -> float:
    thin = max(1, constant.shape[1] // 400)
    lit = constant[::thin, ::thin]
    lit = lit[np.isfinite(lit)]
    bright = float(np.percentile(lit, 99)) if lit.size else 0.0
    return bright if bright > 0 else 1.0


def _solve(
    constant: Image,
    pictures: Sequence[Image],
    terms: _Terms,
    *,
    bending: Sequence[float],
    warps: Sequence[int],
    levels: int | None = None,
    start: Image | None = None,
    bounds: Sequence[tuple[float, float]] | None = None,
) -> Flows:
    """Coarse to fine.

    Args:
        bending: weight of each field's second differences.
        warps: the Gauss-Newton steps per level, the last one for all finer levels.
        levels: how many; None for what the size allows.
        start: fields (2 field, y, x) at full size.
        bounds: of each field's weight, when after the first step it is to follow from how much the field bends
            (`_stiffness`); None keeps `bending`.
    """
    bright = np.float32(_bright_end(constant))
    height, width = constant.shape
    subject = subject_of(constant)
    known = [np.isfinite(p) for p in pictures]
    images = [blurs.filled(np.asarray(p, np.float32) / bright) for p in (constant, *pictures)]
    depth = levels or depth_of((height, width))
    pyramid = [(images, known, subject)]
    for _ in range(depth - 1):
        images, known, subject = pyramid[-1]
        pyramid.append(([blurs.half_size(i) for i in images], [halved(k) for k in known], halved(subject)))
    return _descended(
        lambda level: _prepared(*pyramid[level], finest=level == 0),
        pyramid[0][2],
        depth,
        terms,
        bending=bending,
        warps=warps,
        start=start,
        bounds=bounds,
    )


def depth_of(shape: tuple[int, int]) -> int:
    """How many levels a pyramid has for pictures of this shape."""
    return min(5, max(1, int(math.log2(min(shape) / 40)) + 1))


def _descended(
    prepared: Callable[[int], _Level],
    subject: NDArray[np.bool_],
    depth: int,
    terms: _Terms,
    *,
    bending: Sequence[float],
    warps: Sequence[int],
    start: Image | None = None,
    bounds: Sequence[tuple[float, float]] | None = None,
) -> Flows:
    """The Gauss-Newton steps of `_solve`; `prepared` gives a level by its number, 0 at full size."""
    height, width = subject.shape
    weights = np.repeat(np.asarray(bending, float), 2)
    count = len(weights)
    theta = np.empty((0, 0, 0))
    spacing = 0
    for level in range(depth - 1, -1, -1):
        at = prepared(level)
        rows, columns = at.subject.shape
        step = max(8, round(width / 2**level / 32))
        nodes = (rows - 1) // step + 2, (columns - 1) // step + 2
        if theta.size:
            theta = _at_nodes(2 * _at_pixels(theta, (rows, columns), 2 * spacing), nodes, step)
        elif start is not None:
            blurred = [cv2.GaussianBlur(f, (0, 0), step * 2**level / 3) for f in start]
            smaller = [cv2.resize(f, (columns, rows), interpolation=cv2.INTER_AREA) for f in blurred]
            theta = _at_nodes(np.stack(smaller) / 2**level, nodes, step)
            theta = np.round(theta / _START_PX) * _START_PX
        else:
            theta = np.zeros((*nodes, count))
        spacing = step
        sparse = max(1, round(step / 12))
        for turn in range(warps[min(depth - 1 - level, len(warps) - 1)]):
            hessian, gradient = _linearised(at, theta, terms, step, sparse, turn)
            if bounds is not None and theta.any():
                weights = _stiffness(theta, bounds)
            edges = edges_of(theta, weights, _EDGE)
            before = theta
            theta = before + minimise(hessian, gradient, before, weights, edges, MASS)
    # how much of the solution is the prior's; at the nodes, which is as fine as it varies
    swayed = np.zeros((*theta.shape[:2], len(terms.basis)))
    for factor in (10.0, 0.1):
        away = before + minimise(hessian, gradient, before, factor * weights, edges, MASS) - theta
        moved = _by_picture(away, terms.basis)
        swayed = np.maximum(swayed, np.hypot(moved[..., 0], moved[..., 1]))
    flows = _by_picture(theta, terms.basis).reshape(*theta.shape[:2], -1)
    flow = _at_pixels(flows, (height, width), spacing).reshape(-1, 2, height, width)
    doubt = _at_pixels(swayed, (height, width), spacing)
    return Flows(flow, np.float32(_SWAY) * doubt + extended(flow, subject))


def _stiffness(theta: NDArray[np.float64], bounds: Sequence[tuple[float, float]]) -> NDArray[np.float64]:
    """Weights of the second differences by how much of them there is, as in empirical Bayes (MacKay 1992).

    The even field of a pair is nearly zero when both moved alike and as rough as the odd one when they did not; a
    fixed weight that suits one of these costs the other half its accuracy. The median, because motion has edges.
    Without bounds a field that once comes out flat stays so.
    """
    fields = theta.reshape(*theta.shape[:2], -1, 2)
    across = fields[:, 2:] - 2 * fields[:, 1:-1] + fields[:, :-2]
    down = fields[2:] - 2 * fields[1:-1] + fields[:-2]
    mixed = fields[1:, 1:] - fields[1:, :-1] - fields[:-1, 1:] + fields[:-1, :-1]
    weights = []
    for k in range(fields.shape[2]):
        parts = [share * (d[:, :, k] ** 2).sum(axis=2).ravel() for share, d in ((1, across), (1, down), (2, mixed))]
        weights += [float(np.clip(_ADAPTED / max(np.median(np.concatenate(parts)), 1e-12), *bounds[k]))] * 2
    return np.array(weights)


def extended(flow: Image, subject: NDArray[np.bool_]) -> Image:
    """(picture, y, x): the part of a motion that is likely wrong because it is extended from inside, pixels.

    It is as smooth as the distances that it is made of, so it is computed on every `thin`th pixel.
    """
    height, width = subject.shape
    thin = max(1, width // 400)
    rim = cv2.distanceTransform(subject.astype(np.uint8), cv2.DIST_L2, 3)[::thin, ::thin]
    y, x = np.mgrid[0:height:thin, 0:width:thin].astype(np.float32)
    before = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y))
    scale = width / 406
    # without any rim the distances are the largest number there is
    beside_rim = np.exp(-np.minimum(rim, width) / np.float32(4 * scale))
    out = np.empty((len(flow), height, width), np.float32)
    for f, o in zip(flow[:, :, ::thin, ::thin], out, strict=True):
        px, py = x + f[0], y + f[1]
        after = np.minimum(np.minimum(px, width - 1 - px), np.minimum(py, height - 1 - py))
        beside_border = np.exp(-np.maximum(np.minimum(before, after), 0) / np.float32(15 * scale))
        part = _RIM_PART * np.hypot(f[0], f[1]) * (beside_rim + beside_border)
        cv2.resize(part, (width, height), dst=o, interpolation=cv2.INTER_LINEAR)
    return out


def subject_of(constant: Image) -> NDArray[np.bool_]:
    """(y, x): where a tracking frame shows the subject and not the dark around it."""
    return np.isfinite(constant) & (constant > DARK * _bright_end(constant))


def halved(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The next level of a mask: where all that a pixel there is made of is in it."""
    return np.asarray(blurs.half_size(mask.astype(np.float32)) > 0.95)


def _prepared(
    images: Sequence[Image], known: Sequence[NDArray[np.bool_]], subject: NDArray[np.bool_], *, finest: bool
) -> _Level:
    if finest:
        images = [blurs.gaussian(i, _PREFILTER_PX) for i in images]
    fine = [fine_texture(i, subject if k == 0 else i > 0.01) for k, i in enumerate(images)]
    both = np.empty((len(images) - 1, *subject.shape, 2), np.float32)
    for image, texture, out in zip(images[1:], fine[1:], both, strict=True):
        out[..., 0], out[..., 1] = _less_smooth(image), texture
    # shot noise: variance goes with the counts
    root = np.sqrt(np.maximum(images[0], _ROOT_FLOOR))
    return _Level(root[None], _less_smooth(images[0]), fine[0][None], both, np.stack(known), _inner(subject))


def _inner(subject: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The subject without its rim."""
    return np.asarray(cv2.erode(subject.astype(np.uint8), np.ones((2 * _MARGIN_PX + 1,) * 2, np.uint8)) > 0)


def _less_smooth(image: Image) -> Image:
    """h: what is smooth is kept in part only."""
    mean = blurs.gaussian(image, _SMOOTH_PX)
    mean *= np.float32(_KEPT_SMOOTH - 1)
    mean += image
    return mean


def fine_texture(image: Image, lit: NDArray[np.bool_], sigma: float = _SIGMA_PX) -> Image:
    """n: texture relative to the local mean, less what is smooth; 0 where not lit.

    `sigma`, pixels, is that of the local mean. In place where it can be.
    """
    weight = lit.astype(np.float32)
    local_mean = MaskedMean(lit, sigma, least=_LEAST_SHARE, blur=blurs.gaussian, dtype=np.float32)
    mean = local_mean(image)
    out = image - mean
    np.maximum(mean, _ROOT_FLOOR, out=mean)
    out /= mean
    out *= weight
    out -= local_mean(out)
    out *= weight
    return np.asarray(out)


def _at_pixels(theta: NDArray[np.float64], shape: tuple[int, int], spacing: int) -> Image:
    """Fields (2 field, y, x) from nodes (row, column, 2 field), bilinear."""
    out = np.empty((theta.shape[2], *shape), np.float32)
    _interpolate(theta, spacing, out)
    return out


def _at_nodes(fields: Image, nodes: tuple[int, int], step: int) -> NDArray[np.float64]:
    rows = np.minimum(np.arange(nodes[0]) * step, fields.shape[1] - 1)
    columns = np.minimum(np.arange(nodes[1]) * step, fields.shape[2] - 1)
    return np.ascontiguousarray(np.moveaxis(fields[:, rows][:, :, columns], 0, 2), dtype=np.float64)


def _by_picture(theta: NDArray[np.float64], basis: Image) -> NDArray[np.float64]:
    """Flows (row, column, picture, xy) from fields (row, column, 2 field)."""
    fields = theta.reshape(*theta.shape[:2], -1, 2)
    return np.asarray(sum(basis[:, k, None] * fields[:, :, k, None] for k in range(fields.shape[2])))


def _linearised(
    at: _Level, theta: NDArray[np.float64], terms: _Terms, step: int, sparse: int, turn: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Hessian (cell row, cell column, D, D) and gradient (row, column, D) of the data terms at theta."""
    count = len(terms.pairs) + len(terms.single)
    fields = theta.astype(np.float32)
    thin = max(1, int(math.sqrt(np.count_nonzero(at.subject) / 5000)))
    few = np.zeros_like(at.subject)
    few[::thin, ::thin] = at.subject[::thin, ::thin]
    rows, columns, size = theta.shape
    misfit = np.full((count, max(1, int(np.count_nonzero(few)))), np.nan, np.float32)
    none = _Sums(np.empty((0, 0, 0, 0), np.float32), np.empty((0, 0, 0), np.float32), misfit)
    _sum_up(at, few, terms, fields, _Cells(step, 1, 0), np.ones(count, np.float32), none)
    scale = np.ones(count)
    for i, row in enumerate(misfit):
        seen = row[row == row]
        if seen.size:
            scale[i] = 1.4826 * np.median(seen) + 1e-6
    # a picture of which one pixel in n^2 is used counts as if all were
    scale /= sparse
    scale[len(terms.pairs) :] /= np.sqrt(terms.weight)
    sums = _Sums(
        np.zeros((rows - 1, columns - 1, size, size), np.float32),
        np.zeros((rows, columns, size), np.float32),
        np.empty((0, 0), np.float32),
    )
    _sum_up(at, at.subject, terms, fields, _Cells(step, sparse, turn), scale.astype(np.float32), sums)
    return sums.hessian.astype(np.float64), sums.gradient.astype(np.float64)


@njit(**FLAGS)
def _interpolate(theta: NDArray[np.float64], spacing: int, out: Image) -> None:
    rows, columns, size = theta.shape
    height, width = out.shape[1:]
    part = np.arange(width) % spacing / spacing
    for k in range(size):
        for y in range(height):
            above = min(y // spacing, rows - 1)
            below = min(above + 1, rows - 1)
            down = y / spacing - above
            for i in range(columns):
                right = min(i + 1, columns - 1)
                a = theta[above, i, k] + down * (theta[below, i, k] - theta[above, i, k])
                b = theta[above, right, k] + down * (theta[below, right, k] - theta[above, right, k])
                for x in range(i * spacing, width if i == right else min((i + 1) * spacing, width)):
                    out[k, y, x] = a + part[x] * (b - a)


class _Cells(NamedTuple):
    """Which pixels of the grid's cells count."""

    step: int
    """Pixels a side."""
    sparse: int
    """One pixel in so many squared."""
    turn: int
    """Which one of them."""


class _Sums(NamedTuple):
    """What `_sum_up` writes: the sums, or, where `misfit` has room, that alone."""

    hessian: Image
    """(cell row, cell column, D, D)."""
    gradient: Image
    """(row, column, D)."""
    misfit: Image
    """(term, pixel): |rho|; NaN where a picture does not tell."""


# In one piece, however long: with a function of its own for what happens at a pixel it takes 1.6 times as long.
@njit(**FLAGS)
def _sum_up(
    at: _Level, chosen: NDArray[np.bool_], terms: _Terms, theta: Image, cells: _Cells, scale: Image, sums: _Sums
) -> None:
    """Add up J^T W J and J^T W rho over the chosen pixels, one in sparse^2; or write |rho| of each."""
    root, smooth_less, fine, pictures, known = at.root, at.smooth_less, at.fine, at.pictures, at.known
    basis, pairs, single, target = terms.basis, terms.pairs, terms.single, terms.target
    hessian, gradient, misfit = sums.hessian, sums.gradient, sums.misfit
    step, sparse, turn = cells.step, cells.sparse, cells.turn
    only_misfit = misfit.size > 0
    height, width = chosen.shape
    rows, columns, size = theta.shape
    fields = size // 2
    count = len(pictures)
    value, slope = np.zeros((count, 2), np.float32), np.zeros((count, 2, 2), np.float32)
    seen = np.zeros(count, np.bool_)
    motion, jacobian = np.zeros(size, np.float32), np.zeros(size, np.float32)
    corner, square = np.zeros((4, size), np.float32), np.zeros((size, size), np.float32)
    across, down = np.zeros((2, 4), np.float32), np.zeros((2, 4), np.float32)
    unity, half = np.float32(1), np.float32(0.5)
    last_x, last_y = np.float32(width - 2), np.float32(height - 2)
    place = 0
    for cell_y in range(rows - 1):
        for cell_x in range(columns - 1):
            corner[:] = 0
            square[:] = 0
            some = False
            top, left = cell_y * step, cell_x * step
            for y in range(top, min(top + step, height)):
                if (y + turn) % sparse:
                    continue
                fy = np.float32((y - top) / step)
                for x in range(left + (turn + y // sparse) % sparse, min(left + step, width), sparse):
                    if not chosen[y, x]:
                        continue
                    fx = np.float32((x - left) / step)
                    a, b, c, d = (unity - fx) * (unity - fy), fx * (unity - fy), (unity - fx) * fy, fx * fy
                    for k in range(size):
                        motion[k] = (
                            a * theta[cell_y, cell_x, k]
                            + b * theta[cell_y, cell_x + 1, k]
                            + c * theta[cell_y + 1, cell_x, k]
                            + d * theta[cell_y + 1, cell_x + 1, k]
                        )
                    for m in range(count):
                        px, py = np.float32(x), np.float32(y)
                        for k in range(fields):
                            px += basis[m, k] * motion[2 * k]
                            py += basis[m, k] * motion[2 * k + 1]
                        seen[m] = px >= unity and py >= unity and px < last_x and py < last_y
                        if not seen[m]:
                            continue
                        ix, iy = int(px), int(py)
                        t, u = px - np.float32(ix), py - np.float32(iy)
                        if not known[m, iy + int(u + half), ix + int(t + half)]:
                            seen[m] = False
                            continue
                        weights_and_slopes(t, across)
                        weights_and_slopes(u, down)
                        for q in range(2):
                            v, gx, gy = np.float32(0), np.float32(0), np.float32(0)
                            for j in range(4):
                                r0 = pictures[m, iy - 1 + j, ix - 1, q]
                                r1 = pictures[m, iy - 1 + j, ix, q]
                                r2 = pictures[m, iy - 1 + j, ix + 1, q]
                                r3 = pictures[m, iy - 1 + j, ix + 2, q]
                                along = (
                                    across[0, 0] * r0 + across[0, 1] * r1 + across[0, 2] * r2 + across[0, 3] * r3
                                )
                                v += down[0, j] * along
                                rise = across[1, 0] * r0 + across[1, 1] * r1 + across[1, 2] * r2 + across[1, 3] * r3
                                gx += down[0, j] * rise
                                gy += down[1, j] * along
                            value[m, q], slope[m, q, 0], slope[m, q, 1] = v, gx, gy
                    for term in range(len(pairs) + len(single)):
                        if term < len(pairs):
                            i, j = pairs[term, 0], pairs[term, 1]
                            if not (seen[i] and seen[j]):
                                continue
                            weight = root[0, y, x]
                            rho = (value[i, 0] + value[j, 0] - smooth_less[y, x]) / weight
                            for k in range(fields):
                                for e in range(2):
                                    both = basis[i, k] * slope[i, 0, e] + basis[j, k] * slope[j, 0, e]
                                    jacobian[2 * k + e] = both / weight
                        else:
                            i = single[term - len(pairs)]
                            weight = root[target[i], y, x]
                            if not seen[i] or weight == 0:
                                continue
                            rho = (value[i, 1] - fine[target[i], y, x]) * weight
                            for k in range(fields):
                                for e in range(2):
                                    jacobian[2 * k + e] = basis[i, k] * slope[i, 1, e] * weight
                        if only_misfit:
                            misfit[term, place] = abs(rho)
                            continue
                        some = True
                        z = rho / scale[term]
                        w = unity / (unity + z * z / 4)
                        w = w * w / (scale[term] * scale[term])
                        for e in range(size):
                            g = w * jacobian[e]
                            for f in range(e, size):
                                square[e, f] += g * jacobian[f]
                            g *= rho
                            corner[0, e] += a * g
                            corner[1, e] += b * g
                            corner[2, e] += c * g
                            corner[3, e] += d * g
                    place += 1
            if some:
                _add_cell(
                    corner, square, gradient[cell_y : cell_y + 2, cell_x : cell_x + 2], hessian[cell_y, cell_x]
                )


@njit(**FLAGS)
def _add_cell(corner: Image, square: Image, gradient: Image, hessian: Image) -> None:
    """A cell's sums to the gradient of its nodes (2, 2, D) and to its own matrix (D, D), which is symmetric."""
    for e in range(len(square)):
        for q in range(4):
            gradient[q >> 1, q & 1, e] += corner[q, e]
        for f in range(e, len(square)):
            hessian[e, f] = hessian[f, e] = square[e, f]

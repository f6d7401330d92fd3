"""Find the outline of a mirror ball in a picture.

A circle by votes of gradient directions in a small picture (Kimme, Ballard, Sklansky 1975,
doi:10.1145/360666.360677), then the steepest place across the ring, arc by arc, at sub-pixel accuracy, then the
fit of `ball_conic`, four times over. The outline may be a single count above its surroundings: whole counts must
be averaged, never put through a median, before the slope is taken.

Limits: the ball must be seen on at least a quarter of its outline; a mirrored room may put edges inside the ball,
but not along its outline. The mean over all pictures is better than any one of them.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, median_filter
from skimage.measure import find_contours

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.ball_conic import Floats, Outline, outline_of_points

_SECTOR_PX = 20.0
"""Arc of the outline that is averaged into one edge point."""
_EDGE_PX = 1.2
"""Width (sigma) over which the slope across the outline is taken."""
_LEAST_COVER = 0.35
_LEAST_SEEN = 0.25
_BY_HAND = "give a mask or points on the outline by hand"


def find_outline(
    picture: NDArray[Any], *, mask: NDArray[Any] | None = None, intrinsics: Floats | None = None,
    distortion: Floats | None = None,
) -> Outline:  # fmt: skip
    """Find one ball and its outline.

    Args:
        picture: (y, x), any linear unit: all lights on, or a mean or maximum over pictures with one light each.
        mask: (y, x), non-zero on the ball: replaces the search; its edge counts where the picture shows none.
        intrinsics: (3, 3) of the camera; None takes the camera as orthographic.
        distortion: k1 k2 p1 p2 k3.

    Raises:
        KernelError: no ball, two balls, or a ball cut by the frame.
    """
    given: Outline | None = None
    image = _flattened(picture)
    if mask is not None:
        points = _mask_points(mask)
        given = outline_of_points(points, intrinsics=intrinsics, distortion=distortion, frame=mask.shape)
        ring, r = given.ring_px, given.radius_px
    else:
        x, y, r = _coarse(image)
        height, width = image.shape
        if x - r < 1 or y - r < 1 or x + r > width - 2 or y + r > height - 2:
            raise KernelError(
                f"the ball at ({x:.0f}, {y:.0f}) px, radius {r:.0f} px, is cut by the frame of {width} x {height};"
                " the whole ball must be in the picture"
            )
        ring = _circle(x, y, r)
    outline: Outline | None = None
    # the first ring may be wrong by some pixels; each pass looks closer about the last outline
    for reach, blur in ((max(6.0, 0.06 * r), 2.0), (6.0, 1.5), (3.0, _EDGE_PX), (2.5, _EDGE_PX), (2.5, _EDGE_PX)):
        points, weights = _edge_points(image, ring, reach, blur)
        if len(points) < 12:
            if given is not None:
                return given
            raise KernelError(f"no ball found: only {len(points)} points of its outline stand out; {_BY_HAND}")
        outline = outline_of_points(
            points, intrinsics=intrinsics, distortion=distortion, weights=weights, frame=image.shape
        )
        ring = outline.ring_px
    assert outline is not None
    if given is not None:
        # a mask says which ball; the picture says where, if it shows half of the outline and does not contradict
        moved = float(np.linalg.norm(outline.centre_px - given.centre_px)) + abs(
            outline.radius_px - given.radius_px
        )
        return outline if outline.seen > 0.5 and moved < 0.05 * r else given
    if outline.seen < _LEAST_SEEN:
        raise KernelError(
            f"no ball found: {outline.seen:.0%} of its outline is seen, a quarter is needed; {_BY_HAND}"
        )
    return outline


def _flattened(picture: NDArray[Any]) -> NDArray[np.float32]:
    """Square root (evens out shot noise and faint outlines), without hot pixels."""
    image = np.sqrt(np.clip(picture.astype(np.float32), 0, None))
    middle = cv2.medianBlur(image, 3)
    jump = np.abs(image - middle)
    # only pixels far from their neighbours: a median everywhere rounds whole counts and so moves a faint edge
    noise = float(np.quantile(jump[image > 0], 0.9)) if (image > 0).any() else 0.0
    return np.where(jump > 4 * noise + 1e-6, middle, image)


def _coarse(image: NDArray[np.float32]) -> tuple[float, float, float]:
    """Circle (x, y, r) px by votes of gradient directions, in a small picture."""
    shrink = max(1.0, max(image.shape) / 480)
    size = (round(image.shape[1] / shrink), round(image.shape[0] / shrink))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    # highlights are smaller than this window, the outline is not
    small = cv2.GaussianBlur(median_filter(small, 5), (0, 0), 1.0)
    gx, gy = cv2.Sobel(small, cv2.CV_32F, 1, 0), cv2.Sobel(small, cv2.CV_32F, 0, 1)
    strength = np.hypot(gx, gy)
    real = strength[strength > 0]
    if real.size == 0:
        raise KernelError(f"no ball found: the picture is empty; {_BY_HAND}")
    edge = strength > 4 * np.median(real)
    edge &= _ridge(strength, gx, gy)
    ys, xs = np.nonzero(edge)
    if xs.size > 12000:
        best = np.argsort(-strength[ys, xs], kind="stable")[:12000]
        ys, xs = ys[best], xs[best]
    ux, uy = gx[ys, xs] / strength[ys, xs], gy[ys, xs] / strength[ys, xs]
    first = _best_circle(xs, ys, ux, uy, small.shape)
    if first is None:
        raise KernelError(f"no ball found: no circle stands out in the picture; {_BY_HAND}")
    x, y, r, cover = first
    outside = np.hypot(xs - x, ys - y) > 1.1 * r + 2
    second = _best_circle(xs[outside], ys[outside], ux[outside], uy[outside], small.shape)
    if second is not None and second[3] > max(0.55, 0.6 * cover) and np.hypot(second[0] - x, second[1] - y) > r:
        raise KernelError(
            f"two balls: one at ({x * shrink:.0f}, {y * shrink:.0f}), one at ({second[0] * shrink:.0f},"
            f" {second[1] * shrink:.0f}) px; cover one of them with a mask"
        )
    return (x + 0.5) * shrink - 0.5, (y + 0.5) * shrink - 0.5, r * shrink


def _ridge(strength: NDArray[np.float32], gx: Any, gy: Any) -> NDArray[np.bool_]:
    """Whether the gradient is largest along its own direction (Canny's thinning)."""
    y, x = np.indices(strength.shape, np.float32)
    norm = np.maximum(strength, 1e-9)
    ahead = cv2.remap(strength, x + gx / norm, y + gy / norm, cv2.INTER_LINEAR)
    behind = cv2.remap(strength, x - gx / norm, y - gy / norm, cv2.INTER_LINEAR)
    return np.asarray((strength >= ahead) & (strength > behind))


_Circle = tuple[float, float, float, float]


def _best_circle(xs: Any, ys: Any, ux: Any, uy: Any, shape: tuple[int, ...]) -> _Circle | None:
    """The circle (x, y, r) that edges cover best, and the part of it that they cover."""
    if xs.size < 30:
        return None
    height, width = shape
    radii = np.arange(max(6, 0.05 * min(shape)), 0.75 * max(shape))
    steps = np.concatenate([radii, -radii])
    # a margin around the picture, so that a ball cut by the frame is found and named
    pad = min(shape) // 2
    cx = np.rint(xs[:, None] + ux[:, None] * steps).astype(np.int32) + pad
    cy = np.rint(ys[:, None] + uy[:, None] * steps).astype(np.int32) + pad
    inside = (cx >= 0) & (cx < width + 2 * pad) & (cy >= 0) & (cy < height + 2 * pad)
    # 1 / r, or large circles would win by their length alone
    weight = np.broadcast_to(1 / np.abs(steps), cx.shape)[inside]
    votes: NDArray[Any] = np.bincount(
        cy[inside] * (width + 2 * pad) + cx[inside], weight, (height + 2 * pad) * (width + 2 * pad)
    ).reshape(height + 2 * pad, width + 2 * pad)
    votes = np.asarray(cv2.GaussianBlur(votes, (0, 0), 1.5))
    best: _Circle | None = None
    for _ in range(12):
        y0, x0 = np.unravel_index(int(votes.argmax()), votes.shape)
        cv2.circle(votes, (int(x0), int(y0)), 4, 0.0, -1)
        x, y = float(x0 - pad), float(y0 - pad)
        dx, dy = xs - x, ys - y
        far = np.hypot(dx, dy)
        radial = np.abs(dx * ux + dy * uy) > 0.93 * far
        bins = np.floor((np.arctan2(dy, dx) / (2 * np.pi) + 0.5) * 71.999).astype(np.int64)
        covered = np.zeros((int(radii[-1]) + 3, 72), np.bool_)
        near = radial & (far < radii[-1]) & (far >= radii[0])
        for shift in (-1, 0, 1):
            covered[np.rint(far[near]).astype(np.int64) + shift, bins[near]] = True
        part = covered.mean(1)
        # edges that speak for it, times the part of it that they cover
        r = int((part**2 * np.arange(len(part))).argmax())
        if best is None or part[r] ** 2 * r > best[3] ** 2 * best[2]:
            best = (x, y, float(r), float(part[r]))
    return best if best is not None and best[3] >= _LEAST_COVER else None


def _edge_points(image: NDArray[np.float32], ring: Floats, reach: float, blur: float) -> tuple[Floats, Floats]:
    """Steepest place across the ring, sector by sector: (point, xy) px and weights.

    The slope is taken over a few pixels only: the rim of a mirror ball is often a thin bright line before a
    darker inside, and a step that is fitted to more of it comes to lie outside.
    """
    length = float(np.linalg.norm(np.diff(ring, axis=0, append=ring[:1]), axis=1).sum())
    sectors, fine = max(36, round(length / _SECTOR_PX)), 16
    turn = np.arange(sectors * fine) / (sectors * fine) * len(ring)
    closed = np.vstack([ring, ring[:1]])
    base = np.stack([np.interp(turn, np.arange(len(closed)), closed[:, k]) for k in (0, 1)], 1)
    tangent = np.roll(base, -1, 0) - np.roll(base, 1, 0)
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], 1) / np.linalg.norm(tangent, axis=1, keepdims=True)
    half = round((reach + 3 * blur) * 4)
    offset = np.arange(-half, half + 1) / 4
    at = (base[:, None] + normal[:, None] * offset[:, None]).astype(np.float32)
    samples = cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    samples = samples.reshape(sectors, fine, -1)
    # a mean without the highlights beside the outline; a median would round whole counts to one side
    usual = np.median(samples, axis=1, keepdims=True)
    spread = 2 * float(np.quantile(np.abs(samples - usual), 0.9)) + 1e-6
    profile = np.clip(samples, usual - spread, usual + spread).mean(1).astype(np.float64)
    slope = gaussian_filter1d(profile, 4 * blur, axis=1, order=1)
    size = np.abs(slope)
    allowed = np.abs(offset) <= reach
    best = np.where(allowed, size, 0).argmax(1)
    rows = np.arange(sectors)
    left, mid, right = (size[rows, best + k] for k in (-1, 0, 1))
    bend = left - 2 * mid + right
    sub = np.where(bend < 0, 0.5 * (left - right) / np.where(bend < 0, bend, 1), 0)
    place = (offset[best] + 0.25 * np.clip(sub, -1, 1))[:, None]
    noise = 1.4826 * float(np.median(size[:, ~allowed])) + 1e-9
    clear = (mid > 3 * noise) & (np.abs(offset[best]) < reach - 0.3)
    middle = slice(fine // 2, None, fine)
    return (base[middle] + normal[middle] * place)[clear], np.minimum(mid / noise, 20.0)[clear]


def _mask_points(mask: NDArray[Any]) -> Floats:
    """Edge of the one region of a mask, (point, xy); grey values at its edge count."""
    level = cv2.GaussianBlur(mask.astype(np.float64) / max(float(mask.max()), 1.0), (0, 0), 1.0)
    edges = [e[:, ::-1] for e in find_contours(np.pad(level, 2), 0.5)]
    areas = np.array([abs(float(np.sum(e[:-1, 0] * e[1:, 1] - e[:-1, 1] * e[1:, 0]))) / 2 for e in edges])
    if not edges:
        raise KernelError("no ball found: the mask is empty; mark the ball in it")
    if np.count_nonzero(areas > 0.2 * areas.max()) > 1:
        raise KernelError("two balls: the mask has several regions; leave one in it")
    return np.asarray(edges[int(areas.argmax())] - 2.0)


def _circle(x: float, y: float, r: float) -> Floats:
    turn = np.radians(np.arange(720) / 2)
    return np.stack([x + r * np.cos(turn), y + r * np.sin(turn)], 1)

"""What flows do to pictures: warping along a flow, and the inverse of a flow.

A flow f lives on the grid of its target and pulls: out(x) = picture(x + f(x)). Its inverse g lives on the picture's
grid and undoes it:

    x + f(x) = y   <=>   y + g(y) = x ,      g(y) = -f(y + g(y))

The right-hand equation is solved by fixed-point iteration (Chen et al. 2008, doi:10.1118/1.2816107), which
converges where f changes by less than a pixel per pixel. g = -f, a common shortcut, is wrong by about |grad f| |f|.

Interpolation is at the exact sub-pixel position: cubic convolution with a = -1/2 (Keys 1981,
doi:10.1109/TASSP.1981.1163711), or cubic B-splines through the samples (Unser 1999, doi:10.1109/79.799930).
OpenCV's remap has a = -3/4, spreads NaN over its whole kernel, and rounds positions to 1/32 pixel in some versions
and kernels (in 5.0 for Lanczos only).
"""

from typing import Any, Literal, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lightstage.kernels.pictures.keys_cubic import weights_of_one

Image = NDArray[np.float32]
Interpolation = Literal["linear", "cubic", "spline"]
INTERPOLATIONS: tuple[Interpolation, ...] = ("linear", "cubic", "spline")
KNOWN = 0.25
"""A value beside unknown ones counts if its known neighbours carry this much of the bilinear weight. The nearest
sample alone always carries it."""
_POLE = np.float32(np.sqrt(3.0) - 2.0)
_TAIL = 14
"""The prefilter's mirrored start: pole**14 is below float32's last digit."""
_HALF, _ONE, _NAN = np.float32(0.5), np.float32(1), np.float32(np.nan)
_U1, _U2, _U3 = np.uint64(1), np.uint64(2), np.uint64(3)
_FAST = {"nsz"}
"""No "contract", a product and a sum in one step, and no "arcp", one over a divisor times: whether they pay, and so
the last bit, differs between processors. They gain nothing that can be measured here."""


class Inverse(NamedTuple):
    """The inverse of a flow."""

    flow: Image
    """(xy, y, x), pixels; NaN where not `valid`."""
    valid: NDArray[np.bool_]
    """(y, x): one place, and only one that can be trusted, moves here."""


def warp(pictures: Image, flow: Image, *, interpolation: Interpolation = "cubic") -> Image:
    """Pull pictures along a flow: out(x) = picture(x + flow(x)).

    Args:
        pictures: (..., y, x), may hold NaN.
        flow: (xy, y, x), pixels, on the grid of the result; NaN where unknown.
        interpolation: `linear` (2 x 2 samples), `cubic` (4 x 4, Keys with a = -1/2) or `spline` (cubic B-spline
            through the samples, sharper than `cubic`).

    Returns:
        (..., y, x) on the flow's grid. Where a sample is NaN or outside the picture, the known ones of the nearest
        2 x 2 are averaged with their bilinear weights; NaN where these weights are below KNOWN in sum, or the flow
        is NaN.

    Raises:
        ValueError: the interpolation is none of the three.
    """
    if interpolation not in INTERPOLATIONS:
        raise ValueError(f"interpolation is {interpolation!r}; it must be one of {', '.join(INTERPOLATIONS)}")
    layers = np.ascontiguousarray(pictures, np.float32).reshape(-1, *pictures.shape[-2:])
    flow = np.ascontiguousarray(flow, np.float32)
    out = np.empty((len(layers), *flow.shape[1:]), np.float32)
    if interpolation == "linear":
        _pull_two(layers, flow, out)
    elif interpolation == "cubic":
        _pull_four(layers, layers, flow, False, out)
    else:
        coefficients = layers.copy()
        for layer in coefficients:
            _fill_rows(layer)
            _prefilter(layer)
        _pull_four(layers, coefficients, flow, True, out)
    return out.reshape(*pictures.shape[:-2], *flow.shape[1:])


def warp_vectors(vectors: Image, flow: Image, *, interpolation: Interpolation = "cubic") -> Image:
    """Pull a field of unit vectors (xyz, y, x) along a flow: interpolated as vectors, and of length 1 again."""
    pulled = warp(vectors, flow, interpolation=interpolation)
    return unit(pulled)


def unit(vectors: Image) -> Image:
    """Vectors (xyz, y, x) at length 1; NaN where one has no length."""
    with np.errstate(invalid="ignore", divide="ignore"):
        length = np.sqrt(np.einsum("iyx,iyx->yx", vectors, vectors))
        return np.asarray(vectors / np.where(length > 0, length, np.nan), np.float32)


def invert(
    flow: Image,
    confidence: Image | None = None,
    *,
    tolerance_px: float = 0.01,
    rounds: int = 20,
    stretch: float = 2.0,
    margin: float = 0.1,
) -> Inverse:
    """The flow g with y + g(y) = x where x + flow(x) = y.

    The iteration starts at the place that lands nearest to y. Where places from different parts of the picture land
    on one y, one of them is hidden behind the other: the more confident one is taken, and none if their confidence
    differs by less than `margin`.

    Args:
        flow: (xy, y, x), pixels; NaN where unknown.
        confidence: (y, x), 0 to 1, of the flow; places with 0 or NaN are unknown. All 1 if absent.
        tolerance_px: a place counts if its flow leads back to y within this.
        rounds: most iterations a pixel.
        stretch: areas that grow or shrink by more than this factor are torn or hidden, not moved.
        margin: see above.
    """
    sure = np.ones(flow.shape[1:], np.float32) if confidence is None else np.asarray(confidence, np.float32)
    usable = (sure > 0) & np.isfinite(flow).all(axis=0)
    known = np.ascontiguousarray(np.where(usable, flow, np.float32(np.nan)), np.float32)
    start, rival = _landing(known, sure, stretch)
    out = np.empty_like(known)
    valid = np.empty(known.shape[1:], np.bool_)
    _fixed_point(known, sure, start, rival, _Limits(tolerance_px, rounds, stretch, margin), Inverse(out, valid))
    return Inverse(out, valid)


def seen(flow: Image) -> Image:
    """1 where a point is seen in the picture that the flow leads to, 0 where it is hidden or beyond the border."""
    back = warp(invert(flow).flow, flow, interpolation="linear") + flow
    # wrong by a pixel: another point is there
    return np.asarray(np.hypot(back[0], back[1]) < 1, np.float32)


class _Limits(NamedTuple):
    """When the fixed point is one; see `invert`."""

    tolerance_px: float
    rounds: int
    stretch: float
    margin: float


@njit(nogil=True, cache=True, error_model="numpy")
def _landing(flow: Image, sure: Image, stretch: float) -> tuple[NDArray[np.int32], Image]:
    """Where each pixel comes from, to a pixel, (xy, y, x), and the confidence of the best place that lost.

    Places that land within a pixel of each other are one surface if they were at most `stretch` apart, or two
    pixels: of these the one that lands nearest is kept.
    """
    rows, columns = flow.shape[1:]
    start = np.full((2, rows, columns), -1, np.int32)
    away = np.empty((rows, columns), np.float32)
    rival = np.zeros((rows, columns), np.float32)
    reach = max(stretch, 2.0)
    for y in range(rows):
        for x in range(columns):
            tx, ty = x + flow[0, y, x], y + flow[1, y, x]
            # also false for NaN
            if not (tx > -1 and ty > -1 and tx < columns and ty < rows):
                continue
            left, top = int(np.floor(tx)), int(np.floor(ty))
            for v in range(max(top, 0), min(top + 2, rows)):
                for u in range(max(left, 0), min(left + 2, columns)):
                    d = np.float32((u - tx) ** 2 + (v - ty) ** 2)
                    hx, hy = start[0, v, u], start[1, v, u]
                    wins = hx < 0
                    if not wins:
                        joined = abs(hx - x) <= reach and abs(hy - y) <= reach
                        if joined:
                            wins = d < away[v, u]
                        else:
                            wins = sure[y, x] > sure[hy, hx]
                            rival[v, u] = max(rival[v, u], sure[hy, hx] if wins else sure[y, x])
                    if wins:
                        start[0, v, u], start[1, v, u], away[v, u] = x, y, d
    return start, rival


@njit(nogil=True, cache=True, error_model="numpy", fastmath=_FAST)
def _flow_at(flow_x: Image, flow_y: Image, px: float, py: float) -> tuple[float, float, float]:
    """Bilinear flow from the known ones of the nearest 2 x 2, and the weight that these carry."""
    rows, columns = flow_x.shape
    left, top = int(np.floor(px)), int(np.floor(py))
    t, u = px - left, py - top
    if left >= 0 and top >= 0 and left + 1 < columns and top + 1 < rows:
        x0, y0 = np.uint64(left), np.uint64(top)
        x1, y1 = x0 + _U1, y0 + _U1
        a, b, c, d = (1 - t) * (1 - u), t * (1 - u), (1 - t) * u, t * u
        fx = a * flow_x[y0, x0] + b * flow_x[y0, x1] + c * flow_x[y1, x0] + d * flow_x[y1, x1]
        # NaN is the only value that is not equal to itself
        if fx == fx:
            fy = a * flow_y[y0, x0] + b * flow_y[y0, x1] + c * flow_y[y1, x0] + d * flow_y[y1, x1]
            return fx, fy, 1.0
    known: tuple[float, float, float] = _flow_beside_unknown(flow_x, flow_y, px, py)
    return known


@njit(nogil=True, cache=True, error_model="numpy")
def _flow_beside_unknown(flow_x: Image, flow_y: Image, px: float, py: float) -> tuple[float, float, float]:
    rows, columns = flow_x.shape
    left, top = int(np.floor(px)), int(np.floor(py))
    t, u = px - left, py - top
    fx, fy, total = 0.0, 0.0, 0.0
    for v in range(max(top, 0), min(top + 2, rows)):
        for h in range(max(left, 0), min(left + 2, columns)):
            if flow_x[v, h] == flow_x[v, h]:
                w = (u if v > top else 1.0 - u) * (t if h > left else 1.0 - t)
                fx += w * flow_x[v, h]
                fy += w * flow_y[v, h]
                total += w
    if total > 0:
        return fx / total, fy / total, total
    return 0.0, 0.0, 0.0


@njit(nogil=True, cache=True, error_model="numpy")
def _fixed_point(flow: Image, sure: Image, start: NDArray[np.int32], rival: Image, limits: Any, out: Any) -> None:
    tolerance, rounds, stretch, margin = limits
    inverse, valid = out
    rows, columns = flow.shape[1:]
    flow_x, flow_y = flow[0], flow[1]
    for y in range(rows):
        for x in range(columns):
            inverse[0, y, x] = inverse[1, y, x] = _NAN
            valid[y, x] = False
            sx, sy = start[0, y, x], start[1, y, x]
            if sx < 0:
                continue
            if rival[y, x] > 0 and rival[y, x] > sure[sy, sx] - margin:
                continue
            # the first round, at a sample
            px, py = float(x - flow_x[sy, sx]), float(y - flow_y[sy, sx])
            gone, weight = np.inf, 0.0
            for _ in range(rounds):
                fx, fy, weight = _flow_at(flow_x, flow_y, px, py)
                if weight == 0.0:
                    break
                dx, dy = x - fx - px, y - fy - py
                gone = dx * dx + dy * dy
                if gone <= tolerance * tolerance:
                    break
                px, py = px + dx, py + dy
                # far outside: the iteration ran away
                if not (px > -2 and py > -2 and px < columns + 1 and py < rows + 1):
                    weight = 0.0
                    break
            if weight < KNOWN or gone > tolerance * tolerance:
                continue
            area = _area(flow, int(np.floor(px)), int(np.floor(py)))
            if area * stretch < 1.0 or area > stretch:
                continue
            inverse[0, y, x], inverse[1, y, x] = np.float32(px - x), np.float32(py - y)
            valid[y, x] = True


@njit(nogil=True, cache=True, error_model="numpy")
def _area(flow: Image, left: int, top: int) -> float:
    """det(I + grad f) in the cell of 2 x 2 samples: the factor by which areas grow. 1 where one is unknown."""
    rows, columns = flow.shape[1:]
    if columns < 2 or rows < 2:
        return 1.0
    left, top = min(max(left, 0), columns - 2), min(max(top, 0), rows - 2)
    x0, y0 = np.uint64(left), np.uint64(top)
    x1, y1 = x0 + _U1, y0 + _U1
    fx, fy = flow[0], flow[1]
    xx = 0.5 * (fx[y0, x1] - fx[y0, x0] + fx[y1, x1] - fx[y1, x0])
    xy = 0.5 * (fx[y1, x0] - fx[y0, x0] + fx[y1, x1] - fx[y0, x1])
    yx = 0.5 * (fy[y0, x1] - fy[y0, x0] + fy[y1, x1] - fy[y1, x0])
    yy = 0.5 * (fy[y1, x0] - fy[y0, x0] + fy[y1, x1] - fy[y0, x1])
    area = (1.0 + xx) * (1.0 + yy) - xy * yx
    return area if area == area else 1.0


@njit(nogil=True, cache=True, error_model="numpy", fastmath=_FAST)
def _beside_unknown(layer: Image, px: float, py: float) -> np.float32:
    """The known ones of the nearest 2 x 2, averaged with their bilinear weights."""
    rows, columns = layer.shape
    left, top = int(np.floor(px)), int(np.floor(py))
    t, u = px - left, py - top
    value, total = 0.0, 0.0
    for j in range(2):
        v = top + j
        if v < 0 or v >= rows:
            continue
        wy = u if j else 1.0 - u
        for i in range(2):
            h = left + i
            if h < 0 or h >= columns:
                continue
            a = layer[v, h]
            if a == a:
                w = wy * (t if i else 1.0 - t)
                value += w * a
                total += w
    return np.float32(value / total) if total >= KNOWN else _NAN


@njit(nogil=True, cache=True, error_model="numpy", fastmath=_FAST)
def _pull_two(layers: Image, flow: Image, out: Image) -> None:
    rows, columns = layers.shape[1:]
    count, height, width = out.shape
    for y in range(height):
        for x in range(width):
            px, py = x + flow[0, y, x], y + flow[1, y, x]
            if px >= 0 and py >= 0 and px < columns - 1 and py < rows - 1:
                left, top = int(px), int(py)
                t, u = np.float32(px - left), np.float32(py - top)
                for c in range(count):
                    a, b = layers[c, top, left], layers[c, top, left + 1]
                    d, e = layers[c, top + 1, left], layers[c, top + 1, left + 1]
                    upper, lower = a + t * (b - a), d + t * (e - d)
                    value = upper + u * (lower - upper)
                    out[c, y, x] = value if value == value else _beside_unknown(layers[c], px, py)
            elif px > -1 and py > -1 and px < columns and py < rows:
                for c in range(count):
                    out[c, y, x] = _beside_unknown(layers[c], px, py)
            else:
                for c in range(count):
                    out[c, y, x] = _NAN


@njit(nogil=True, cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _weights(t: Any, spline: bool) -> Any:
    """The weights of four neighbours at fraction t behind the second: cubic B-spline, or Keys."""
    if spline:
        s = _ONE - t
        sixth = np.float32(1 / 6)
        w0, w3 = s * s * s * sixth, t * t * t * sixth
        w1 = np.float32(2 / 3) - t * t * (_ONE - _HALF * t)
        return w0, w1, _ONE - w0 - w1 - w3, w3
    return weights_of_one(t)


@njit(nogil=True, cache=True, error_model="numpy", fastmath=_FAST)
def _pull_four(layers: Image, coefficients: Image, flow: Image, spline: bool, out: Image) -> None:
    """`coefficients` are summed; `layers` say what is known, and are read beside what is not."""
    rows, columns = layers.shape[1:]
    count, height, width = out.shape
    flat = coefficients.reshape(count, -1)
    width_u = np.uint64(columns)
    holes = np.array([np.isnan(layers[c]).any() for c in range(count)])
    for y in range(height):
        for x in range(width):
            px, py = x + flow[0, y, x], y + flow[1, y, x]
            if px >= 1 and py >= 1 and px < columns - 2 and py < rows - 2:
                left, top = int(px), int(py)
                t, u = np.float32(px - left), np.float32(py - top)
                a0, a1, a2, a3 = _weights(t, spline)
                b0, b1, b2, b3 = _weights(u, spline)
                # unsigned: numba would ask each index whether it counts from the end
                n0 = np.uint64((top - 1) * columns + left - 1)
                n1, n2, n3 = n0 + width_u, n0 + width_u * _U2, n0 + width_u * _U3
                for c in range(count):
                    k = flat[c]
                    r0 = a0 * k[n0] + a1 * k[n0 + _U1] + a2 * k[n0 + _U2] + a3 * k[n0 + _U3]
                    r1 = a0 * k[n1] + a1 * k[n1 + _U1] + a2 * k[n1 + _U2] + a3 * k[n1 + _U3]
                    r2 = a0 * k[n2] + a1 * k[n2 + _U1] + a2 * k[n2 + _U2] + a3 * k[n2 + _U3]
                    r3 = a0 * k[n3] + a1 * k[n3 + _U1] + a2 * k[n3 + _U2] + a3 * k[n3 + _U3]
                    value = b0 * r0 + b1 * r1 + b2 * r2 + b3 * r3
                    if spline and holes[c]:
                        # the prefilter filled what is unknown: ask the picture itself
                        known = _ONE * 0
                        for v in range(top - 1, top + 3):
                            for h in range(left - 1, left + 3):
                                known += layers[c, v, h]
                        if known != known:
                            value = _NAN
                    out[c, y, x] = value if value == value else _beside_unknown(layers[c], px, py)
            elif px > -1 and py > -1 and px < columns and py < rows:
                for c in range(count):
                    out[c, y, x] = _beside_unknown(layers[c], px, py)
            else:
                for c in range(count):
                    out[c, y, x] = _NAN


@njit(nogil=True, cache=True, error_model="numpy")
def _fill_rows(layer: Image) -> None:
    """Unknown samples take the nearest known one of their row, in place; 0 in rows without one."""
    rows, columns = layer.shape
    for y in range(rows):
        last = -1
        for x in range(columns):
            if layer[y, x] == layer[y, x]:
                if last < x - 1:
                    for h in range(last + 1, x):
                        near = last >= 0 and h - last <= x - h
                        layer[y, h] = layer[y, last] if near else layer[y, x]
                last = x
        for h in range(last + 1, columns):
            layer[y, h] = layer[y, last] if last >= 0 else np.float32(0)


@njit(nogil=True, cache=True, error_model="numpy")
def _prefilter(layer: Image) -> None:
    """Samples to cubic B-spline coefficients, in place, mirrored at the borders (Unser 1999)."""
    rows, columns = layer.shape
    z = _POLE
    end = z / (z * z - _ONE)
    gain = np.float32(6)
    for y in range(rows):
        line = layer[y]
        first, power = line[0], z
        for x in range(1, min(_TAIL, columns)):
            first += power * line[x]
            power *= z
        line[0] = first * gain
        for x in range(1, columns):
            line[x] = gain * line[x] + z * line[x - 1]
        if columns > 1:
            line[columns - 1] = end * (line[columns - 1] + z * line[columns - 2])
        for x in range(columns - 2, -1, -1):
            line[x] = z * (line[x + 1] - line[x])
    for x in range(columns):
        first, power = layer[0, x], z
        for y in range(1, min(_TAIL, rows)):
            first += power * layer[y, x]
            power *= z
        layer[0, x] = first * gain
    for y in range(1, rows):
        for x in range(columns):
            layer[y, x] = gain * layer[y, x] + z * layer[y - 1, x]
    if rows > 1:
        for x in range(columns):
            layer[rows - 1, x] = end * (layer[rows - 1, x] + z * layer[rows - 2, x])
    for y in range(rows - 2, -1, -1):
        for x in range(columns):
            layer[y, x] = z * (layer[y + 1, x] - layer[y, x])

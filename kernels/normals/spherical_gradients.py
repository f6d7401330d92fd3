"""Normals from spherical gradient illumination: every method is one small table (`gradient_methods.py`)
for one fused kernel.

With r_a for gradient a, r_a' for its complement and r_c for constant light, each method's normal before
normalisation, times 2 r_c (or r_c), is linear in the pictures, so all of them are one pass over memory:

    ratio       (Ma et al. 2007)      r_a / r_c - 1/2        ->  g_a = 2 r_a - r_c
    difference  (Wilson et al. 2010)  r_a - r_a'             ->  g_a = r_a - r_a'
    minimal     (Dutta 2010, 4.5)     base b: g_b = r_b - r_b', the other axes g_a = 2 r_a - (r_b + r_b'),
                                      or its negative with r_a'
    norm = |g| / (2 r_c)              1/3 for ideal Lambertian shading

The QP correction (Dutta 2010, 4.4) has a closed form per axis, because A has full row rank. With
b1 = r_a/r_c - 1/2 and b2 = (r_a - r_a')/r_c:

    n = (9 n0 + 3 b1 + 6 b2) / 14    ->    n ~ 9 g/|g| + (9 r_a - 6 r_a' - 3/2 r_c) / r_c

On specular pictures a method gives u, the mirrored view direction; the normal is the half vector of u and v,
the unit vector from the point to the camera (Ma et al. 2007, 3.2).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lightstage.kernels.encodings import NORMAL_FILL, NORMAL_STEPS
from lightstage.kernels.normals.gradient_methods import Table


class Normals(NamedTuple):
    """What the kernel gives, per pixel."""

    normal: NDArray[np.int16]
    """(xyz, y, x), as `quantised` stores them."""
    constant: NDArray[np.float32]
    """(y, x): r_c; NaN where there is no normal, as in a point without light."""
    norm: NDArray[np.float32]
    """(y, x): |g| / (2 r_c), NaN where there is no normal."""
    valid: NDArray[np.bool_]
    """(y, x)."""

    @classmethod
    def empty(cls, shape: tuple[int, ...]) -> "Normals":
        """Unset arrays for pictures of a shape."""
        f4 = np.float32
        return cls(
            np.empty((3, *shape), np.int16),
            np.empty(shape, f4),
            np.empty(shape, f4),
            np.empty(shape, np.bool_),
        )


def solve(
    pictures: Sequence[NDArray[Any]],
    method: Table,
    *,
    view: NDArray[np.float32] | None = None,
    out: Normals | None = None,
) -> Normals:
    """Apply a table to pictures, in one pass over memory.

    Args:
        pictures: (y, x), one dtype, any linear unit, in the order of `method.pictures`; NaN where not valid.
        method: from `gradient_methods.table`.
        view: (xyz, y, x), unit vectors from the point to the camera, when the pictures are specular.
        out: arrays to write into.
    """
    if out is None:
        out = Normals.empty(pictures[0].shape)
    flat = [np.ascontiguousarray(picture).reshape(-1) for picture in pictures]
    slots = [flat[i] for i in method.slots]
    nx, ny, nz = out.normal.reshape(3, -1)
    towards = None if view is None else np.ascontiguousarray(view, np.float32).reshape(3, -1)
    direction, constant = np.array(method.direction, np.float32), np.array(method.constant, np.float32)
    rest = (out.constant.reshape(-1), out.norm.reshape(-1), out.valid.reshape(-1))
    _solve(*slots, direction, constant, method.qp or None, towards, nx, ny, nz, *rest)
    return out


_STEPS, _HALF, _ONE, _NINE = np.float32(NORMAL_STEPS), np.float32(0.5), np.float32(1), np.float32(9)
_SIX, _THREE_HALVES, _NAN, _FILL = np.float32(6), np.float32(1.5), np.float32(np.nan), np.int32(NORMAL_FILL)


# The branches on `qp` and `view` are pruned when None is passed, so each combination is a loop of its own that
# vectorises. No fast-math flag that would let the compiler assume there is no NaN, and none by which a last bit is
# what pays on a processor: "contract", a product and a sum in one step, and "arcp", one over a divisor times.
# Arrays come one by one: taken out of tuples, the loop with `view` takes 1.7 times as long.
@njit(nogil=True, cache=True, error_model="numpy", fastmath={"nsz"})
def _solve(
    x: Any, xc: Any, y: Any, yc: Any, z: Any, zc: Any, c: Any, b: Any, bc: Any,
    direction: Any, constant: Any, qp: Any, view: Any,
    nx: Any, ny: Any, nz: Any, total: Any, norm: Any, valid: Any,
) -> None:  # fmt: skip
    f = np.float32
    x0, x1, x2, x3 = direction[0]
    y0, y1, y2, y3 = direction[1]
    z0, z1, z2, z3 = direction[2]
    c0, c1, c2 = constant
    for i in range(nx.size):
        rx, rxc, ry, ryc, rz, rzc = f(x[i]), f(xc[i]), f(y[i]), f(yc[i]), f(z[i]), f(zc[i])
        rc, pair = f(c[i]), f(b[i]) + f(bc[i])
        gx = x0 * rx + x1 * rxc + x2 * rc + x3 * pair
        gy = y0 * ry + y1 * ryc + y2 * rc + y3 * pair
        gz = z0 * rz + z1 * rzc + z2 * rc + z3 * pair
        sum_c = c0 * rc + c1 * pair + c2 * (rx + rxc + ry + ryc + rz + rzc)
        square = gx * gx + gy * gy + gz * gz
        good = (square > 0) & (sum_c > 0)  # not so for NaN, nor where there is no light
        length = np.sqrt(square)
        total[i] = sum_c if good else _NAN
        norm[i] = _HALF * length / sum_c if good else _NAN
        valid[i] = good
        if qp is not None:
            s, t = _NINE / length, _ONE / sum_c
            gx = s * gx + t * (_NINE * rx - _SIX * rxc) - _THREE_HALVES
            gy = s * gy + t * (_NINE * ry - _SIX * ryc) - _THREE_HALVES
            gz = s * gz + t * (_NINE * rz - _SIX * rzc) - _THREE_HALVES
            length = np.sqrt(gx * gx + gy * gy + gz * gz)
        if view is not None:
            s = _ONE / length
            gx, gy, gz = s * gx + view[0, i], s * gy + view[1, i], s * gz + view[2, i]
            length = np.sqrt(gx * gx + gy * gy + gz * gz)
        s = _STEPS / length
        nx[i] = np.int16(np.int32(np.floor(gx * s + _HALF)) if good else _FILL)
        ny[i] = np.int16(np.int32(np.floor(gy * s + _HALF)) if good else _FILL)
        nz[i] = np.int16(np.int32(np.floor(gz * s + _HALF)) if good else _FILL)

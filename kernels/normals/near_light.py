"""How a near-light rig shades a point, and the normal that this tells.

Illumination i drives light k with w_ik, so a Lambertian point x with normal n and albedo a shows

    r_i = a sum_k w_ik max(0, n . e_k),    e_k = v_k s_k R^2 (p_k - x) / |p_k - x|^3

with p_k the light's place, s_k its power, R the lights' mean distance from the centre, v_k how much of the
light the point sees. Gradients are driven by (1 +- g_ka) / 2, g_k the unit vector their weights were made from:

    m_a = r_a - r_a' = a sum_k g_ka max(0, n . e_k),    r_c = a sum_k max(0, n . e_k)

`measure` makes m and r_c of the pictures, `invert` finds the n whose m has the measured direction: Newton's
method on the lights above the horizon, M n ~ m with M = sum g_k e_k^T over them.

Sources: Woodham (1980) and Ma et al. (2007) for distant lights; the model of near ones is textbook.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from lightstage.hw.illuminations import AXES, CONSTANT, complement, pairs
from lightstage.kernels.errors import KernelError
from lightstage.kernels.pictures.noise import noise_model
from lightstage.kernels.surface.visibility import in_parts

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LightVectors:
    """The four numbers that a set of gradients tells of each point, by band."""

    vector: NDArray[np.floating]
    """(band, y, x, xyz): m, radiance; 0 where not valid."""
    constant: NDArray[np.floating]
    """(band, y, x): r_c, radiance; 0 where not valid."""
    weight: NDArray[np.floating]
    """(band, y, x): one over the variance of a component of m / r_c; 0 where not valid."""

    def ratio(self) -> Array:
        """(band, y, x, xyz): m / r_c, 0 where not valid."""
        return np.asarray(self.vector / np.maximum(self.constant, 1e-12)[..., None])

    def smaller(self, factor: int) -> "LightVectors":
        """Binned: `factor` x `factor` pixels are one."""
        share = binned((self.weight > 0).astype(float), factor)
        known = np.maximum(share, 1e-9)
        vector = np.stack([binned(self.vector[..., i], factor) / known for i in range(3)], axis=-1)
        weight = binned(self.weight, factor) * factor**2 * (share > 0.5)
        return LightVectors(vector, binned(self.constant, factor) / known, weight)


def binned(values: NDArray[Any], factor: int) -> Array:
    """Means over squares of `factor` x `factor` pixels in the last two dimensions."""
    rows, columns = values.shape[-2] // factor, values.shape[-1] // factor
    cut = values[..., : rows * factor, : columns * factor]
    return np.asarray(cut.reshape(*values.shape[:-2], rows, factor, columns, factor).mean(axis=(-3, -1)))


def measure(bands: Sequence[Mapping[str, NDArray[np.float32]]]) -> LightVectors:
    """m and r_c of each band, by weighted least squares over all its pictures.

    With r_a = (r_c + m_a) / 2 and r_a' = (r_c - m_a) / 2 seven pictures tell four numbers. Weighting each by its
    own shot and read noise gains most on steep components, where one picture of a pair is dark and so precise.

    Args:
        bands: per band, pictures (y, x) by illumination: X Y Z, complements, C, what there is; NaN where not valid.
    """
    measured = [_measure_band(pictures) for pictures in bands]
    vector, constant, weight = (np.stack(parts) for parts in zip(*measured, strict=True))
    return LightVectors(vector, constant, weight)


def _measure_band(pictures: Mapping[str, NDArray[np.float32]]) -> tuple[Array, Array, Array]:
    alpha, beta = noise_model(pictures)
    known = np.isfinite(sum(pictures.values(), np.float32(0)))
    brightest = max(float(np.max(np.where(known, p, 0), initial=0)) for p in pictures.values())
    alpha = max(alpha, 1e-10 * brightest**2, 1e-30)

    def precision(name: str) -> Array:
        # smoothed, so that a pixel's own noise does not choose its weight
        level = cv2.GaussianBlur(np.where(known, np.maximum(pictures[name], 0), 0).astype(np.float64), (0, 0), 1.0)
        return np.asarray(1 / (alpha + beta * level))

    weights = {name: precision(name) for name in pictures}
    total = weights.get(CONSTANT, np.zeros(known.shape))
    constant = total * np.where(known, pictures[CONSTANT], 0) if CONSTANT in pictures else np.zeros(known.shape)
    for gradient, opposite in pairs(pictures):
        both = 1 / (1 / weights[gradient] + 1 / weights[opposite])
        total = total + both
        constant = constant + both * np.where(known, pictures[gradient] + pictures[opposite], 0)
    constant = constant / np.maximum(total, 1e-30)
    vector = np.zeros((*known.shape, 3))
    for i, axis in enumerate(AXES):
        seen = np.zeros(known.shape)
        for name, sign in ((axis, 1), (complement(axis), -1)):
            if name in pictures:
                vector[..., i] += sign * weights[name] * (2 * np.where(known, pictures[name], 0) - constant)
                seen += weights[name]
        vector[..., i] /= seen
    valid = known & (constant > 0) & (np.einsum("yxi,yxi->yx", vector, vector) > 0)
    level = np.maximum(cv2.GaussianBlur(np.where(valid, constant, 0), (0, 0), 1.5), 1e-12)
    # beside a bright rim the smoothed level would vouch for a background whose ratio is noise over nothing
    level = np.minimum(level, 2 * np.maximum(constant, 1e-12))
    weight = np.where(valid, level**2 / (2 * alpha + beta * level), 0)
    kept = (np.where(valid[..., None], vector, 0), np.where(valid, constant, 0), weight)
    return tuple(np.asarray(part, np.float32) for part in kept)  # type: ignore[return-value]


@dataclass(frozen=True)
class Lights:
    """The lights of a rig."""

    position: Array
    """(light, xyz) world, mm."""
    drive: Array
    """(light, xyz): the unit vectors that the gradients' weights were made from."""
    power: Array
    """(light,), relative."""

    @property
    def distance(self) -> float:
        """R: mean distance from the stage's centre, mm."""
        return float(np.linalg.norm(self.position, axis=1).mean())

    @classmethod
    def of(cls, item: Mapping[str, Any], *, near: bool) -> "Lights":
        """From a lights item.

        Args:
            item: what `kernels.items.lights_of` takes of a lights item; a light without a `drive_position` is
                driven from where it is.
            near: whether places are needed; otherwise directions will do.

        Raises:
            KernelError: a light has no position.
        """
        rows = item["lights"]
        without = [row["id"] for row in rows if row["position_mm"] is None]
        if without and near:
            raise KernelError(
                f"the lights item gives {without[0]} a direction only; near-light models need position_mm "
                "(correct: lights works with directions)"
            )
        lengths = [np.linalg.norm(row["position_mm"]) for row in rows if row["position_mm"] is not None]
        usual = float(np.mean(lengths)) if lengths else 1.0
        places = np.array(
            [
                row["position_mm"]
                if row["position_mm"] is not None
                # distant: as bright as a light at the usual distance
                else usual * np.asarray(row["direction"]) / np.linalg.norm(row["direction"])
                for row in rows
            ],
            float,
        )
        drive = np.array(
            [
                row["drive_position"] if row["drive_position"] is not None else place
                for row, place in zip(rows, places, strict=True)
            ],
            float,
        )
        drive /= np.linalg.norm(drive, axis=1, keepdims=True)
        if np.linalg.matrix_rank(drive, tol=1e-3) < 3:
            raise KernelError("the lights lie in one plane; gradients need lights all around")
        return cls(places, drive, np.array([row["power"] for row in rows], float))


@dataclass(frozen=True)
class Response:
    """What the model says at a point: the inverse of its shading."""

    normal: Array
    """(point, xyz), NaN where the vector is."""
    direct: Array
    """(point,): S = sum max(0, n . e_k), r_c of a white point without bounced light."""
    vector: Array
    """(point, xyz): P = sum p_k max(0, n . e_k)."""

    @property
    def norm(self) -> Array:
        """(point,): |P| / S, which |m| / r_c should be."""
        return np.asarray(np.linalg.norm(self.vector, axis=1) / np.maximum(self.direct, 1e-12))


def invert(vector: Array, points: Array, lights: Lights, seen: NDArray[np.float32] | None = None) -> Response:
    """The normal whose shading has the direction of m.

    Args:
        vector: (point, xyz): m, any scale.
        points: (point, xyz) world, mm; for lights taken as distant, zeros.
        lights: the rig's.
        seen: (point, light) visibility, None when all is seen.
    """
    count = len(vector)
    out = Response(np.empty((count, 3)), np.empty(count), np.empty((count, 3)))
    lamps = _Lamps(lights.position, lights.drive, lights.power * lights.distance**2)

    def work(part: slice) -> None:
        _invert(
            np.ascontiguousarray(vector[part], np.float64),
            np.ascontiguousarray(points[part]),
            lamps,
            None if seen is None else seen[part],
            (out.normal[part], out.direct[part], out.vector[part]),
        )

    in_parts(work, count)
    return out


_STEPS = 12
"""Of Newton's method; most points need three."""


class _Lamps(NamedTuple):
    """The lights, for the loop."""

    places: Array
    """(light, xyz), mm."""
    drive: Array
    """(light, xyz)."""
    power: Array
    """(light): s_k R^2."""


@njit(nogil=True, cache=True, error_model="numpy")
def _invert(vector: Any, points: Any, lamps: Any, seen: Any, out: Any) -> None:
    places, drive, power = lamps.places, lamps.drive, lamps.power
    normal, direct, predicted = out
    count = places.shape[0]
    e = np.empty((count, 3))
    for i in range(vector.shape[0]):
        length = np.sqrt(vector[i, 0] ** 2 + vector[i, 1] ** 2 + vector[i, 2] ** 2)
        if not length > 0:
            normal[i] = np.nan
            predicted[i] = np.nan
            direct[i] = np.nan
            continue
        for k in range(count):
            d = places[k] - points[i]
            d2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
            s = power[k] / (d2 * np.sqrt(d2))
            if seen is not None:
                s *= seen[i, k]
            e[k, 0], e[k, 1], e[k, 2] = d[0] * s, d[1] * s, d[2] * s
        u0, u1, u2 = vector[i, 0] / length, vector[i, 1] / length, vector[i, 2] / length
        n0, n1, n2 = u0, u1, u2
        b0, b1, b2 = n0, n1, n2
        t0, t1, t2 = n0, n1, n2
        best, step = 1e9, 1.0
        for _ in range(_STEPS):
            m = np.zeros((3, 3))
            for k in range(count):
                if n0 * e[k, 0] + n1 * e[k, 1] + n2 * e[k, 2] > 0:
                    for a in range(3):
                        for b in range(3):
                            m[a, b] += drive[k, a] * e[k, b]
            p0 = m[0, 0] * n0 + m[0, 1] * n1 + m[0, 2] * n2
            p1 = m[1, 0] * n0 + m[1, 1] * n1 + m[1, 2] * n2
            p2 = m[2, 0] * n0 + m[2, 1] * n1 + m[2, 2] * n2
            size = np.sqrt(p0 * p0 + p1 * p1 + p2 * p2)
            if not size > 0:
                break
            miss = (p0 / size - u0) ** 2 + (p1 / size - u1) ** 2 + (p2 / size - u2) ** 2
            if miss < best:
                best, b0, b1, b2 = miss, n0, n1, n2
            else:
                step *= 0.5  # another set of lights made it worse: go less far, the same way
                n0, n1, n2 = b0 + step * (t0 - b0), b1 + step * (t1 - b1), b2 + step * (t2 - b2)
                size = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
                n0, n1, n2 = n0 / size, n1 / size, n2 / size
                continue
            if best < 1e-14:
                break
            step = 1.0
            # m^-1 u by cofactors
            c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]
            c01 = m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2]
            c02 = m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]
            det = m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02
            if det == 0:
                break
            sign = 1.0 if det > 0 else -1.0
            q0 = sign * (c00 * u0 + (m[0, 2] * m[2, 1] - m[0, 1] * m[2, 2]) * u1
                         + (m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]) * u2)  # fmt: skip
            q1 = sign * (c01 * u0 + (m[0, 0] * m[2, 2] - m[0, 2] * m[2, 0]) * u1
                         + (m[0, 2] * m[1, 0] - m[0, 0] * m[1, 2]) * u2)  # fmt: skip
            q2 = sign * (c02 * u0 + (m[0, 1] * m[2, 0] - m[0, 0] * m[2, 1]) * u1
                         + (m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]) * u2)  # fmt: skip
            size = np.sqrt(q0 * q0 + q1 * q1 + q2 * q2)
            if not size > 0:
                break
            n0, n1, n2 = q0 / size, q1 / size, q2 / size
            t0, t1, t2 = n0, n1, n2
        normal[i, 0], normal[i, 1], normal[i, 2] = b0, b1, b2
        total = 0.0
        predicted[i] = 0.0
        for k in range(count):
            t = b0 * e[k, 0] + b1 * e[k, 1] + b2 * e[k, 2]
            if t > 0:
                total += t
                for a in range(3):
                    predicted[i, a] += drive[k, a] * t
        direct[i] = total


def fused(measured: LightVectors) -> LightVectors:
    """All bands as one: the weighted mean of m / r_c, with r_c = 1."""
    total = measured.weight.sum(axis=0)
    ratio = (measured.weight[..., None] * measured.ratio()).sum(axis=0) / np.maximum(total, 1e-30)[..., None]
    return LightVectors(ratio[None], (total > 0).astype(float)[None], total[None])

"""The subject: a head as a signed distance field, and the light that it sends to the camera.

World frame, millimetres. The field is a smooth union of ellipsoids with a relief of pores and creases on it,
so surface normals are known everywhere.

A head that talks is the same head in a space that is bent a little. The field lives in *material* coordinates m, in
which the head is at rest; a place q of the moving head's own frame shows the material

    m(q) = q - sum_i v_i w_i(q),    w_i = max(0, 1 - |(q - c_i) / r_i|^2)^3,

so that each row (c_i, r_i, v_i) of a *warp* carries the skin around c_i by about v_i (compactly supported radial
functions). The surface is where D(m(q)) = 0, its normal is along J^T grad D with
J = dm/dq, and relief and pigments are functions of m, so they move with the skin. Turning and shifting as a whole
changes rays and lamps instead (`motion.py`), because both stay straight. A warp of None is the head at rest.

Light comes from points at finite distance with inverse-square
fall-off; each is traced to the surface, so cast and attached shadows are there. There is no inter-reflection.

Radiance is in the rig's unit: a white Lambertian surface that faces one light at the stage's radius has 1.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

FLAGS = {"nogil": True, "cache": True, "error_model": "numpy", "fastmath": True}
_BOUND = 175.0  # everything lies within this radius, mm
_MISS = -1.0
_CELL = 3.0  # mm
STRETCH = 1.3
"""A warp may make distances in material space at most this many times those in the head's frame; rays step less."""
Warp = NDArray[np.float64] | None
"""(row, 9): c_i (mm), r_i (mm), v_i (mm), each xyz."""

# centre x, y, z, half axes x, y, z, how softly it joins what is before it (mm)
_PARTS = np.array(
    [
        (0, 22, -12, 74, 92, 88, 0),  # skull
        (0, -34, 16, 55, 70, 60, 22),  # face
        (0, -72, 34, 27, 22, 26, 18),  # chin
        (0, 34, 52, 50, 14, 20, 14),  # brow
        (-30, -18, 42, 20, 20, 22, 14),  # cheeks
        (30, -18, 42, 20, 20, 22, 14),
        (0, -4, 82, 8, 26, 12, 9),  # bridge of the nose
        (0, -21, 92, 13, 10, 13, 8),  # tip of the nose
        (-10, -25, 83, 8, 7, 9, 6),  # wings of the nose
        (10, -25, 83, 8, 7, 9, 6),
        (0, -47, 75, 22, 6, 9, 6),  # lips
        (0, -56, 73, 18, 6, 9, 4),
        (-75, 0, -14, 8, 28, 17, 8),  # ears
        (75, 0, -14, 8, 28, 17, 8),
        (0, -125, -22, 50, 75, 50, 26),  # neck
        (-28, 14, 64, 12, 9, 10, 3),  # eyes
        (28, 14, 64, 12, 9, 10, 3),
    ],
    dtype=np.float64,
)


def parts(seed: int) -> NDArray[np.float64]:
    """The ellipsoids of one head: (part, 7). Seeds vary the proportions by a few percent; seed 0 is the mean."""
    generator = np.random.default_rng([seed, 1])
    spread = 0.0 if seed == 0 else 1.0
    shape = _PARTS.copy()
    both = 1 + spread * 0.04 * generator.standard_normal(3)
    shape[:, 0:3] *= both
    shape[:, 3:6] *= both
    own = 1 + spread * 0.05 * generator.standard_normal((len(shape), 3))
    for left, right in ((4, 5), (8, 9), (12, 13), (15, 16)):
        own[right] = own[left]
    shape[:, 3:6] *= own
    return shape


def _waves() -> NDArray[np.float64]:
    """(wave, 5): wave vector (rad/mm), phase, amplitude (mm) of pores (2 to 6 mm) and folds (15 to 30 mm)."""
    generator = np.random.default_rng(7)
    rows = []
    for length, amplitude in [(2.2 * 1.14**i, 0.012 * 1.14**i) for i in range(8)] + [
        (16.0, 0.12),
        (27.0, 0.25),
    ]:
        direction = generator.standard_normal(3)
        direction /= np.linalg.norm(direction)
        rows.append((*(direction * 2 * np.pi / length), generator.uniform(0, 2 * np.pi), amplitude))
    return np.array(rows)


_WAVES = _waves()


@njit(**FLAGS)
def _relief(x: float, y: float, z: float) -> float:
    """Height of the skin's relief, mm."""
    total = 0.0
    for i in range(_WAVES.shape[0]):
        total += _WAVES[i, 4] * math.sin(_WAVES[i, 0] * x + _WAVES[i, 1] * y + _WAVES[i, 2] * z + _WAVES[i, 3])
    return total


@njit(**FLAGS)
def _distance(shape: NDArray[np.float64], x: float, y: float, z: float, relief: bool) -> float:
    """Signed distance to the head, a lower bound away from it."""
    total = 1e9
    for i in range(shape.shape[0]):
        a, b, c = shape[i, 3], shape[i, 4], shape[i, 5]
        px, py, pz = (x - shape[i, 0]) / a, (y - shape[i, 1]) / b, (z - shape[i, 2]) / c
        k0 = math.sqrt(px * px + py * py + pz * pz)
        qx, qy, qz = px / a, py / b, pz / c
        k1 = math.sqrt(qx * qx + qy * qy + qz * qz)
        d = k0 * (k0 - 1.0) / k1 if k1 > 1e-9 else -min(a, min(b, c))
        s = shape[i, 6]
        if s <= 0:
            total = min(total, d)
        else:
            h = max(s - abs(total - d), 0.0) / s
            total = min(total, d) - h * h * s * 0.25
    return total - _relief(x, y, z) if relief else total


@njit(**FLAGS)
def _material(warp: Warp, x: float, y: float, z: float) -> tuple[float, float, float]:
    """The material m that is at a place of the head's frame."""
    if warp is None:
        return x, y, z
    mx, my, mz = x, y, z
    for i in range(warp.shape[0]):
        px, py, pz = (x - warp[i, 0]) / warp[i, 3], (y - warp[i, 1]) / warp[i, 4], (z - warp[i, 2]) / warp[i, 5]
        s = 1.0 - px * px - py * py - pz * pz
        if s > 0:
            w = s * s * s
            mx -= warp[i, 6] * w
            my -= warp[i, 7] * w
            mz -= warp[i, 8] * w
    return mx, my, mz


@njit(**FLAGS)
def _carried(
    warp: Warp, x: float, y: float, z: float, gx: float, gy: float, gz: float
) -> tuple[float, float, float]:
    """J^T g at a place (x, y, z) of the head's frame, for a gradient g in material space."""
    if warp is None:
        return gx, gy, gz
    ox, oy, oz = gx, gy, gz
    for i in range(warp.shape[0]):
        px, py, pz = (x - warp[i, 0]) / warp[i, 3], (y - warp[i, 1]) / warp[i, 4], (z - warp[i, 2]) / warp[i, 5]
        s = 1.0 - px * px - py * py - pz * pz
        if s > 0:
            along = 6.0 * s * s * (warp[i, 6] * gx + warp[i, 7] * gy + warp[i, 8] * gz)  # -(v.g) dw/ds ds/dp
            ox += along * px / warp[i, 3]
            oy += along * py / warp[i, 4]
            oz += along * pz / warp[i, 5]
    return ox, oy, oz


@njit(**FLAGS)
def material(points: NDArray[np.float64], warp: Warp) -> NDArray[np.float64]:
    """The material at points (point, xyz) of the head's frame, mm."""
    out = np.empty_like(points)
    for i in range(points.shape[0]):
        out[i, 0], out[i, 1], out[i, 2] = _material(warp, points[i, 0], points[i, 1], points[i, 2])
    return out


@njit(**FLAGS)
def place(materials: NDArray[np.float64], warp: Warp) -> NDArray[np.float64]:
    """Where material (point, xyz) is in the head's frame, mm: the inverse of `material`, to 1e-9 mm.

    q <- m + (q - m(q)) contracts by STRETCH - 1 a step.
    """
    out = materials.copy()
    for i in range(out.shape[0]):
        for _ in range(60):
            x, y, z = out[i, 0], out[i, 1], out[i, 2]
            mx, my, mz = _material(warp, x, y, z)
            ex, ey, ez = materials[i, 0] - mx, materials[i, 1] - my, materials[i, 2] - mz
            out[i, 0], out[i, 1], out[i, 2] = x + ex, y + ey, z + ez
            if ex * ex + ey * ey + ez * ez < 1e-20:
                break
    return out


@njit(**FLAGS)
def coarse_field(shape: NDArray[np.float64]) -> NDArray[np.float32]:
    """The distance without relief on a grid of _CELL mm over the bounding cube, (x, y, z): what rays leap by."""
    count = int(2 * _BOUND / _CELL) + 2
    field = np.empty((count, count, count), np.float32)
    for i in range(count):
        for j in range(count):
            for k in range(count):
                field[i, j, k] = _distance(shape, i * _CELL - _BOUND, j * _CELL - _BOUND, k * _CELL - _BOUND, False)
    return field


@njit(**FLAGS)
def bent_field(shape: NDArray[np.float64], field: NDArray[np.float32], warp: Warp) -> NDArray[np.float32]:
    """`coarse_field` of a bent head, in the head's frame: made anew within the warp's reach, the same elsewhere."""
    if warp is None:
        return field
    out = field.copy()
    top = field.shape[0] - 1
    for r in range(warp.shape[0]):
        low, high = np.empty(3, np.int64), np.empty(3, np.int64)
        for a in range(3):
            low[a] = max(0, int((warp[r, a] - warp[r, 3 + a] + _BOUND) / _CELL))
            high[a] = min(top, int((warp[r, a] + warp[r, 3 + a] + _BOUND) / _CELL) + 1)
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    x, y, z = i * _CELL - _BOUND, j * _CELL - _BOUND, k * _CELL - _BOUND
                    mx, my, mz = _material(warp, x, y, z)
                    if mx != x or my != y or mz != z:
                        out[i, j, k] = _distance(shape, mx, my, mz, False)
    return out


@njit(**FLAGS)
def _look_up(field: NDArray[np.float32], x: float, y: float, z: float) -> float:
    """Trilinear; the point must lie within the bounding cube."""
    fx, fy, fz = (x + _BOUND) / _CELL, (y + _BOUND) / _CELL, (z + _BOUND) / _CELL
    i, j, k = int(fx), int(fy), int(fz)
    u, v, w = fx - i, fy - j, fz - k
    a = (field[i, j, k] * (1 - w) + field[i, j, k + 1] * w) * (1 - v)
    a += (field[i, j + 1, k] * (1 - w) + field[i, j + 1, k + 1] * w) * v
    b = (field[i + 1, j, k] * (1 - w) + field[i + 1, j, k + 1] * w) * (1 - v)
    b += (field[i + 1, j + 1, k] * (1 - w) + field[i + 1, j + 1, k + 1] * w) * v
    return float(a * (1 - u) + b * u)


@njit(**FLAGS)
def _enter(px: float, py: float, pz: float, dx: float, dy: float, dz: float) -> float:
    """Distance along a ray to the bounding sphere, 0 inside, negative when it misses."""
    b = px * dx + py * dy + pz * dz
    c = px * px + py * py + pz * pz - _BOUND * _BOUND
    if c <= 0:
        return 0.0
    h = b * b - c
    return -b - math.sqrt(h) if h > 0 and b < 0 else _MISS


@njit(**FLAGS)
def _trace(
    shape: NDArray[np.float64],
    field: NDArray[np.float32],
    warp: Warp,
    origin: NDArray[np.float64],
    ray: NDArray[np.float64],
) -> float:
    """Distance to the first hit, or _MISS: leaps through the coarse field, then small steps on the exact one."""
    ox, oy, oz = origin
    dx, dy, dz = ray
    t = _enter(ox, oy, oz, dx, dy, dz)
    if t < 0:
        return _MISS
    t += 1e-3
    end = t + 2 * _BOUND
    d = 1.0
    for _ in range(400):
        x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
        if t > end or x * x + y * y + z * z > _BOUND * _BOUND:
            return _MISS
        d = _look_up(field, x, y, z)
        if warp is None:
            if d > 3.0:
                t += 0.85 * d - 1.0
                continue
            d = _distance(shape, x, y, z, True)
            if d < 1e-3:
                return float(t)
            t += max(0.75 * d, 2e-3)
        else:
            if d > 3.0:
                t += (0.85 * d - 1.0) / STRETCH
                continue
            mx, my, mz = _material(warp, x, y, z)
            d = _distance(shape, mx, my, mz, True)
            if d < 1e-3:
                return float(t)
            t += max(0.75 * d / STRETCH, 2e-3)
    return float(t) if d < 0.3 else _MISS


@njit(**FLAGS)
def _lit(field: NDArray[np.float32], x: float, y: float, z: float, lx: float, ly: float, lz: float) -> float:
    """Visibility of a light in direction l, from 0 to 1: soft over the size of an LED seen from the head."""
    t, visible = 1.2, 1.0
    for _ in range(64):
        px, py, pz = x + t * lx, y + t * ly, z + t * lz
        if px * px + py * py + pz * pz > _BOUND * _BOUND:
            break
        d = _look_up(field, px, py, pz)
        visible = min(visible, 0.5 + 60.0 * d / t)
        if visible <= 0:
            return 0.0
        t += max(0.8 * d, 0.8)
    return min(1.0, visible)


@njit(**FLAGS)
def _shade(
    field: NDArray[np.float32],
    point: NDArray[np.float64],
    normal: NDArray[np.float64],
    to_camera: NDArray[np.float64],
    lights: NDArray[np.float64],
    radius: float,
    drive: NDArray[np.float64],
    gloss: float,
    diffuse: NDArray[np.float64],
    specular: NDArray[np.float64],
) -> None:
    """Add the light of all lamps to one pixel: Lambert per unit albedo, and GGX (Walter et al. 2007)."""
    alpha2 = gloss * gloss
    nv = max(normal[0] * to_camera[0] + normal[1] * to_camera[1] + normal[2] * to_camera[2], 1e-3)
    for k in range(lights.shape[0]):
        lx, ly, lz = lights[k, 0] - point[0], lights[k, 1] - point[1], lights[k, 2] - point[2]
        square = lx * lx + ly * ly + lz * lz
        length = math.sqrt(square)
        lx, ly, lz = lx / length, ly / length, lz / length
        nl = normal[0] * lx + normal[1] * ly + normal[2] * lz
        if nl <= 0:
            continue
        seen = _lit(field, point[0], point[1], point[2], lx, ly, lz)
        if seen <= 0:
            continue
        light = seen * nl * radius * radius / square
        hx, hy, hz = lx + to_camera[0], ly + to_camera[1], lz + to_camera[2]
        h = math.sqrt(hx * hx + hy * hy + hz * hz)
        nh = (normal[0] * hx + normal[1] * hy + normal[2] * hz) / h
        vh = max((to_camera[0] * hx + to_camera[1] * hy + to_camera[2] * hz) / h, 0.0)
        w = nh * nh * (alpha2 - 1) + 1
        spread = alpha2 / (math.pi * w * w)
        mask_l = nl + math.sqrt(alpha2 + (1 - alpha2) * nl * nl)
        mask_v = nv + math.sqrt(alpha2 + (1 - alpha2) * nv * nv)
        fresnel = 0.028 + 0.972 * (1 - vh) ** 5
        shine = math.pi * spread * fresnel / (mask_l * mask_v)  # pi: the unit of radiance
        for i in range(drive.shape[0]):
            diffuse[i] += drive[i, k] * light
            specular[i] += drive[i, k] * light * shine


@njit(**FLAGS)
def surface(
    shape: NDArray[np.float64],
    field: NDArray[np.float32],
    warp: Warp,
    rays: NDArray[np.float64],
    origin: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where rays meet the head, all in the head's frame.

    Args:
        shape: from `parts`.
        field: from `bent_field` with this warp; that of no warp is `coarse_field`.
        warp: how it is bent, or None.
        rays: (ray, xyz), unit.
        origin: (xyz,) of the camera.

    Returns:
        distance (ray,), negative for a miss; normal (ray, xyz).
    """
    count = rays.shape[0]
    distance = np.empty(count)
    normal = np.zeros((count, 3))
    for i in range(count):
        dx, dy, dz = rays[i]
        t = _trace(shape, field, warp, origin, rays[i])
        distance[i] = t
        if t < 0:
            continue
        x, y, z = origin[0] + t * dx, origin[1] + t * dy, origin[2] + t * dz
        if warp is None:
            mx, my, mz = x, y, z
        else:
            mx, my, mz = _material(warp, x, y, z)
        e = 0.02
        gx = _distance(shape, mx + e, my, mz, True) - _distance(shape, mx - e, my, mz, True)
        gy = _distance(shape, mx, my + e, mz, True) - _distance(shape, mx, my - e, mz, True)
        gz = _distance(shape, mx, my, mz + e, True) - _distance(shape, mx, my, mz - e, True)
        if warp is not None:
            gx, gy, gz = _carried(warp, x, y, z, gx, gy, gz)
        g = math.sqrt(gx * gx + gy * gy + gz * gz)
        normal[i, 0], normal[i, 1], normal[i, 2] = gx / g, gy / g, gz / g
    return distance, normal


@njit(**FLAGS)
def first_hit(
    shape: NDArray[np.float64],
    field: NDArray[np.float32],
    warp: Warp,
    rays: NDArray[np.float64],
    origin: NDArray[np.float64],
) -> NDArray[np.float64]:
    """`surface` without normals: the distance (ray,) alone."""
    distance = np.empty(rays.shape[0])
    for i in range(rays.shape[0]):
        distance[i] = _trace(shape, field, warp, origin, rays[i])
    return distance


@njit(**FLAGS)
def shading(
    field: NDArray[np.float32],
    rays: NDArray[np.float64],
    origin: NDArray[np.float64],
    distance: NDArray[np.float64],
    normal: NDArray[np.float64],
    lights: NDArray[np.float64],
    radius: float,
    drive: NDArray[np.float64],
    gloss: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Diffuse radiance per unit albedo and specular radiance, (ray, illumination).

    Args:
        lights: (light, xyz) mm, in the head's frame as everything here.
        radius: of the stage, mm.
        drive: (illumination, light), 0 to 1.
        gloss: GGX alpha.
    """
    count = rays.shape[0]
    diffuse = np.zeros((count, drive.shape[0]))
    specular = np.zeros((count, drive.shape[0]))
    for i in range(count):
        if distance[i] >= 0:
            point = origin + distance[i] * rays[i]
            _shade(field, point, normal[i], -rays[i], lights, radius, drive, gloss, diffuse[i], specular[i])
    return diffuse, specular


def pigments(points: NDArray[np.float64], seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Melanin and haemoglobin of material points (..., xyz), optical depths at 576 nm.

    Blotches on three scales, freckles over the cheeks, redder cheeks, nose and lips. Seeds vary the skin tone.
    """
    generator = np.random.default_rng([seed, 2])
    tone = float(np.clip(0.22 * np.exp(0.5 * generator.standard_normal()), 0.08, 0.6)) if seed else 0.22
    x, y, z = np.moveaxis(points, -1, 0)
    melanin = np.ones(x.shape)
    blood = np.ones(x.shape)
    for length in (60.0, 23.0, 9.0):
        waves = generator.standard_normal((6, 3)) * 2 * np.pi / length
        phases = generator.uniform(0, 2 * np.pi, 6)
        for field, wave, phase in zip((melanin, blood) * 3, waves, phases, strict=True):
            field += 0.05 * np.sin(points @ wave + phase)
    freckles = np.sin(0.9 * x + 0.7 * np.sin(0.8 * y)) * np.sin(0.85 * y + 0.6 * np.sin(0.7 * x))
    cheeks = np.exp(-(((np.abs(x) - 34) / 18) ** 2 + ((y + 12) / 20) ** 2)) * (z > 0)
    melanin += 1.1 * np.clip(freckles - 0.75, 0, None) / 0.25 * (0.25 + cheeks)
    lips = np.exp(-((x / 22) ** 4 + ((y + 51) / 9) ** 4)) * (z > 40)
    nose = np.exp(-((x / 14) ** 2 + ((y + 20) / 14) ** 2)) * (z > 60)
    blood *= 1 + 0.7 * cheeks + 0.5 * nose + 2.2 * lips
    return tone * np.clip(melanin, 0.05, None), 0.11 * np.clip(blood, 0.05, None)

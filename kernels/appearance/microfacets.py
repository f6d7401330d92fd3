"""How a rough dielectric reflects: the GGX lobe, and what a rig of lights, or a sphere of light, shows of it.

Radiance is in the unit of this project: a white Lambertian surface that faces a light of strength 1 shows 1, so a
specular surface of normal n, seen from v and lit from l, h the unit vector between l and v, shows

    f(l) = pi D(n.h) F(v.h) (n.l) / ((n.l + M(n.l)) (n.v + M(n.v))),     M(c) = sqrt(a^2 + (1 - a^2) c^2)
    D(c) = a^2 / (pi (c^2 (a^2 - 1) + 1)^2)                              (GGX, width a; separable Smith shadowing)
    F(c) = w R(c),   R Fresnel's reflectance of a dielectric, unpolarised light

The refractive index is given (1.4 for skin): it decides how much brighter grazing light is. One measurement of
brightness tells the intensity w, and with it the reflectance at normal incidence, w R(1).

A rig in which light k drives gradient a with (1 + g_ka) / 2 tells of a specular point its constant light and its
vector

    s = sum_k e_k f(l_k),    m = sum_k g_k e_k f(l_k),    norm = |m| / (2 s)

1/2 for a mirror, and the less the wider the lobe: so the norm tells a.

Sources: Walter et al. (2007), EGSR, equations 33 to 34, for GGX, 22 for R;
Ma et al. (2007) for specular gradients.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lightstage.kernels.normals.near_light import Lights
from lightstage.kernels.surface.visibility import in_parts

Array = NDArray[np.float64]

_EDGE_ON = 1e-3
"""Least n.v: a visible pixel whose normal points away has a wrong normal."""


def at_normal_incidence(index: float) -> float:
    """R(1): the reflectance of a dielectric of a refractive index, head on."""
    return ((index - 1) / (index + 1)) ** 2


@njit(nogil=True, cache=True, inline="always")
def lobe(nl: float, nv: float, nh: float, vh: float, alpha: float, index: float) -> float:
    """f for w = 1; cosines between normal, light, view and half vector; 0 from below the surface."""
    if nl <= 0.0:
        return 0.0
    a2 = alpha * alpha
    w = nh * nh * (a2 - 1.0) + 1.0
    spread = a2 / (w * w)  # pi D
    mask_l = nl + np.sqrt(a2 + (1.0 - a2) * nl * nl)
    mask_v = nv + np.sqrt(a2 + (1.0 - a2) * nv * nv)
    g = np.sqrt(index * index - 1.0 + vh * vh)
    part = (g - vh) / (g + vh)
    other = (vh * (g + vh) - 1.0) / (vh * (g - vh) + 1.0)
    fresnel = 0.5 * part * part * (1.0 + other * other)
    return float(spread * fresnel * nl / (mask_l * mask_v))


@njit(nogil=True, cache=True)
def _shine(normal: Any, point: Any, view: Any, place: Any, reach: float, alpha: float, index: float) -> float:
    """e f of one light at a point: its fall-off, relative to the distance `reach`, and the lobe."""
    lx, ly, lz = place[0] - point[0], place[1] - point[1], place[2] - point[2]
    square = lx * lx + ly * ly + lz * lz
    length = np.sqrt(square)
    lx, ly, lz = lx / length, ly / length, lz / length
    nl = normal[0] * lx + normal[1] * ly + normal[2] * lz
    if nl <= 0.0:
        return 0.0
    hx, hy, hz = lx + view[0], ly + view[1], lz + view[2]
    h = np.sqrt(hx * hx + hy * hy + hz * hz)
    if h <= 0.0:
        return 0.0
    nh = (normal[0] * hx + normal[1] * hy + normal[2] * hz) / h
    vh = max((view[0] * hx + view[1] * hy + view[2] * hz) / h, 0.0)
    nv = max(normal[0] * view[0] + normal[1] * view[1] + normal[2] * view[2], _EDGE_ON)
    return float(lobe(nl, nv, nh, vh, alpha, index) * reach * reach / square)


def shines(
    normal: Array, points: Array, view: Array, alpha: Array, places: Array, reach: float, index: float
) -> NDArray[np.float32]:
    """(point, light): specular radiance under each light of strength 1, for w = 1, nothing in the way.

    Args:
        normal, view: (point, xyz), unit vectors, world; to the camera.
        points: (point, xyz), mm.
        alpha: (point,), GGX width.
        places: (light, xyz), mm.
        reach: distance, mm, at which a light has its strength.
        index: refractive.
    """
    out = np.empty((len(points), len(places)), np.float32)

    def work(part: slice) -> None:
        surface = _Surface(normal[part], points[part], view[part])
        _shines(surface, alpha[part], places, reach, index, out[part])

    in_parts(work, len(points))
    return out


@njit(nogil=True, cache=True)
def _shines(surface: Any, alpha: Any, places: Any, reach: float, index: float, out: Any) -> None:
    normal, points, view = surface
    for i in range(points.shape[0]):
        for k in range(places.shape[0]):
            out[i, k] = _shine(normal[i], points[i], view[i], places[k], reach, alpha[i], index)


def response(
    normal: Array,
    points: Array,
    view: Array,
    lights: Lights,
    alphas: Array,
    index: float,
    seen: NDArray[np.float32] | None = None,
) -> tuple[Array, Array]:
    """What the rig's constant light and gradients show of lobes of some widths, for w = 1.

    Args:
        normal, points, view: (point, xyz), as in `shines`.
        lights: the rig's.
        alphas: (width,).
        index: refractive.
        seen: (point, light) from 0 to 1; None when all is seen.

    Returns:
        s (width, point) and m (width, point, xyz).
    """
    constant = np.zeros((len(alphas), len(points)))
    vector = np.zeros((len(alphas), len(points), 3))
    lamps = _Lamps(lights.position, lights.drive, lights.power, lights.distance)
    lobes = _Lobes(np.asarray(alphas, np.float64), index)

    def work(part: slice) -> None:
        surface = _Surface(normal[part], points[part], view[part])
        shown = None if seen is None else seen[part]
        _response(surface, lamps, lobes, shown, constant[:, part], vector[:, part])

    in_parts(work, len(points))
    return constant, vector


class _Surface(NamedTuple):
    """Points of a surface, (point, xyz): unit normals, places in mm, unit vectors to the camera."""

    normal: Array
    points: Array
    view: Array


class _Lamps(NamedTuple):
    """The lights, for the loop."""

    places: Array
    """(light, xyz), mm."""
    drive: Array
    """(light, xyz)."""
    power: Array
    """(light)."""
    reach: float
    """Where a light has its power, mm."""


class _Lobes(NamedTuple):
    """Widths (width), and the refractive index."""

    alphas: Array
    refraction: float


@njit(nogil=True, cache=True)
def _response(surface: Any, lamps: Any, lobes: Any, seen: Any, constant: Any, vector: Any) -> None:
    normal, points, view = surface
    places, drive, power, reach = lamps
    alphas, index = lobes
    for i in range(points.shape[0]):
        for k in range(places.shape[0]):
            part = power[k]
            if seen is not None:
                part *= seen[i, k]
            if part <= 0.0:
                continue
            for a in range(alphas.shape[0]):
                s = part * _shine(normal[i], points[i], view[i], places[k], reach, alphas[a], index)
                constant[a, i] += s
                for axis in range(3):
                    vector[a, i, axis] += drive[k, axis] * s


_RINGS, _SPOKES = 400, 256


def sphere_response(facing: Array, alphas: Array, index: float) -> tuple[Array, Array]:
    """What ideal gradients on a whole sphere of light show of lobes, for w = 1, by quadrature.

    The sphere has as much light as one under which a white surface shows 1.

    Args:
        facing: (angle,), n.v.
        alphas: (width,).
        index: refractive.

    Returns:
        s and the norm, both (width, angle).
    """
    z = 1 - (np.arange(_RINGS) + 0.5) / _RINGS  # the hemisphere above n = (0, 0, 1), equal areas
    azimuth = 2 * np.pi * (np.arange(_SPOKES) + 0.5) / _SPOKES
    across = np.sqrt(1 - z**2)
    light = np.stack(
        [np.outer(across, np.cos(azimuth)), np.outer(across, np.sin(azimuth)), np.outer(z, np.ones(_SPOKES))],
        axis=-1,
    ).reshape(-1, 3)
    constant, norm = np.empty((2, len(alphas), len(facing)))
    up = np.array([[0.0, 0.0, 1.0]])
    for j, nv in enumerate(facing):
        view = np.array([[np.sqrt(max(1 - nv * nv, 0.0)), 0.0, nv]])
        for i, alpha in enumerate(alphas):
            f = shines(up, np.zeros((1, 3)), view, np.array([alpha]), light, 1.0, index)[0].astype(np.float64)
            # strength 2 / N each: a white surface then shows the mean of 2 n.l over the hemisphere, 1
            constant[i, j] = 2 * f.mean()
            norm[i, j] = 0.5 * np.linalg.norm(f @ light) / max(f.sum(), 1e-30)
    return constant, norm

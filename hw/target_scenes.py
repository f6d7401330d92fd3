"""What calibration targets look like, before a sensor: highlights on a ball, boards, and polarised reflections.

World frame and millimetres as everywhere; a picture here is (y, x) float64, counts of a perfect sensor. Pixel
(0, 0) is the centre of the top-left pixel.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

Array = NDArray[np.float64]
PSF_PX = 0.8
"""Standard deviation of the lens' Gaussian blur."""
CUP_RADIUS_MM, CUP_RIM_MM, CUP_HEIGHT_MM, POST_RADIUS_MM = 23.0, 8.0, 22.0, 10.0
"""The stand: a cup whose rim is 8 mm above the ball's lowest point, on a post."""
CHROMIUM = complex(3.1, 3.3)
"""Refractive index near 590 nm, rounded (Johnson and Christy 1974, doi:10.1103/PhysRevB.9.5056)."""
PLASTIC = complex(1.52, 0.0)
"""A snooker ball."""


@dataclass(frozen=True)
class Highlights:
    """Where a ball mirrors each light into the camera, (light, ...)."""

    point_mm: Array
    """(light, xyz) on the ball."""
    normal: Array
    """(light, xyz), unit."""
    pixel: Array
    """(light, xy) in the reference camera."""
    visible: NDArray[np.bool_]
    """False behind the stand."""
    incidence_deg: Array


def project(points: Array, matrix: Array, camera_mm: float) -> Array:
    """World points (..., xyz) -> pixels (..., xy) of the reference camera at (0, 0, camera_mm)."""
    # camera x right, y down, z forward; world x right, y up, z towards the camera
    depth = camera_mm - points[..., 2]
    u = matrix[0, 0] * points[..., 0] / depth + matrix[0, 2]
    v = -matrix[1, 1] * points[..., 1] / depth + matrix[1, 2]
    return np.stack([u, v], axis=-1)


def highlights(lights: Array, centre: Array, radius_mm: float, matrix: Array, camera_mm: float) -> Highlights:
    """The mirror point of each light: incidence equals reflection, by bisection of the angle in the plane of the
    light, the ball's centre and the camera (Alhazen's problem).

    Args:
        lights: (light, xyz), mm.
        centre: (xyz,) of the ball, mm.
    """
    eye = np.array([0.0, 0.0, camera_mm])
    to_eye, to_light = eye - centre, lights - centre
    e1 = np.broadcast_to(to_eye / np.linalg.norm(to_eye), lights.shape)
    across = to_light - np.sum(to_light * e1, axis=1, keepdims=True) * e1
    e2 = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    low = np.zeros(len(lights))
    high = np.arctan2(np.sum(to_light * e2, axis=1), np.sum(to_light * e1, axis=1))

    def at(angle: Array) -> tuple[Array, Array, Array]:
        n = np.cos(angle)[:, None] * e1 + np.sin(angle)[:, None] * e2
        view, light = to_eye - radius_mm * n, to_light - radius_mm * n
        cosine = [np.sum(n * d, axis=1) / np.linalg.norm(d, axis=1) for d in (view, light)]
        return n, cosine[0], cosine[1]

    for _ in range(60):
        middle = (low + high) / 2
        _, view, light = at(middle)
        nearer_eye = view > light
        low, high = np.where(nearer_eye, middle, low), np.where(nearer_eye, high, middle)
    normal, cosine, _ = at((low + high) / 2)
    point = centre + radius_mm * normal
    base = centre - np.array([0.0, radius_mm - CUP_RIM_MM, 0.0])
    free = (cosine > 0.02) & ~_behind_stand(point, lights, base) & ~_behind_stand(point, eye[None], base)
    incidence = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return Highlights(point, normal, project(point, matrix, camera_mm), free, incidence)


def _behind_stand(start: Array, end: Array, rim: Array) -> NDArray[np.bool_]:
    """Whether the way from start to end (light, xyz) passes through the cup or the post under its rim."""
    way = np.linspace(0, 1, 400)[:, None, None]
    place = (start + way * (end - start)) - rim
    wide = np.where(place[..., 1] > -CUP_HEIGHT_MM, CUP_RADIUS_MM, POST_RADIUS_MM)
    inside = (place[..., 1] < 0) & (np.hypot(place[..., 0], place[..., 2]) < wide)
    return np.asarray(inside.any(axis=0))


def spots(shape: tuple[int, int], pixel: Array, flux: Array) -> Array:
    """Gaussian spots, integrated over each pixel: (y, x) whose sum over a spot is its `flux`.

    Args:
        pixel: (spot, xy).
        flux: (spot,), counts.
    """
    out = np.zeros(shape)
    reach = int(np.ceil(6 * PSF_PX))
    for (x, y), strength in zip(pixel, flux, strict=True):
        if strength == 0:
            continue
        profile = []
        for centre, length in ((y, shape[0]), (x, shape[1])):
            first = max(0, round(centre) - reach)
            edges = np.arange(first, min(length, round(centre) + reach + 1) + 1) - 0.5
            profile.append((first, np.diff(erf((edges - centre) / (np.sqrt(2) * PSF_PX))) / 2))
        (top, rows), (left, columns) = profile
        out[top : top + rows.size, left : left + columns.size] += strength * np.outer(rows, columns)
    return out


def ball_and_stand(
    shape: tuple[int, int], centre: Array, radius_mm: float, matrix: Array, camera_mm: float, level: float
) -> Array:
    """The ball mirroring a dim room, its stand, and what is behind, (y, x); `level` is that of the background."""
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]].astype(float)
    ray = np.stack(
        [(x - matrix[0, 2]) / matrix[0, 0], -(y - matrix[1, 2]) / matrix[1, 1], -np.ones(shape)], axis=-1
    )
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    to_ball = centre - np.array([0.0, 0.0, camera_mm])
    along = ray @ to_ball
    inside = radius_mm**2 - (to_ball @ to_ball - along**2)
    slope = np.hypot(*np.gradient(inside))
    covered = np.clip(0.5 + inside / np.maximum(slope, 1e-12), 0, 1)
    n = ((along - np.sqrt(np.maximum(inside, 0)))[..., None] * ray - to_ball) / radius_mm
    mirrored_y = ray[..., 1] - 2 * np.sum(ray * n, axis=-1) * n[..., 1]
    picture = level + covered * (level * (2.2 + 1.2 * mirrored_y) - level)
    scale = matrix[0, 0] / (camera_mm - centre[2])
    rim = centre - np.array([0.0, radius_mm - CUP_RIM_MM, 0.0])
    for drop, wide, tall in ((0.0, CUP_RADIUS_MM, CUP_HEIGHT_MM), (CUP_HEIGHT_MM, POST_RADIUS_MM, 1e4)):
        u, v = project(rim - np.array([0.0, drop, 0.0]), matrix, camera_mm)
        across = np.clip(0.5 + wide * scale - np.abs(x - u), 0, 1)
        down = np.clip(0.5 + y - v, 0, 1) * np.clip(0.5 + v + tall * scale - y, 0, 1)
        picture += across * down * (3 * level - picture)
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), PSF_PX))


def plane(
    grid: Callable[[Array, Array], Array],
    shape: tuple[int, int],
    to_image: Array,
    texture: Callable[[Array, Array], Array],
    samples: int = 5,
) -> Array:
    """A flat target, (y, x): mean of samples x samples points a pixel, then the lens' blur.

    Args:
        grid: raw pixel (x, y) of a camera -> reference pixel (..., xy).
        to_image: (3, 3), target (u, v, 1) in mm -> reference pixel.
        texture: reflectance at (u, v).
    """
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]].astype(float)
    inverse = np.linalg.inv(to_image)
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    total = np.zeros(shape)
    for dy in offsets:
        for dx in offsets:
            p = grid(x + dx, y + dy)
            q = p @ inverse[:, :2].T + inverse[:, 2]
            total += texture(q[..., 0] / q[..., 2], q[..., 1] / q[..., 2])
    return np.asarray(cv2.GaussianBlur(total / samples**2, (0, 0), PSF_PX))


def plane_to_image(rotation: Array, t_mm: Array, matrix: Array, camera_mm: float) -> Array:
    """(3, 3): (u, v, 1) on a plane -> pixel, where world = rotation[:, 0] u + rotation[:, 1] v + t."""
    turn = np.diag([1.0, -1.0, -1.0])
    moved = turn @ t_mm + np.array([0.0, 0.0, camera_mm])
    return np.asarray(matrix @ np.column_stack([turn @ rotation[:, 0], turn @ rotation[:, 1], moved]))


def fresnel(index: complex, incidence: Array) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Amplitudes r_s, r_p at `incidence` (radians); a metal's are complex. Born and Wolf 1.5.2, 14.4."""
    cosine = np.cos(incidence)
    inner = np.sqrt(1 - (np.sin(incidence) / index) ** 2 + 0j)
    return (cosine - index * inner) / (cosine + index * inner), (index * cosine - inner) / (index * cosine + inner)


def polarised(hit: Highlights, lights: Array, camera_mm: float, index: complex, extinction: float) -> Array:
    """How a highlight's brightness depends on its light's polariser, behind a fixed analyser along world x.

    For a polariser at angle t from upward, I(t) = u'Mu + e (u_'M u_), u = (cos t, sin t), u_ normal to
    u, where M = Re(v v*) and v holds the analyser's share of what either direction is mirrored into. So
    I = a + b cos^2(t - theta0). A real index gives M of rank 1, and a = e b only; a metal's phase adds its own.

    Returns:
        (light, 3): a, b, theta0 in radians.
    """
    eye = np.array([0.0, 0.0, camera_mm])
    into, out = (_unit(v) for v in (hit.point_mm - lights, eye - hit.point_mm))
    s = _unit(np.cross(into, hit.normal) + 1e-12)
    p_in, p_out = np.cross(into, s), np.cross(out, s)
    up = np.where(np.abs(into[:, 1:2]) > 0.99, [0.0, 0.0, 1.0], [0.0, 1.0, 0.0])
    first = _unit(up - np.sum(up * into, axis=1, keepdims=True) * into)
    r_s, r_p = fresnel(index, np.radians(hit.incidence_deg))
    amplitudes = []
    for direction in (first, np.cross(into, first)):
        share_s, share_p = np.sum(direction * s, axis=1), np.sum(direction * p_in, axis=1)
        amplitudes.append(s[:, 0] * r_s * share_s + p_out[:, 0] * r_p * share_p)
    v = np.stack(amplitudes, axis=-1)
    values, vectors = np.linalg.eigh(np.real(v[:, :, None] * np.conj(v[:, None, :])))
    least, most = np.maximum(values[:, 0], 0), values[:, 1]
    a, top = least + extinction * most, most + extinction * least
    return np.stack([a, top - a, np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1])], axis=-1)


def _unit(v: Array) -> Array:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))

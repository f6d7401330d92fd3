"""Synthetic pictures of a moving face under one gradient pair, with the true flows.

A head-like ellipsoid with hills, seen from the front, is lit evenly (c) and by a gradient and its complement,

    c = albedo,    r = albedo (1/2 + n_a / 3),    r' = albedo (1/2 - n_a / 3),    r + r' = c

and r and r' are moved: r_moved(x + u(x)) = r(x). Truth is made without any code of the stages: a flow is a formula
(rigid, linear and a few cosines), its inverse is solved from the formula to 0.001 px, and each picture is resampled
once, by a spline of degree 5. Then come shot noise (full well 10000 e-), read noise (10 e-), rounding to 10 bits.

The illuminant is taken as infinitely far away and unshadowed, and surface points keep their normals while they
move: what is measured on these scenes is the alignment alone.
"""

from dataclasses import dataclass
from typing import Any, Literal, get_args

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

Array = NDArray[Any]
Kind = Literal["textured", "smooth", "bumpy", "both", "independent"]
"""textured: pores and freckles in the albedo, small relief. smooth: no fine albedo. bumpy: both fine albedo and
strong fine relief, which a gradient sees and even light does not. both: strong relief without fine albedo.
independent: textured, u and v unrelated (otherwise v is -u and a fifth of another flow, as around a tracking
frame)."""
KINDS: tuple[Kind, ...] = get_args(Kind)
SIZES = {298: (182, 298), 812: (618, 812), 1624: (1236, 1624)}
"""Rows and columns by width."""
WELL, READ, WHITE, BRIGHTEST = 10000.0, 10.0, 1023, 900.0
"""Electrons at the white level, electrons of read noise, counts, counts of the brightest pixel of c."""
_PAD = 24
"""Pixels around the picture that motion may bring in."""
_EDGE = 8
"""Pixels at the border that are not judged: what moved in or out there was not seen in every picture."""


@dataclass(frozen=True)
class Scene:
    """Pictures in counts, (y, x) float32, and their truth."""

    constant: Array
    gradient: Array
    """Moved by u."""
    complement: Array
    """Moved by v."""
    still: list[tuple[Array, Array]]
    """Gradient and complement of x, y and z, not moved, with noise of their own."""
    axis: int
    """The axis that moved."""
    u: Array
    """(xy, y, x), pixels: gradient(x + u(x)) is where constant(x) is."""
    v: Array
    inner: Array
    """(y, x) bool: inside the outline and away from the border."""


class Motion:
    """A smooth flow that can be evaluated anywhere: a sum of rigid, linear and cosine parts, both axes."""

    def __init__(self, rng: np.random.Generator, shape: tuple[int, int], peak: float) -> None:
        self.shape = shape
        self._parts = [(rng.normal(size=3), rng.normal(0, 2.4 * np.pi, (4, 2)), 0.5 * rng.normal(size=4),
                        rng.uniform(0, 2 * np.pi, 4)) for _ in range(2)]  # fmt: skip
        self._gain = 1.0
        self._gain = peak / float(np.hypot(*self(*_grid(shape))).max())

    def __call__(self, x: Array, y: Array) -> Array:
        """(xy, y, x), pixels."""
        height, width = self.shape
        a, b = (x - np.float32(width / 2)) / np.float32(width), (y - np.float32(height / 2)) / np.float32(width)
        out = []
        for line, waves, amplitudes, phases in self._parts:
            f = line[0].astype(np.float32) + np.float32(line[1]) * a + np.float32(line[2]) * b
            for (kx, ky), amplitude, phase in zip(waves.astype(np.float32), amplitudes, phases, strict=True):
                f += np.float32(amplitude) * np.cos(kx * a + ky * b + np.float32(phase))
            out.append(f)
        return np.asarray(np.stack(out) * np.float32(self._gain))


def scene(seed: int, width: int, kind: Kind = "textured") -> Scene:
    """A scene of one of `SIZES`; the same seed and kind give the same scene."""
    rng = np.random.default_rng([seed, 77])
    rows, columns = SIZES[width]
    shape = (rows + 2 * _PAD, columns + 2 * _PAD)
    x, y = _grid(shape)
    body = ((x - shape[1] / 2) / (0.5 * columns)) ** 2 + ((y - shape[0] / 2) / (0.62 * rows)) ** 2
    albedo, normal = _surface(rng, shape, columns, body, kind)
    inside = (body < 1).astype(np.float32)
    albedo = albedo * cv2.GaussianBlur(inside, (0, 0), 0.8)
    pairs = [(albedo * (0.5 + n / 3), albedo * (0.5 - n / 3)) for n in normal]
    axis = seed % 3
    peak = rng.uniform(3, 6)
    u = Motion(rng, shape, peak)
    if kind == "independent":
        other = Motion(rng, shape, rng.uniform(3, 6))
        v_of = other.__call__
    else:
        fifth = Motion(rng, shape, 0.2 * peak)

        def v_of(x: Array, y: Array) -> Array:
            return fifth(x, y) - u(x, y)

    crop = (slice(_PAD, -_PAD), slice(_PAD, -_PAD))
    gain = BRIGHTEST / float(albedo.max())

    def expose(picture: Array) -> Array:
        electrons = picture[crop] * (gain * WELL / WHITE)
        noise = rng.standard_normal(electrons.shape, dtype=np.float32)
        electrons = electrons + noise * np.sqrt(np.maximum(electrons, 0) + READ**2)
        return np.round(electrons * (WHITE / WELL)).clip(0, WHITE).astype(np.float32)

    inner = cv2.GaussianBlur(inside, (0, 0), 2.0)[crop] > 0.98
    inner[:_EDGE] = inner[-_EDGE:] = inner[:, :_EDGE] = inner[:, -_EDGE:] = False
    return Scene(
        constant=expose(albedo),
        gradient=expose(_moved(pairs[axis][0], u, x, y)),
        complement=expose(_moved(pairs[axis][1], v_of, x, y)),
        still=[(expose(r), expose(rc)) for r, rc in pairs],
        axis=axis,
        u=u(x, y)[:, *crop],
        v=v_of(x, y)[:, *crop],
        inner=inner,
    )


def _surface(
    rng: np.random.Generator, shape: tuple[int, int], columns: int, body: Array, kind: Kind
) -> tuple[Array, Array]:
    """Albedo (y, x) and unit normals (xyz, y, x)."""
    scale = columns / 298
    albedo = 0.55 + 0.08 * _noise(rng, shape, 40 * scale)
    if kind not in ("smooth", "both"):
        fine = 0.05 * _noise(rng, shape, 1.0) + 0.05 * _noise(rng, shape, 2.5) + 0.08 * _noise(rng, shape, 8.0)
        albedo *= 1 + fine
    height = np.sqrt(np.clip(1 - 0.85 * body, 0.05, None)) * 0.5 * columns
    height += 0.6 * scale * _noise(rng, shape, 12 * scale)
    relief = 0.35 if kind in ("bumpy", "both") else 0.06
    height += relief * (1.5 * _noise(rng, shape, 1.6) + 2.1 * _noise(rng, shape, 4.0))
    down, right = np.gradient(height)
    normal = np.stack([-right, down, np.ones_like(right)])
    normal /= np.linalg.norm(normal, axis=0)
    return np.clip(albedo, 0.08, 0.95), normal


def _noise(rng: np.random.Generator, shape: tuple[int, int], sigma: float) -> Array:
    """Noise blurred by a Gaussian of `sigma` pixels, of standard deviation 1; periodic, so by Fourier transform."""
    spectrum = scipy.fft.rfft2(rng.standard_normal(shape, dtype=np.float32))
    fy, fx = scipy.fft.fftfreq(shape[0])[:, None], scipy.fft.rfftfreq(shape[1])[None]
    spectrum *= np.exp(-2 * (np.pi * sigma) ** 2 * (fy**2 + fx**2)).astype(np.float32)
    f = scipy.fft.irfft2(spectrum, s=shape)
    return np.asarray(f / f.std())


def _moved(picture: Array, flow: Any, x: Array, y: Array) -> Array:
    """out with out(x + flow(x)) = picture(x): picture at x + back(x), back(x) = -flow(x + back(x))."""
    back = -flow(x, y)
    for _ in range(30):
        new = -flow(x + back[0], y + back[1])
        change = float(np.abs(new - back).max())
        back = new
        if change < 1e-3:
            break
    else:
        raise ValueError("the motion folds the picture: its inverse does not exist; take a smaller peak")
    return np.asarray(
        map_coordinates(picture, [y + back[1], x + back[0]], order=5, mode="nearest", output=np.float32)
    )


def _grid(shape: tuple[int, int]) -> tuple[Array, Array]:
    """x and y of each pixel, float32."""
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32)
    return x, y

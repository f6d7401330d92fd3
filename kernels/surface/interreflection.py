"""Light that reached a point by way of other points, and how to take it out.

**Spectral extrapolation.** Direct light is albedo times geometry; light bounced once carries one more factor
of the albedo around. With a the albedo in a band, P and S the direct sums of gradient differences and of
constant light,

    q = m / r_c = (P + a P1) / (S + a S1)  =  P/S + a * slope + O(a^2)

so over the bands q is nearly a line in the albedo, and its value at albedo 0 is free of bounced light. The
albedo need not be absolute, but bands must compare: only the line's end at zero counts. The slope varies slowly
over the surface; it is fitted over a wide neighbourhood, and then over about 3 px as far as the noise allows: both
fits shrink (to none, and to the wide one), so that bands of one albedo, which tell nothing, change nothing. Three
bands or more. We know of no earlier use of it.

**Radiosity.** With one band the bounce is computed: tiles of the depth map as Lambertian patches, their form
factors with occlusion (lens distortion is neglected), and the series of bounces (Goral et al. 1984,
doi:10.1145/964965.808601). This needs the
albedo itself; radiance 1 is a white surface facing one light at the lights' mean distance.
"""

from typing import Any, NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from lightstage.kernels.pictures.masked_mean import MaskedMean, reflected
from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.kernels.surface.visibility import in_parts

Array = NDArray[np.float64]

_SLOPE_PX, _WIDE_PX, _ALBEDO_PX = 3.0, 12.0, 6.0
_WIDE_PRIOR, _LOCAL_PRIOR = 0.05, 0.03
"""One sigma of what bounced light does to a component of q: overall, and here against around. On a face it does
0.02 to 0.1."""
_LEVER = 0.1
"""Relative spread of the albedo over the bands from which the line counts in full."""
_TILES = 1400
"""Aim for the number of tiles: their form factors are its square."""
_BOUNCES = 6
_LEAST_SHARE = 1e-9
"""Of a window that is in the mask."""
_LARGEST_ALBEDO = 0.95


def without_bounces(
    ratio: NDArray[Any], weight: NDArray[Any], constant: NDArray[Any], direct: Array, mask: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Ratio vectors extrapolated to albedo zero.

    Args:
        ratio: (band, y, x, xyz), m / r_c.
        weight: (band, y, x), one over the variance of a component of `ratio`.
        constant: (band, y, x), r_c.
        direct: (y, x), S: r_c of a white surface without bounces; any scale.
        mask: (y, x).

    Returns:
        slope (y, x, xyz), and the albedo of each band around each point (band, y, x): q - albedo * slope is
        free of bounced light.
    """
    around = MaskedMean(mask, _ALBEDO_PX, least=_LEAST_SHARE)
    albedo = np.stack([around(np.nan_to_num(c / np.maximum(direct, 1e-3))) for c in constant])
    total = weight.sum(axis=0) + 1e-30
    centred = albedo - (weight * albedo).sum(axis=0) / total
    middle = (weight[..., None] * ratio).sum(axis=0) / total[..., None]
    up = ((weight * centred)[..., None] * (ratio - middle)).sum(axis=0)
    down = (weight * centred**2).sum(axis=0)
    usual = np.maximum((weight * albedo).sum(axis=0) / total, 1e-9)
    lever = np.sqrt(MaskedMean(mask, _WIDE_PX, least=_LEAST_SHARE)(np.nan_to_num(down / total))) / usual
    # from a short lever the line's end at zero is a guess: the noise of r_c, which is in q and in a, draws the line
    trust = np.clip((lever / _LEVER) ** 2, 1e-6, 1) / usual
    wide = _shrunk(up, down, mask, _WIDE_PX, _WIDE_PRIOR * trust)
    return wide + _shrunk(up - down[..., None] * wide, down, mask, _SLOPE_PX, _LOCAL_PRIOR * trust), albedo


def _shrunk(up: Array, down: Array, mask: NDArray[np.bool_], sigma: float, prior: Array) -> Array:
    """Slope over a neighbourhood, with a Gaussian prior: one over `down` summed there is its variance."""
    pixels = 4 * np.pi * sigma**2  # that a Gaussian window averages
    ridge = 1 / (pixels * prior**2)
    top = np.stack([_blur(up[..., i], mask, sigma) for i in range(3)], axis=-1)
    return np.asarray(top / (_blur(down, mask, sigma) + ridge)[..., None])


def _blur(values: Array, mask: NDArray[np.bool_], sigma: float) -> Array:
    return np.asarray(reflected(np.where(mask, np.nan_to_num(values), 0).astype(np.float64), sigma))


class Tiles:
    """The surface as patches, with what each sees of the others."""

    def __init__(
        self, points: Array, normal: Array, depth: Array, mask: NDArray[np.bool_], camera: Pinhole
    ) -> None:
        """Cut the surface.

        Args:
            points: (y, x, xyz) world, mm.
            normal: (y, x, xyz) world.
            depth: (y, x) camera z, mm, NaN outside the mask.
            mask: (y, x).
            camera: of these pictures.
        """
        self._mask = mask
        self._step = max(2, round(float(np.sqrt(mask.sum() / _TILES))))
        counts = self._sum(np.ones(mask.shape))
        self._used = counts > 0.3 * self._step**2
        self._counts = counts[self._used]
        view = camera.rays @ camera.rotation
        view /= np.linalg.norm(view, axis=2, keepdims=True)
        facing = np.maximum(-np.einsum("yxi,yxi->yx", normal, view), 0.15)
        ahead = 1 / np.linalg.norm(camera.rays, axis=2)  # cosine to the axis
        area = depth**2 / (camera.intrinsics[0] * camera.intrinsics[1]) / facing * ahead
        centres, turned = self.mean(points), self.mean(normal)
        turned /= np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-9)
        self._factors = np.zeros((len(centres),) * 2, np.float32)
        patches = _Patches(camera.to_camera(centres), turned @ camera.rotation.T, self._sum(area)[self._used])
        front = np.where(mask, depth, np.nan).astype(np.float32)
        slack = 2.0 * self._step * float(np.nanmedian(depth)) / camera.focal

        def work(part: slice) -> None:
            _form_factors((part.start, part.stop), patches, front, camera.intrinsics, slack, self._factors)

        in_parts(work, len(centres))

    def _sum(self, values: Array) -> Array:
        """(tile row, tile column, ...) sums over the mask."""
        s = self._step
        rows, columns = (-(-size // s) for size in self._mask.shape)
        pads = [(0, rows * s - self._mask.shape[0]), (0, columns * s - self._mask.shape[1])]
        inside = self._mask if values.ndim == 2 else self._mask[..., None]
        padded = np.pad(np.where(inside, np.nan_to_num(values), 0), [*pads, *[(0, 0)] * (values.ndim - 2)])
        return np.asarray(padded.reshape(rows, s, columns, s, *values.shape[2:]).sum(axis=(1, 3)))

    def mean(self, values: Array) -> Array:
        """(tile, ...) means of values (y, x, ...) over the mask."""
        total = self._sum(values)[self._used]
        return np.asarray(total / self._counts.reshape(-1, *[1] * (values.ndim - 2)))

    def bounced(self, direct: Array, constant: Array) -> Array:
        """Irradiance that arrives by way of other tiles.

        Args:
            direct: (y, x, 4): irradiance from the lights, as P (three) and S, in radiance of a white surface.
            constant: (y, x): r_c, radiance.

        Returns:
            (y, x, 4), smooth.
        """
        light, seen = self.mean(direct), self.mean(constant)
        least = 0.02 * float(np.median(light[:, 3]))
        arrived = np.zeros_like(light)
        for _ in range(_BOUNCES):
            albedo = np.clip(seen / np.maximum(light[:, 3] + arrived[:, 3], least), 0, _LARGEST_ALBEDO)
            arrived = self._factors @ (albedo[:, None] * (light + arrived))
        return self._spread(arrived)

    def passed_on(self, direct: Array, albedo: Array, bounces: int) -> Array:
        """Irradiance that arrives by way of other tiles, of a known albedo.

        Args:
            direct: (y, x, channel): irradiance from the lights.
            albedo: (y, x, channel).
            bounces: how often light is passed on.

        Returns:
            (y, x, channel), smooth.
        """
        light, shade = self.mean(direct), np.clip(self.mean(albedo), 0, _LARGEST_ALBEDO)
        arrived = np.zeros_like(light)
        for _ in range(bounces):
            arrived = self._factors @ (shade * (light + arrived))
        return np.stack([self._spread(arrived[:, i : i + 1])[..., 0] for i in range(arrived.shape[1])], axis=-1)

    def _spread(self, arrived: Array) -> Array:
        """(y, x, number) of numbers by tile (tile, number), at most four."""
        grid = np.zeros((*self._used.shape, arrived.shape[1]), np.float32)
        grid[self._used] = arrived
        y, x = np.mgrid[0 : self._mask.shape[0], 0 : self._mask.shape[1]].astype(np.float32)
        where = ((x + 0.5) / self._step - 0.5, (y + 0.5) / self._step - 0.5)
        spread = cv2.remap(grid, *where, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        known = cv2.remap(self._used.astype(np.float32), *where, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(spread.reshape(*known.shape, -1) / np.maximum(known, 1e-6)[..., None], np.float64)


class _Patches(NamedTuple):
    """Tiles in the camera's frame."""

    places: Array
    """(tile, xyz), mm."""
    normals: Array
    """(tile, xyz)."""
    areas: Array
    """(tile,), square mm."""


@njit(nogil=True, cache=True)
def _form_factors(rows: Any, patches: Any, front: Any, lens: Any, slack: float, out: Any) -> None:
    """Rows (first and one beyond the last) of the matrix: how much of tile i's hemisphere tile j fills."""
    first, last = rows
    places, normals, areas = patches
    height, width = front.shape
    fx, fy, cx, cy = lens
    steps = 12
    for i in range(first, last):
        for j in range(places.shape[0]):
            if i == j:
                continue
            d = places[j] - places[i]
            d2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
            length = np.sqrt(d2)
            leaving = (normals[i, 0] * d[0] + normals[i, 1] * d[1] + normals[i, 2] * d[2]) / length
            arriving = -(normals[j, 0] * d[0] + normals[j, 1] * d[1] + normals[j, 2] * d[2]) / length
            if leaving <= 0 or arriving <= 0:
                continue
            factor = leaving * arriving * areas[j] / (np.pi * d2 + areas[j])
            if factor < 1e-6:
                continue
            free = True
            for s in range(1, steps):
                p = places[i] + d * (s / steps)
                column, row = int(fx * p[0] / p[2] + cx + 0.5), int(fy * p[1] / p[2] + cy + 0.5)
                if 0 <= column < width and 0 <= row < height and p[2] - front[row, column] > slack:
                    free = False
                    break
            if free:
                out[i, j] = factor

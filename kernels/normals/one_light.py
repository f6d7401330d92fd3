"""Photometric stereo from one light at a time (Woodham 1980, doi:10.1117/12.7972479).

    I_k = rho (l_k . n)        rho n = pinv(L) I

Pixels that miss some pictures (saturated ones are NaN) are solved from the others, by their own normal
equations; three lights that are not in one plane are the least. Pictures are read one after the other, so
memory does not grow with their number.
"""

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lightstage.kernels.normals import quantised
from lightstage.kernels.normals.spherical_gradients import Normals


def solve(pictures: Sequence[NDArray[np.float32]], lights: NDArray[np.float64]) -> Normals:
    """Least squares over all lights.

    Args:
        pictures: (y, x) radiance, one a light; NaN where not valid.
        lights: (light, xyz): direction towards the light times its strength.

    Returns:
        `constant` is the albedo rho, in the pictures' unit; `norm` is 1/3 wherever there is a normal, because
        the method has no normalising constant of its own.
    """
    shape = pictures[0].shape
    inverse = np.linalg.pinv(lights)
    sums = np.zeros((3, *shape), np.float32)
    missing = np.zeros(shape, np.bool_)
    for k, picture in enumerate(pictures):
        seen = picture == picture
        missing |= ~seen
        for axis in range(3):
            sums[axis] += np.float32(inverse[axis, k]) * picture
    if missing.any():
        where = np.flatnonzero(missing)
        samples = np.empty((where.size, len(pictures)), np.float64)
        for k, picture in enumerate(pictures):
            samples[:, k] = picture.reshape(-1)[where]
        sums.reshape(3, -1)[:, where] = _solve_some(samples, lights)
    albedo = np.sqrt(np.einsum("ayx,ayx->yx", sums, sums))
    valid = albedo > 0
    with np.errstate(invalid="ignore", divide="ignore"):
        normal = quantised.encode(sums / albedo, valid)
    albedo = np.where(valid, albedo, np.float32(np.nan))
    norm = np.where(valid, np.float32(1 / 3), np.float32(np.nan))
    return Normals(normal, albedo, norm, valid)


@njit(nogil=True, cache=True, error_model="numpy")
def _solve_some(samples: NDArray[np.float64], lights: NDArray[np.float64]) -> NDArray[np.float32]:
    """rho n (xyz, pixel) of pixels that miss some lights; NaN where the rest cannot tell."""
    out = np.empty((3, samples.shape[0]), np.float32)
    for i in range(samples.shape[0]):
        m = np.zeros((3, 3))
        v = np.zeros(3)
        for k in range(samples.shape[1]):
            if samples[i, k] == samples[i, k]:
                for a in range(3):
                    v[a] += lights[k, a] * samples[i, k]
                    for b in range(3):
                        m[a, b] += lights[k, a] * lights[k, b]
        scale = (m[0, 0] + m[1, 1] + m[2, 2]) / 3
        if np.linalg.det(m) < 1e-6 * scale**3 or scale == 0:
            out[:, i] = np.nan
        else:
            solution = np.linalg.solve(m, v)
            for a in range(3):
                out[a, i] = solution[a]
    return out

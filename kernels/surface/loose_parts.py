"""Parts that normals hold to each other only loosely, placed by their light.

Across a break no normal tells how far a chin stands before a neck; integration then spreads its errors into that
step, because nothing else is as soft. What it holds least are the softest eigenvectors V of its equations, beside
the factor of the whole. But where a part stands decides which lights it sees and how near they are, and both show
in d = |m| / r_c. So the amplitudes a of the softest shapes are those that explain d best:

    minimise  sum rho((d - d(z + V a)) / h)  +  a' K a / (3 s^2)

z the integrated log depth, d(.) what the model predicts with shadows cast anew, rho Huber's norm with bend h, K
what the shapes cost in the integration, and s^2 the variance of its misfit; misfits of neighbours are alike, so
three count as one. A smooth body has no soft shape, and K holds it. Gauss-Newton with numerical derivatives, two
steps a round.

Source: ours (docs/methods/near-light.md has the ablation).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.normals.near_light import Lights, LightVectors, invert
from lightstage.kernels.surface.integration import softest
from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.kernels.surface.visibility import visible

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MOST, _ASKED = 2, 8
"""Shapes that are placed, of so many that are looked at: the softest may be a few loose pixels."""
_LEAST_SHARE = 0.02
"""Of the subject's pixels that a shape must move."""
_ALIKE = 3.0
_BEND = 0.01
"""h: beyond it a difference of d is an error of the surface, not noise."""
_STEPS = 2
_TRIAL_MM, _FARTHEST_MM = 4.0, 12.0
"""Step of the derivatives, and the most that one step may move a part."""
_EVERY = 3
"""Every so many rows and columns are judged: the norm of one pixel is noise, that of a thousand is not."""


@dataclass(frozen=True)
class LooseParts:
    """The softest shapes of a surface and how far each has swung."""

    shapes: Array
    """(number, y, x): log depth, from the one end to the other 1; 0 outside the mask."""
    cost: Array
    """(number,): K / (3 s^2)."""
    amplitude: Array
    """(number,): a."""

    @classmethod
    def of(cls, normal: Array, mask: Mask, camera: Pinhole, log_depth: Array) -> "LooseParts":
        """Those of the largest part of the mask, not swung yet.

        Args:
            normal: (y, x, xyz), the camera's frame. log_depth: (y, x), integrated from it.
        """
        _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
        whole = labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
        vectors, energy, variance = softest(normal, whole, camera.rays, log_depth, _ASKED)
        moves = 1 / np.sum(vectors**4, axis=1)  # so many points, if all of them moved as far
        chosen = np.flatnonzero(moves >= _LEAST_SHARE * whole.sum())[:_MOST]
        span = np.ptp(vectors[chosen], axis=1)
        shapes = np.zeros((len(chosen), *mask.shape))
        shapes[:, whole] = vectors[chosen] / span[:, None]
        return cls(shapes, energy[chosen] / span**2 / (_ALIKE * max(variance, 1e-12)), np.zeros(len(chosen)))

    def swing(self) -> Array:
        """(y, x): what they add to the log depth."""
        return np.asarray(np.tensordot(self.amplitude, self.shapes, 1))

    def moved(
        self, log_depth: Array, distance_mm: float, joint: LightVectors, camera: Pinhole, lights: Lights
    ) -> "LooseParts":
        """Swung so that the norm is what the model predicts.

        Args:
            log_depth: (y, x), integrated, without the swing. distance_mm: its median.
            one: the measurement, all bands as one, bounced light taken out.
        """
        mask = np.isfinite(log_depth)
        some = np.zeros(mask.shape, np.bool_)
        some[::_EVERY, ::_EVERY] = mask[::_EVERY, ::_EVERY]
        if not len(self.shapes) or some.sum() < 64:
            return self
        base = log_depth - np.median(log_depth[mask]) + np.log(distance_mm)
        vector = joint.vector[0][some]
        norm = np.linalg.norm(vector, axis=1) / np.maximum(joint.constant[0][some], 1e-12)

        def excess(amplitude: Array) -> Array:
            depth = np.exp(base + np.tensordot(amplitude, self.shapes, 1))
            points = camera.points(depth)[some]
            return np.asarray(
                norm - invert(vector, points, lights, visible(points, depth, camera, lights.position)).norm
            )

        amplitude = self.amplitude
        for _ in range(_STEPS):
            amplitude = amplitude + self._step(amplitude, excess, distance_mm)
        return replace(self, amplitude=amplitude)

    def _step(self, amplitude: Array, excess: Callable[[Array], Array], distance_mm: float) -> Array:
        trial, farthest = _TRIAL_MM / distance_mm, _FARTHEST_MM / distance_mm
        misfit = excess(amplitude)
        # to both sides, because a shadow's edge makes them differ
        slopes = np.stack(
            [
                (excess(amplitude + trial * unit) - excess(amplitude - trial * unit)) / (2 * trial)
                for unit in np.eye(len(amplitude))
            ],
            axis=1,
        )
        known = np.isfinite(misfit) & np.isfinite(slopes).all(axis=1)
        weight = _EVERY**2 / (_BEND * np.maximum(np.abs(misfit[known]), _BEND))
        system = (slopes[known] * weight[:, None]).T @ slopes[known] + np.diag(self.cost)
        right = (slopes[known] * weight[:, None]).T @ misfit[known] + self.cost * amplitude
        return np.asarray(np.clip(-np.linalg.solve(system, right), -farthest, farthest))

    def spread(self, larger: Callable[[Array], Array], mask: Mask) -> "LooseParts":
        """On a larger picture. `larger` brings a picture (y, x) there."""
        shapes = np.array([np.where(mask, larger(shape), 0) for shape in self.shapes]).reshape(-1, *mask.shape)
        return replace(self, shapes=shapes)

    def drawn(self, difference: Array) -> Array:
        """(y, x): of a difference of log depths (y, x) what these shapes can draw, by least squares."""
        known = np.isfinite(difference) & (np.abs(self.shapes).sum(axis=0) > 0)
        if not len(self.shapes) or not known.any():
            return np.zeros(difference.shape)
        ground = np.concatenate([self.shapes[:, known], np.ones((1, int(known.sum())))])
        amplitude = np.linalg.lstsq(ground.T, difference[known], rcond=None)[0][:-1]
        return np.asarray(np.tensordot(amplitude, self.shapes, 1))

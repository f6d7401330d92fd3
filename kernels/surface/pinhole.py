"""A camera in numbers: its rays, points in the world, its frame, and its pictures made smaller.

World: right-handed, x right, y up, z towards the camera, mm. Camera: x right, y down, z forward (OpenCV).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pinhole:
    """A camera item in numbers; pixel (0, 0) is the centre of the top-left pixel."""

    shape: tuple[int, int]
    """(rows, columns)."""
    intrinsics: tuple[float, float, float, float]
    """fx, fy, cx, cy in pixels."""
    distortion: tuple[float, float, float, float, float]
    """k1 k2 p1 p2 k3."""
    rotation: Array
    """(3, 3), world to camera."""
    translation: Array
    """(3,), mm."""
    skew: float = 0.0
    """Pixels: the image's x is fx x + skew y + cx."""

    @classmethod
    def of(cls, item: Mapping[str, Any], shape: tuple[int, int]) -> "Pinhole":
        """From a camera item, for pictures of `shape`.

        Raises:
            KernelError: the item is for pictures of another size.
        """
        width, height = item["size_px"]
        if (height, width) != tuple(shape):
            raise KernelError(
                f"the camera item is for {width} x {height}; the pictures are {shape[1]} x {shape[0]}"
            )
        matrix = np.asarray(item["K"], float)
        k1, k2, p1, p2, k3 = (float(v) for v in item["distortion"])
        pose = item["world_to_camera"]
        return cls(
            (height, width),
            (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]),
            (k1, k2, p1, p2, k3),
            np.asarray(pose["R"], float),
            np.asarray(pose["t_mm"], float),
            float(matrix[0, 1]),
        )

    @property
    def matrix(self) -> Array:
        """K, (3, 3): of a point of the camera's frame, without distortion, K X is its image (x, y, 1) z."""
        fx, fy, cx, cy = self.intrinsics
        return np.array([[fx, self.skew, cx], [0, fy, cy], [0, 0, 1]])

    @property
    def lens(self) -> Array | None:
        """The distortion as OpenCV takes it; None where there is none."""
        return np.array(self.distortion) if any(self.distortion) else None

    @property
    def focal(self) -> float:
        """Mean focal length in pixels."""
        return (self.intrinsics[0] + self.intrinsics[1]) / 2

    @property
    def centre(self) -> Array:
        """(xyz) of the pinhole in the world, mm."""
        return np.asarray(-self.rotation.T @ self.translation)

    @cached_property
    def rays(self) -> Array:
        """(y, x, xyz) rays in the camera's frame, z = 1."""
        fx, fy, cx, cy = self.intrinsics
        y, x = np.mgrid[0 : self.shape[0], 0 : self.shape[1]].astype(np.float64)
        if self.skew:
            x -= self.skew * (y - cy) / fy
        if any(self.distortion):
            straight = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])  # OpenCV knows no skew
            points = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
            plane = cv2.undistortPoints(points, straight, np.array(self.distortion)).reshape(*self.shape, 2)
        else:
            plane = np.stack([(x - cx) / fx, (y - cy) / fy], axis=-1)
        return np.concatenate([plane, np.ones((*self.shape, 1))], axis=2)

    def points(self, depth: Array) -> Array:
        """(y, x, xyz) world points, mm, at camera z `depth` (y, x)."""
        return self.centre + depth[..., None] * (self.rays @ self.rotation)

    def to_camera(self, world: Array) -> Array:
        """(..., xyz) world points in the camera's frame, mm."""
        return np.asarray(world @ self.rotation.T + self.translation)

    def smaller(self, factor: int) -> "Pinhole":
        """The camera of pictures in which `factor` x `factor` pixels are one; rows and columns left over go."""
        fx, fy, cx, cy = self.intrinsics
        shift = (factor - 1) / 2
        return Pinhole(
            (self.shape[0] // factor, self.shape[1] // factor),
            (fx / factor, fy / factor, (cx - shift) / factor, (cy - shift) / factor),
            self.distortion,
            self.rotation,
            self.translation,
            self.skew / factor,
        )

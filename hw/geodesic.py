"""Where the lights are: vertices of an icosahedron whose edges are divided.

Frequency 2 has 42 vertices, 4 has 162, 8 has 642 (10 f^2 + 2). A vertex stands at +y. Lights are numbered by
falling height, then by azimuth from the camera (0 towards +z, growing towards +x), as the archives do.
"""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from lightstage.hw.errors import RigError


def icosahedron() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (12, xyz), unit, one at +y, and faces (20, 3)."""
    height = 1 / np.sqrt(5)
    ring = 2 / np.sqrt(5)
    upper = [(ring * np.sin(a), height, ring * np.cos(a)) for a in np.radians(np.arange(5) * 72)]
    lower = [(ring * np.sin(a), -height, ring * np.cos(a)) for a in np.radians(np.arange(5) * 72 + 36)]
    vertices = np.array([(0.0, 1.0, 0.0), *upper, *lower, (0.0, -1.0, 0.0)])
    faces = []
    for i in range(5):
        j = (i + 1) % 5
        faces += [(0, 1 + i, 1 + j), (1 + i, 6 + i, 1 + j), (6 + i, 6 + j, 1 + j), (11, 6 + j, 6 + i)]
    return vertices, np.array(faces)


def light_positions(frequency: int = 2, *, left_out: Collection[int] | None = None) -> NDArray[np.float64]:
    """Unit vectors to the lights, (light, xyz), world frame.

    Args:
        frequency: parts into which each edge of the icosahedron is divided: 2 gives 42 vertices, 4 gives 162.
        left_out: numbers of the vertices without a light, in the numbering of all; None leaves out the
            lowest, where the subject's support stands.

    Raises:
        RigError: the frequency is below 1, or a number is not a vertex.
    """
    if frequency < 1:
        raise RigError(f"a geodesic sphere of frequency {frequency} does not exist; 1 is the icosahedron itself")
    corners, faces = icosahedron()
    points = []
    for a, b, c in corners[faces]:
        for i in range(frequency + 1):
            for j in range(frequency + 1 - i):
                points.append((a * (frequency - i - j) + b * i + c * j) / frequency)
    unit = np.array(points)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    unit = np.unique(np.round(unit, 9), axis=0) + 0.0
    azimuth = np.mod(np.round(np.arctan2(unit[:, 0], unit[:, 2]), 6), np.round(2 * np.pi, 6))
    # the poles have no azimuth
    azimuth[np.abs(unit[:, 1]) > 1 - 1e-9] = 0
    unit = unit[np.lexsort((azimuth, -np.round(unit[:, 1], 6)))]
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    out = {len(unit) - 1} if left_out is None else set(left_out)
    wrong = sorted(i for i in out if not 0 <= i < len(unit))
    if wrong:
        raise RigError(
            f"light {wrong[0]} cannot be left out: frequency {frequency} has lights 0 to {len(unit) - 1}"
        )
    return unit[[i for i in range(len(unit)) if i not in out]]

"""Truth of the rendered captures, and how far what is made of them is from it; for tests and benchmarks."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.store.document import load

Array = NDArray[Any]


def angle(a: Array, b: Array) -> Array:
    """Degrees between unit vectors (xyz, y, x)."""
    return np.degrees(2 * np.arctan2(np.linalg.norm(a - b, axis=0), np.linalg.norm(a + b, axis=0)))


def truth_of(folder: Path) -> tuple[Array, Array]:
    """Normals (xyz, y, x), normalised again after their half-precision storage, and the eroded mask."""
    stored = np.load(folder / "truth" / "ground_truth_cam1.npz")
    normal = np.moveaxis(stored["normal"].astype(float), 2, 0)
    normal /= np.linalg.norm(normal, axis=0) + 1e-30
    return normal, cv2.erode(stored["mask"].astype(np.uint8), np.ones((3, 3))) > 0


def difference_without_noise(folder: Path) -> Array:
    """Difference normals (xyz, y, x) from the noise-free one-light pictures and the rig's weights."""
    meta = load(folder / "truth" / "meta.yaml", what="the truth of a capture").value
    lights = np.load(folder / "truth" / "olat_noisefree_cam1.npz")["D"].astype(np.float32)
    weights = meta["leds"]["weights"]
    vector = np.stack(
        [np.tensordot(np.subtract(weights[a], weights[a + "c"]).astype(np.float32), lights, 1) for a in "XYZ"]
    )
    return np.asarray(vector / (np.linalg.norm(vector, axis=0) + 1e-30))


def displacement(registered: Any, folder: Path) -> Array:
    """(picture, xy) pixels, one for every illumination and band: registered parallel camera against cross camera.

    Lucas and Kanade (1981) over the whole mask, on detail of 1 to 3 pixels relative to the local level, with a free
    gain and robust weights, because highlights are in one camera only.
    """
    _, mask = truth_of(folder)
    inside = cv2.erode(mask.astype(np.uint8), np.ones((17, 17))) > 0
    inside[:8] = inside[-8:] = inside[:, :8] = inside[:, -8:] = False
    found = []
    for frame in registered.signal.values:
        for parallel, cross in frame:
            moved, still = _detail(parallel), _detail(cross)
            down, across = np.gradient(still)
            known = inside & np.isfinite(moved) & np.isfinite(still)
            terms = np.stack([still[known], across[known], down[known]], axis=1)
            weight = np.ones(len(terms))
            for _ in range(10):
                gain, x, y = np.linalg.lstsq(terms * weight[:, None], moved[known] * weight, rcond=None)[0]
                residual = np.abs(moved[known] - terms @ (gain, x, y))
                weight = 1 / np.sqrt(np.maximum(1, residual / (1.5 * 1.4826 * np.median(residual))))
            found.append((-x / gain, -y / gain))
    return np.array(found)


def _detail(picture: Array) -> Array:
    level = cv2.GaussianBlur(np.nan_to_num(picture, nan=1.0), (0, 0), 6)
    relative = np.where(np.isfinite(picture), picture, level) / np.maximum(level, 1)
    return np.asarray(cv2.GaussianBlur(relative, (0, 0), 1) - cv2.GaussianBlur(relative, (0, 0), 3))

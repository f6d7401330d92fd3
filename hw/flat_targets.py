"""Captures of flat targets as the virtual rig sees them: boards, dark and flat frames, exposures, a white one.

What the seed decides: the rig's tolerances and sensors (`Rig.made`), where the target is held, filters and sources,
and the noise. `truth/truth.yaml` says all of it.
"""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.hw import color_checker
from lightstage.hw import target_scenes as scenes
from lightstage.hw.capture_folder import Exposure, written
from lightstage.hw.errors import RigError
from lightstage.hw.sensor import FLAT_LEVEL, OFFSET, WHITE
from lightstage.hw.virtual_rig import CAMERA_MM, Rig, Shot

Array = NDArray[np.float64]


def checkerboard(
    shot: Shot, folder: Path, *, poses: int = 8, inner_corners: tuple[int, int] = (13, 5), square_mm: float = 12.0
) -> Path:
    """A board held in several ways, one frame each, seen by both cameras."""
    rig, generator = Rig.made(shot), np.random.default_rng([shot.seed, 23])
    columns, rows = inner_corners
    size = square_mm * np.array([columns + 1, rows + 1])
    layouts = []
    for _ in range(poses):
        tilt = generator.uniform([-25, -25, -12], [25, 25, 12])
        rotation = cv2.Rodrigues(np.radians(tilt))[0]
        t = generator.uniform([-45, -35, -40], [45, 35, 40]) - rotation[:, :2] @ (size / 2 - square_mm)
        layouts.append((rotation, t, scenes.plane_to_image(rotation, t, rig.K, CAMERA_MM)))

    def texture(u: Array, v: Array) -> Array:
        i, j = np.floor(u / square_mm), np.floor(v / square_mm)
        on = (i >= -1) & (i < columns) & (j >= -1) & (j < rows)
        margin = (np.abs(u - size[0] / 2 + square_mm) < size[0] / 2 + 10) & (
            np.abs(v - size[1] / 2 + square_mm) < size[1] / 2 + 10
        )
        return np.where(on, np.where((i + j) % 2 == 0, 0.04, 0.88), np.where(margin, 0.88, 0.03))

    def frames() -> Iterable[Exposure]:
        for *_, to_image in layouts:
            seen = {
                c: scenes.plane(_grid(rig, shot, c), (shot.height, shot.width), to_image, texture) for c in (0, 1)
            }
            yield {"illumination": "C"}, {(0, c): 0.8 * (WHITE - OFFSET) * picture for c, picture in seen.items()}

    grid = square_mm * np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    corners = [cv2.perspectiveTransform(grid[None], to_image)[0] for *_, to_image in layouts]
    raw = [_raw_of(rig, shot, c) for c in corners]
    truth = {"corners_cam1": corners, "corners_cam0": raw, "parallel_to_cross": rig.parallel_to_cross}
    truth |= {"poses": [{"R": r, "t_mm": t} for r, t, _ in layouts]}
    target = {"kind": "checkerboard", "inner_corners": list(inner_corners), "square_mm": square_mm}
    return written(shot, folder, target, {"poses": poses}, frames, truth, items=("camera",))


def uniform(shot: Shot, folder: Path, *, kind: Literal["dark", "flat"] = "dark", repeats: int = 16) -> Path:
    """Dark frames (O), or flat ones: the same uniform target again and again (C)."""
    level = 0.0 if kind == "dark" else FLAT_LEVEL * (WHITE - OFFSET)
    picture = np.full((shot.height, shot.width), level)

    def frames() -> Iterable[Exposure]:
        for _ in range(repeats):
            yield {"illumination": "O" if kind == "dark" else "C"}, {(0, 0): picture, (0, 1): picture}

    options = {"kind": kind, "repeats": repeats}
    return written(shot, folder, {"kind": kind}, options, frames, {"level": level}, items=())


def exposures(shot: Shot, folder: Path, *, steps: int = 12, repeats: int = 2, bend: float = 0.0) -> Path:
    """The flat target from a tenth of the range to beyond it (frame key `exposure_s`).

    Args:
        bend: how much of a full-scale signal is lost: counts = s (1 - bend s / full scale).
    """
    full = WHITE - OFFSET
    times = np.round(np.linspace(0.002, 0.022, steps), 5)

    def frames() -> Iterable[Exposure]:
        for t in np.repeat(times, repeats):
            signal = full * t / 0.02
            picture = np.full((shot.height, shot.width), signal * (1 - bend * signal / full))
            yield {"illumination": "C", "exposure_s": float(t)}, {(0, 0): picture, (0, 1): picture}

    truth = {"bend": bend, "counts_per_s": full / 0.02, "full_scale": full}
    options = {"steps": steps, "repeats": repeats, "bend": bend}
    return written(shot, folder, {"kind": "flat"}, options, frames, truth, items=("dark", "flat"))


def bands(shot: Shot, folder: Path, *, checker: bool = False, level: float = 0.85) -> Path:
    """A white target under every filter, unevenly lit by a little, and a ColorChecker below it where asked.

    Args:
        level: of the brightest band, of the range; the exposure of the others follows within a third.
    """
    rig, generator = Rig.made(shot), np.random.default_rng([shot.seed, 24])
    count = len(shot.bands_nm)
    if checker and not set(shot.bands_nm) <= set(color_checker.BANDS_NM):
        raise RigError(
            f"bands {list(shot.bands_nm)}: the ColorChecker's patches are known at {color_checker.BANDS_NM}"
        )
    white = generator.uniform(0.93, 0.99, count)
    transmission, source = generator.uniform(0.3, 0.9, count), generator.uniform(0.2, 1.0, count)
    wanted = level * (WHITE - OFFSET) * generator.uniform(0.66, 1, count) / white
    scale = wanted * np.round(wanted / (transmission * source), 3) / (wanted / (transmission * source))
    tilt = generator.uniform(-4, 4, 3)
    rotation = cv2.Rodrigues(np.radians(tilt))[0]
    to_image = scenes.plane_to_image(rotation, np.append(generator.uniform(-8, 8, 2), 0.0), rig.K, CAMERA_MM)
    slope = generator.uniform(-1e-4, 1e-4, 2)
    pitch, gap = 20.0, 1.5

    def texture_of(band: int, reflectance: float) -> Callable[[Array, Array], Array]:
        known = (
            np.array(color_checker.REFLECTANCE)[:, color_checker.BANDS_NM.index(band)] if checker else np.zeros(24)
        )

        def texture(u: Array, v: Array) -> Array:
            top = 8.0 if checker else -35.0
            on = (np.abs(u) < 50) & (v > top) & (v < top + 70)
            i, j = np.floor((u + 3 * pitch) / pitch), np.floor((-v - 5) / pitch)
            there = (i >= 0) & (i < 6) & (j >= 0) & (j < 4) & checker
            near = np.minimum(np.mod(u + 3 * pitch, pitch), np.mod(-v - 5, pitch))
            far = np.maximum(np.mod(u + 3 * pitch, pitch), np.mod(-v - 5, pitch))
            patch = there & (near > gap) & (far < pitch - gap)
            number = np.clip(6 * j + i, 0, 23).astype(int)
            board = (np.abs(u) < 3 * pitch + 6) & (v < 0) & (v > -4 * pitch - 11) & checker
            plain = np.where(on, reflectance, np.where(board, 0.035, 0.15 if checker else 0.02))
            return np.asarray(np.where(patch, known[number], plain) * (1 + slope[0] * u + slope[1] * v))

        return texture

    def frames() -> Iterable[Exposure]:
        shape = (shot.height, shot.width)
        pictures = {
            (b, c): scale[b] * scenes.plane(_grid(rig, shot, c), shape, to_image, texture_of(band, white[b]), 3)
            for b, band in enumerate(shot.bands_nm)
            for c in (0, 1)
        }
        yield {"illumination": "C"}, pictures

    truth = {
        "scale": scale,
        "transmission": transmission,
        "source": source,
        "exposure": scale / (transmission * source),
        "reflectance": white,
        "target_to_image": to_image,
        "checker_pitch_mm": pitch if checker else None,
    }
    target = {"kind": "white", "reflectance": [round(float(w), 6) for w in white]}
    return written(
        shot, folder, target, {"checker": checker, "level": level}, frames, truth, items=("camera", "dark", "flat")
    )


def _grid(rig: Rig, shot: Shot, camera: int) -> Callable[[Array, Array], Array]:
    """Raw pixels of a camera -> pixels of CAM1; CAM0's mount (180 degrees, mirrored) leaves x and turns y."""

    def cross(x: Array, y: Array) -> Array:
        if camera == 1:
            return np.stack([x, y], axis=-1)
        p = np.stack([x, shot.height - 1 - y, np.ones_like(x)], axis=-1) @ rig.parallel_to_cross.T
        return np.asarray(p[..., :2] / p[..., 2:])

    return cross


def _raw_of(rig: Rig, shot: Shot, cross: Array) -> Array:
    """Pixels (point, xy) of CAM1 -> raw pixels of CAM0."""
    p = np.asarray(cv2.perspectiveTransform(cross[None], np.linalg.inv(rig.parallel_to_cross))[0])
    return np.asarray(np.stack([p[:, 0], shot.height - 1 - p[:, 1]], axis=-1))

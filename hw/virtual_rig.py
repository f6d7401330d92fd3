"""The virtual rig: a capture folder of a head that never was, with ground truth beside it.

41 lights at 790 mm, each a few millimetres off its ideal place, driven with 12-bit weights made from the ideal
places; two cameras behind a beam splitter, the parallel one turned, mirrored and a little offset; 10 bits. What
it writes is what an archive holds: `capture.yaml`, pictures, `calibration/`, and `truth/`.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hw import head, skin
from hw.errors import RigError
from hw.folder import appearing, dump, save
from hw.geodesic import light_positions
from hw.gradients import weights
from hw.sensor import BITS, OFFSET, STORED_SCALE, WHITE, Sensor
from hw.sequence import static

RADIUS_MM = 790.0
CAMERA_MM = 890.0
GLOSS = 0.25
STATIC = static()
THESIS_BANDS = (407, 434, 445, 497, 576, 655)
_WIDTHS = {407: 17, 434: 17, 445: 20, 497: 16, 576: 10, 655: 15}
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Shot:
    """What to capture."""

    session: str = "demo"
    width: int = 406
    height: int = 309
    bands_nm: tuple[int, ...] = THESIS_BANDS
    sequence: tuple[str, ...] = STATIC
    seed: int = 1
    """0 is the mean head; others vary its proportions and skin, the rig's tolerances and the noise."""
    frequency: int = 2
    """Of the geodesic sphere: 2 for 41 lights, 4 for 161."""

    def __post_init__(self) -> None:
        if not (32 <= self.width <= 8192 and 32 <= self.height <= 8192):
            raise RigError(f"{self.width} x {self.height}: the virtual cameras have 32 to 8192 pixels a side")
        if not self.bands_nm or any(b != 0 and not 390 <= b <= 760 for b in self.bands_nm):
            raise RigError(
                f"bands {list(self.bands_nm)}: 0 (unfiltered) or wavelengths from 390 to 760 nm are possible"
            )
        if self.seed < 0:
            raise RigError(f"seed {self.seed}: a number from 0 up is needed")


@dataclass(frozen=True)
class Rig:
    """The parts of one rig that calibration would measure."""

    ideal: Array
    lights: Array
    K: Array
    parallel_to_cross: Array
    """(3, 3): CAM0 with its mount undone -> CAM1."""
    sensors: tuple[Sensor, Sensor]

    @classmethod
    def made(cls, shot: Shot) -> "Rig":
        """The rig for a shot; its tolerances follow from the seed."""
        generator = np.random.default_rng([shot.seed, 3])
        ideal = light_positions(shot.frequency)
        lights = RADIUS_MM * ideal + generator.uniform(-4, 4, ideal.shape)
        focal = 1020 * shot.width / 406
        matrix = np.array([[focal, 0, 0.5005 * shot.width], [0, focal, 0.4965 * shot.height], [0, 0, 1]])
        scale = shot.width / 406
        turn = np.radians(generator.uniform(-0.3, 0.3))
        shift = scale * generator.uniform(-3, 3, 2)
        warp = np.array(
            [
                [1.001 * np.cos(turn), -np.sin(turn), shift[0]],
                [np.sin(turn), 0.999 * np.cos(turn), shift[1]],
                [6e-6 / scale, -4e-6 / scale, 1],
            ]
        )
        shape = (shot.height, shot.width)
        return cls(ideal, lights, matrix, warp, (Sensor.made(shape, generator), Sensor.made(shape, generator)))


def capture(shot: Shot, folder: Path) -> Path:
    """Render a shot into `folder`, which appears whole; nothing happens when it holds the same shot already.

    Raises:
        RigError: the folder holds something else.
    """
    return appearing(folder, {"virtual_rig": 1, "shot": asdict(shot)}, lambda work: _write(shot, work))


def _write(shot: Shot, folder: Path) -> None:
    rig = Rig.made(shot)
    shape = head.parts(shot.seed)
    drive = np.stack([weights(name, rig.ideal) for name in shot.sequence])
    y, x = np.mgrid[0 : shot.height, 0 : shot.width].astype(float)
    grids = (_cross_position(rig, shot, x, y), np.stack([x, y], axis=-1))
    field = head.coarse_field(shape)
    views = [_render(shape, field, rig, shot, grid, drive) for grid in grids]
    cross = views[1]
    exposures = []
    for band in shot.bands_nm:
        brightest = views[0].albedo(band) * views[0].diffuse[0] / 2 + views[0].specular[0]
        exposures.append(round(0.85 * (WHITE - OFFSET) / float(np.percentile(brightest, 99.97)), 6))
    generators = [np.random.default_rng([shot.seed, 4, camera]) for camera in (0, 1)]
    for i, name in enumerate(shot.sequence):
        for band, exposure in zip(shot.bands_nm, exposures, strict=True):
            for camera, view in enumerate(views):
                radiance = view.albedo(band) * view.diffuse[i] / 2
                if camera == 0:
                    radiance = radiance + view.specular[i]
                picture = rig.sensors[camera].expose(exposure * radiance, generators[camera])
                save(folder / f"{i:04d}_{name}_{band}nm_CAM{camera}.png", picture)
    _write_description(shot, folder)
    _write_items(shot, rig, exposures, folder / "calibration")
    truth = folder / "truth"
    truth.mkdir()
    np.savez_compressed(
        truth / "ground_truth_cam1.npz",
        normal=cross.normal.astype(np.float32),
        depth_mm=cross.depth.astype(np.float32),
        mask=cross.mask,
        albedo_bands=np.stack([cross.albedo(b) for b in shot.bands_nm], axis=-1).astype(np.float32),
        melanin=cross.melanin.astype(np.float32),
        haemoglobin=cross.haemoglobin.astype(np.float32),
    )


def _cross_position(rig: Rig, shot: Shot, x: Array, y: Array) -> Array:
    """Where CAM0's raw pixels look, in CAM1's pixels: its mount (180 degrees, mirrored) undone, then the warp."""
    turned_x, turned_y = shot.width - 1 - x, shot.height - 1 - y
    mirrored_x = shot.width - 1 - turned_x
    p = np.stack([mirrored_x, turned_y, np.ones_like(x)], axis=-1) @ rig.parallel_to_cross.T
    return np.asarray(p[..., :2] / p[..., 2:])


@dataclass(frozen=True)
class _View:
    diffuse: Array  # (illumination, y, x), per unit albedo
    specular: Array
    melanin: Array  # (y, x)
    haemoglobin: Array
    mask: NDArray[np.bool_]
    normal: Array  # (y, x, xyz)
    depth: Array

    def albedo(self, band: float) -> Array:
        return skin.albedo(self.melanin, self.haemoglobin, band)


def _render(shape: Array, field: NDArray[np.float32], rig: Rig, shot: Shot, grid: Array, drive: Array) -> _View:
    """One camera's noise-free picture; pixels on an edge are the mean of nine rays."""
    rows, columns = grid.shape[:2]
    origin = np.array([0.0, 0.0, CAMERA_MM])

    def rays(points: Array) -> Array:
        # camera x right, y down, z forward; world x right, y up, z towards the camera
        u = (points[..., 0] - rig.K[0, 2]) / rig.K[0, 0]
        v = (points[..., 1] - rig.K[1, 2]) / rig.K[1, 1]
        d = np.stack([u, -v, -np.ones_like(u)], axis=-1)
        return np.ascontiguousarray(d / np.linalg.norm(d, axis=-1, keepdims=True)).reshape(-1, 3)

    def trace(points: Array) -> tuple[Array, Array, Array, Array]:
        directions = rays(points)
        pieces = np.array_split(np.arange(len(directions)), 16)

        def work(piece: NDArray[np.int64]) -> tuple[Array, ...]:
            part = np.ascontiguousarray(directions[piece])
            t, n = head.surface(shape, field, part, origin)
            return (t, n, *head.shading(field, part, origin, t, n, rig.lights, RADIUS_MM, drive, GLOSS))

        with ThreadPoolExecutor(max_workers=len(os.sched_getaffinity(0))) as pool:
            done = list(pool.map(work, pieces))
        t, n, d, s = (np.concatenate(column) for column in zip(*done, strict=True))
        return t, n, d, s

    t, n, d, s = trace(grid)
    directions = rays(grid)
    points = (origin + t[:, None] * directions).reshape(rows, columns, 3)
    mask = (t >= 0).reshape(rows, columns)
    depth = np.where(mask, CAMERA_MM - points[..., 2], 0)
    d, s = d.reshape(rows, columns, -1), s.reshape(rows, columns, -1)
    edge = _edges(mask, depth)
    if edge.any():
        step = np.array([-1, 0, 1]) / 3
        offsets = np.stack(np.meshgrid(step, step), axis=-1).reshape(1, 9, 2)
        _, _, fine_d, fine_s = trace(grid[edge][:, None, :] + offsets)
        d[edge] = fine_d.reshape(-1, 9, d.shape[2]).mean(axis=1)
        s[edge] = fine_s.reshape(-1, 9, s.shape[2]).mean(axis=1)
    melanin, blood = head.pigments(points, shot.seed)
    normal = n.reshape(rows, columns, 3)
    return _View(np.moveaxis(d, 2, 0), np.moveaxis(s, 2, 0), melanin, blood, mask, normal, depth)


def _edges(mask: NDArray[np.bool_], depth: Array) -> NDArray[np.bool_]:
    """Pixels next to the outline or to a step in depth."""
    kernel = np.ones((3, 3), np.uint8)
    low = cv2.erode(depth, kernel)
    high = cv2.dilate(depth, kernel)
    return np.asarray((high - low) > 6.0)


def _write_description(shot: Shot, folder: Path) -> None:
    dump(
        folder / "capture.yaml",
        {
            "format": "lightstage-capture/1",
            "session": shot.session,
            "rig": "virtual",
            "bits": BITS,
            "frame_rate_hz": None,
            "cameras": {"parallel": "CAM0", "cross": "CAM1"},
            "mount": {"CAM0": {"rotate": 180, "mirror": True}, "CAM1": {"rotate": 0, "mirror": False}},
            "bands_nm": list(shot.bands_nm),
            "files": "{frame:04d}_{illumination}_{band}nm_{camera}.png",
            "frames": [{"illumination": name} for name in shot.sequence],
            "calibration": "calibration/",
        },
    )


def _write_items(shot: Shot, rig: Rig, exposures: Sequence[float], folder: Path) -> None:
    folder.mkdir()
    for camera, sensor in enumerate(rig.sensors):
        save(folder / f"dark_CAM{camera}.png", sensor.dark_frame())
        save(folder / f"flat_CAM{camera}.png", sensor.flat_frame())
    pictures = {kind: {f"CAM{i}": f"{kind}_CAM{i}.png" for i in (0, 1)} for kind in ("dark", "flat")}
    own = {"rig": "virtual"}
    items: list[dict[str, Any]] = [
        {"item": "dark", **own, "images": pictures["dark"], "scale": STORED_SCALE},
        {"item": "flat", **own, "images": pictures["flat"], "scale": STORED_SCALE, "dark_included": True},
        {"item": "homography", **own, "from": "CAM0", "to": "CAM1", "matrix": rig.parallel_to_cross},
        {
            "item": "camera",
            **own,
            "size_px": [shot.width, shot.height],
            "K": rig.K,
            "distortion": [0, 0, 0, 0, 0],
            "world_to_camera": {"R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "t_mm": [0, 0, CAMERA_MM]},
        },
        {
            "item": "lights",
            **own,
            "drive": "ideal",
            "lights": [
                {
                    "id": f"L{k:02d}",
                    "channel": k,
                    "position_mm": np.round(place, 3),
                    "drive_position": np.round(ideal, 8),
                    "power": 1.0,
                    "seen": True,
                }
                for k, (place, ideal) in enumerate(zip(rig.lights, rig.ideal, strict=True))
            ],
        },
        {
            "item": "bands",
            **own,
            "bands": [
                {
                    "centre_nm": band,
                    "width_nm": _WIDTHS.get(band, 15) if band else None,
                    "exposure": exposure,
                    "transmission": 1.0,
                    "source": 1.0,
                }
                for band, exposure in zip(shot.bands_nm, exposures, strict=True)
            ],
        },
    ]
    for item in items:
        dump(folder / f"{item['item']}.yaml", item)

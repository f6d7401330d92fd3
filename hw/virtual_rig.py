"""The virtual rig: a capture folder of a head that never was, with ground truth beside it.

41 lights at 790 mm, each a few millimetres off its ideal place, driven with 12-bit weights made from the ideal
places; two cameras behind a beam splitter, the parallel one turned, mirrored and a little offset; 10 bits. What
it writes is what an archive holds: `capture.yaml`, pictures, `calibration/`, and `truth/`.

A shot with a motion is a performance: one picture every 1/60 s, each under the next illumination of the sequence,
instantaneous and without motion blur, by the cross camera alone. Its truth is per picture: normals, depth and mask,
and the flow of the skin to the tracking frames (C) around it. Only one picture is in memory at a time.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.hw import head, motion, skin
from lightstage.hw.errors import RigError
from lightstage.hw.folder import appearing, dump, save
from lightstage.hw.geodesic import light_positions
from lightstage.hw.gradients import weights
from lightstage.hw.illuminations import light_name
from lightstage.hw.motion import Pose
from lightstage.hw.sensor import BITS, OFFSET, STORED_SCALE, WHITE, Sensor
from lightstage.hw.sequence import static
from lightstage.hw.target_scenes import project

RADIUS_MM = 790.0
CAMERA_MM = 890.0
GLOSS = 0.25
STATIC = static()
RATE_HZ = 60.0
"""Of a performance."""
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
    motion: str | None = None
    """still, slow or fast makes it a performance; None is a static capture."""

    def __post_init__(self) -> None:
        if not (32 <= self.width <= 8192 and 32 <= self.height <= 8192):
            raise RigError(f"{self.width} x {self.height}: the virtual cameras have 32 to 8192 pixels a side")
        if not self.bands_nm or any(b != 0 and not 390 <= b <= 760 for b in self.bands_nm):
            raise RigError(
                f"bands {list(self.bands_nm)}: 0 (unfiltered) or wavelengths from 390 to 760 nm are possible"
            )
        if self.seed < 0:
            raise RigError(f"seed {self.seed}: a number from 0 up is needed")
        if self.motion is not None:
            self._check_performance()

    def _check_performance(self) -> None:
        if self.motion not in motion.MOTIONS:
            raise RigError(f"the motion '{self.motion}' is not known; expected {', '.join(motion.MOTIONS)}")
        if len(self.bands_nm) != 1:
            raise RigError(
                f"bands {list(self.bands_nm)}: a performance has one band, because filters do not change in 1/60 s"
            )
        if "C" not in self.sequence:
            raise RigError(f"the sequence {' '.join(self.sequence)} has no tracking frame; a performance needs a C")

    def described(self) -> dict[str, Any]:
        """All options by name: what a folder is told apart by. A static capture's has no motion."""
        return {name: value for name, value in asdict(self).items() if name != "motion" or value is not None}


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
    write = _write if shot.motion is None else _perform
    return appearing(folder, {"virtual_rig": 1, "shot": shot.described()}, lambda work: write(shot, work))


def _write(shot: Shot, folder: Path) -> None:
    rig = Rig.made(shot)
    shape = head.parts(shot.seed)
    drive = np.stack([weights(name, rig.ideal) for name in shot.sequence])
    y, x = np.mgrid[0 : shot.height, 0 : shot.width].astype(float)
    grids = (_cross_position(rig, shot, x, y), np.stack([x, y], axis=-1))
    field = head.coarse_field(shape)
    views = [_render(shape, field, motion.REST, rig, shot, grid, drive) for grid in grids]
    cross = views[1]
    exposures = []
    for band in shot.bands_nm:
        exposures.append(_exposure(views[0].albedo(band) * views[0].diffuse[0] / 2 + views[0].specular[0]))
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


def radiance(shot: Shot, illuminations: Sequence[str]) -> tuple[Array, Array]:
    """What the cross camera's place sees of the head at rest, without polarisers, noise or quantisation.

    Returns:
        diffuse (illumination, band, y, x) and specular (illumination, y, x) radiance; 1 is a white surface that
        faces one light at full power at the rig's radius.
    """
    rig, shape = Rig.made(shot), head.parts(shot.seed)
    drive = np.stack([weights(name, rig.ideal) for name in illuminations])
    y, x = np.mgrid[0 : shot.height, 0 : shot.width].astype(float)
    view = _render(shape, head.coarse_field(shape), motion.REST, rig, shot, np.stack([x, y], axis=-1), drive)
    albedo = np.stack([view.albedo(band) for band in shot.bands_nm])
    return albedo * view.diffuse[:, None], view.specular


def _exposure(brightest: Array) -> float:
    """Counts per radiance that bring the brightest parts of a picture to 85 % of the range."""
    return round(0.85 * (WHITE - OFFSET) / float(np.percentile(brightest, 99.97)), 6)


def _perform(shot: Shot, folder: Path) -> None:
    """A performance, written picture by picture."""
    assert shot.motion is not None
    rig = Rig.made(shot)
    shape = head.parts(shot.seed)
    at_rest = head.coarse_field(shape)
    y, x = np.mgrid[0 : shot.height, 0 : shot.width].astype(float)
    grid = np.stack([x, y], axis=-1)
    (band,) = shot.bands_nm
    poses = [motion.pose(shot.motion, i / RATE_HZ) for i in range(len(shot.sequence))]
    generator = np.random.default_rng([shot.seed, 4, 1])
    truth = folder / "truth"
    truth.mkdir()
    fastest = []
    exposure = 0.0
    for i, name in enumerate(shot.sequence):
        drive = np.stack([weights(illumination, rig.ideal) for illumination in ((name,) if i else (name, "C"))])
        view = _render(shape, head.bent_field(shape, at_rest, poses[i].warp), poses[i], rig, shot, grid, drive)
        albedo = view.albedo(band)
        if i == 0:  # the exposure is set before the performance, under C
            exposure = _exposure(albedo * view.diffuse[1] / 2)
        picture = rig.sensors[1].expose(exposure * albedo * view.diffuse[0] / 2, generator)
        save(folder / f"{i:04d}_{name}_{band}nm_CAM1.png", picture)
        head_only = view.mask[..., None]
        np.savez_compressed(
            truth / f"gt_t{i:02d}.npz",
            normal=np.where(head_only, view.normal, 0).astype(np.float16),
            depth_mm=view.depth.astype(np.float32),
            mask=view.mask,
            albedo=np.where(view.mask, albedo, 0).astype(np.float16),
        )
        flows: dict[str, NDArray[Any]] = {}
        for label, other in _flow_targets(shot.sequence, i):
            flow = _flow(view, poses[other], rig, grid)
            flows[f"flow_to_{label}"] = flow.astype(np.float16)
            field = head.bent_field(shape, at_rest, poses[other].warp)
            flows[f"visible_{label}"] = _visible(shape, field, view, poses[other], grid + flow)
            if label.endswith("C"):
                flows[f"t_{label}"] = np.array(other)
        np.savez_compressed(truth / f"flow_t{i:02d}.npz", allow_pickle=False, **flows)
        if i + 1 < len(poses):
            step = np.linalg.norm(_flow(view, poses[i + 1], rig, grid)[view.mask], axis=-1)
            fastest.append(round(float(np.percentile(step, 99.8)), 4))
    _write_description(shot, folder, performance=True)
    _write_items(shot, rig, [exposure], folder / "calibration")
    dump(truth / "meta.yaml", _meta(shot, rig, exposure, poses, fastest))


def _flow_targets(sequence: Sequence[str], i: int) -> list[tuple[str, int]]:
    """Where truth flow goes from picture i, by label: to the C before and after it, and from a C to every picture
    between those two."""
    before = next((t for t in range(i - 1, -1, -1) if sequence[t] == "C"), None)
    after = next((t for t in range(i + 1, len(sequence)) if sequence[t] == "C"), None)
    targets = []
    if before is not None:
        targets.append(("prevC", before))
    if after is not None:
        targets.append(("nextC", after))
    if sequence[i] == "C":
        first = 0 if before is None else before + 1
        last = len(sequence) if after is None else after
        targets += [(f"t{t:02d}", t) for t in range(first, last) if t != i]
    return targets


def _flow(view: "_View", pose: Pose, rig: Rig, grid: Array) -> Array:
    """(y, x, xy), pixels: from where a point of the skin is seen to where it is in another pose; 0 off the head."""
    flow = np.zeros_like(grid)
    world = pose.leave(head.place(view.material[view.mask], pose.warp))
    flow[view.mask] = project(world, rig.K, CAMERA_MM) - grid[view.mask]
    return flow


def _visible(
    shape: Array, field: NDArray[np.float32], view: "_View", pose: Pose, seen_at: Array
) -> NDArray[np.bool_]:
    """(y, x): whether the skin of a view is seen in another pose: in the picture, and nothing stands before it.

    Args:
        field: that of the other pose.
    """
    rows, columns = view.mask.shape
    eye = np.array([0.0, 0.0, CAMERA_MM])
    way = pose.leave(head.place(view.material[view.mask], pose.warp)) - eye
    length = np.linalg.norm(way, axis=-1)
    origin, rays = pose.enter(eye), (way / length[:, None]) @ pose.rotation

    def work(piece: NDArray[np.int64]) -> tuple[Array]:
        return (head.first_hit(shape, field, pose.warp, np.ascontiguousarray(rays[piece]), origin),)

    (t,) = _in_pieces(work, len(rays))
    inside = ((seen_at >= 0) & (seen_at <= np.array([columns - 1, rows - 1]))).all(axis=-1)
    free = np.zeros(view.mask.shape, bool)
    free[view.mask] = (t >= 0) & (np.abs(t - length) < 0.5)  # mm; the relief's height
    return np.asarray(free & inside)


def _meta(shot: Shot, rig: Rig, exposure: float, poses: Sequence[Pose], fastest: Sequence[float]) -> dict[str, Any]:
    return {
        "frames_and_units": {
            "world": "right-handed, origin at the stage's centre, x right, y up, z towards the camera; mm",
            "pixels": "(0, 0) is the centre of the top-left pixel",
            "depth": "camera-frame z in mm (not ray length)",
            "flow": "(dx, dy) in px: what is seen at (x, y) in a picture is at (x + dx, y + dy) in the other; "
            "float16; 0 off the head",
            "rot_deg_xyz": "world = Rz Ry Rx head + trans_mm",
        },
        "image_size_wh": [shot.width, shot.height],
        "K_reference_camera_CAM1": rig.K,
        "camera_distance_mm": CAMERA_MM,
        "subject": f"head {shot.seed}",
        "motion": shot.motion,
        "camera_used": "CAM1 (cross), instantaneous exposure, no motion blur",
        "exposure_dn_per_radiance": exposure,
        "peak_px_per_frame": list(fastest),
        "motion_per_frame": [
            {
                "rot_deg_xyz": [round(pose.channels[f"turn_{axis}"], 6) for axis in "xyz"],
                "trans_mm": [round(pose.channels[f"shift_{axis}"], 6) for axis in "xyz"],
                **{f"{name}_mm": round(pose.channels[name], 6) for name in ("jaw", "smile", "brow", "cheek")},
            }
            for pose in poses
        ],
    }


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
    material: Array  # (y, x, xyz), mm: which point of the head at rest is seen

    def albedo(self, band: float) -> Array:
        return skin.albedo(self.melanin, self.haemoglobin, band)


def _in_pieces(work: Callable[[NDArray[np.int64]], tuple[Array, ...]], count: int) -> tuple[Array, ...]:
    """What `work` makes of the numbers below `count`, done in threads."""
    with ThreadPoolExecutor(max_workers=len(os.sched_getaffinity(0))) as pool:
        done = list(pool.map(work, np.array_split(np.arange(count), 16)))
    return tuple(np.concatenate(column) for column in zip(*done, strict=True))


def _render(
    shape: Array, field: NDArray[np.float32], pose: Pose, rig: Rig, shot: Shot, grid: Array, drive: Array
) -> _View:
    """One camera's noise-free picture; pixels on an edge are the mean of nine rays."""
    rows, columns = grid.shape[:2]
    eye = np.array([0.0, 0.0, CAMERA_MM])
    # light and shadow are the same in any frame: they are found in the head's, where lamps and rays move
    origin, lights = pose.enter(eye), np.ascontiguousarray(pose.enter(rig.lights))

    def rays(points: Array) -> Array:
        # camera x right, y down, z forward; world x right, y up, z towards the camera
        u = (points[..., 0] - rig.K[0, 2]) / rig.K[0, 0]
        v = (points[..., 1] - rig.K[1, 2]) / rig.K[1, 1]
        d = np.stack([u, -v, -np.ones_like(u)], axis=-1)
        return np.ascontiguousarray(d / np.linalg.norm(d, axis=-1, keepdims=True)).reshape(-1, 3)

    def trace(points: Array) -> tuple[Array, ...]:
        directions = rays(points) @ pose.rotation

        def work(piece: NDArray[np.int64]) -> tuple[Array, ...]:
            part = np.ascontiguousarray(directions[piece])
            t, n = head.surface(shape, field, pose.warp, part, origin)
            lit = head.shading(field, part, origin, t, n, lights, RADIUS_MM, drive, GLOSS)
            return (t, n, *lit)

        return _in_pieces(work, len(directions))

    t, n, d, s = trace(grid)
    directions = rays(grid)
    depth = CAMERA_MM - (eye + t[:, None] * directions)[:, 2].reshape(rows, columns)
    mask = (t >= 0).reshape(rows, columns)
    depth = np.where(mask, depth, 0)
    d, s = d.reshape(rows, columns, -1), s.reshape(rows, columns, -1)
    edge = _edges(mask, depth)
    if edge.any():
        step = np.array([-1, 0, 1]) / 3
        offsets = np.stack(np.meshgrid(step, step), axis=-1).reshape(1, 9, 2)
        _, _, fine_d, fine_s = trace(grid[edge][:, None, :] + offsets)
        d[edge] = fine_d.reshape(-1, 9, d.shape[2]).mean(axis=1)
        s[edge] = fine_s.reshape(-1, 9, s.shape[2]).mean(axis=1)
    points = origin + t[:, None] * (directions @ pose.rotation)
    material = head.material(points, pose.warp).reshape(rows, columns, 3)
    melanin, blood = head.pigments(material, shot.seed)
    normal = (n @ pose.rotation.T).reshape(rows, columns, 3)
    return _View(np.moveaxis(d, 2, 0), np.moveaxis(s, 2, 0), melanin, blood, mask, normal, depth, material)


def _edges(mask: NDArray[np.bool_], depth: Array) -> NDArray[np.bool_]:
    """Pixels next to the outline or to a step in depth."""
    kernel = np.ones((3, 3), np.uint8)
    low = cv2.erode(depth, kernel)
    high = cv2.dilate(depth, kernel)
    return np.asarray((high - low) > 6.0)


def _write_description(shot: Shot, folder: Path, *, performance: bool = False) -> None:
    frames: list[dict[str, Any]] = [{"illumination": name} for name in shot.sequence]
    if performance:
        for i, frame in enumerate(frames):
            frame["time_s"] = round(i / RATE_HZ, 6)
    dump(
        folder / "capture.yaml",
        {
            "format": "lightstage-capture/1",
            "session": shot.session,
            "rig": "virtual",
            "bits": BITS,
            "frame_rate_hz": RATE_HZ if performance else None,
            "cameras": {"cross": "CAM1"} if performance else {"parallel": "CAM0", "cross": "CAM1"},
            "mount": {"CAM0": {"rotate": 180, "mirror": True}, "CAM1": {"rotate": 0, "mirror": False}},
            "bands_nm": list(shot.bands_nm),
            "files": "{frame:04d}_{illumination}_{band}nm_{camera}.png",
            "frames": frames,
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
                    "id": light_name(k),
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

"""Truth for tests, made without any kernel and without `hw`: closed forms, and capture folders written by hand."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

GRADIENTS = ("X", "Y", "Z", "Xc", "Yc", "Zc")
STATIC = ("C", *GRADIENTS)
Array = NDArray[Any]


def sphere_normals(size: int = 48) -> tuple[Array, Array]:
    """(xyz, y, x) unit normals of a sphere that fills the picture, seen from +z, and its mask; y is up."""
    y, x = np.mgrid[0:size, 0:size]
    nx, ny = (x - (size - 1) / 2) / (size / 2), -(y - (size - 1) / 2) / (size / 2)
    square = nx**2 + ny**2
    mask = square < 0.95
    nz = np.sqrt(np.clip(1 - square, 0, None))
    return np.where(mask, np.stack([nx, ny, nz]), np.array([0.0, 0, 1])[:, None, None]), mask


def ideal_gradient(normals: Array, illumination: str, albedo: float | Array = 1.0) -> Array:
    """Lambertian radiance under a full sphere of light: r_c (1/2 + n_a / 3), complement r_c (1/2 - n_a / 3)."""
    if illumination == "C":
        return albedo * np.ones(normals.shape[1:])
    sign = -1 if illumination.endswith("c") else 1
    return albedo * (0.5 + sign * normals["XYZ".index(illumination[0])] / 3)


def angle_deg(normals: Array, truth: Array) -> Array:
    """Angle between two fields of vectors (xyz, y, x), degrees; exact also for small angles."""
    a = normals / np.linalg.norm(normals, axis=0)
    b = truth / np.linalg.norm(truth, axis=0)
    return np.degrees(2 * np.arctan2(np.linalg.norm(a - b, axis=0), np.linalg.norm(a + b, axis=0)))


def decoded(normal: Array) -> Array:
    """Stored int16 normals as floats, NaN where there is none."""
    return np.where(normal == -32768, np.nan, normal / 32767.0)


def write_capture(
    folder: Path,
    pictures: Mapping[tuple[int, float, str], Array],
    *,
    illumination: Sequence[str],
    items: Mapping[str, Mapping[str, Any]] | None = None,
    item_pictures: Mapping[str, Array] | None = None,
    **description: Any,
) -> Path:
    """A capture folder: pictures by (frame, band, polarisation), and its description; returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    cameras = {"parallel": "CAM0", "cross": "CAM1", "unpolarised": "CAM"}
    polarisations = sorted({p for _, _, p in pictures}, key=list(cameras).index)
    bands = list(dict.fromkeys(band for _, band, _ in pictures))
    text = {
        "format": "lightstage-capture/1",
        "session": folder.name,
        "bits": 10,
        "cameras": {p: cameras[p] for p in polarisations},
        "bands_nm": bands,
        "files": "{frame:04d}_{illumination}_{band}nm_{camera}.png",
        "frames": [{"illumination": name} for name in illumination],
        **({"calibration": "calibration/"} if items else {}),
        **description,
    }
    (folder / "capture.yaml").write_text(yaml.safe_dump(text, sort_keys=False))
    for (frame, band, polarisation), picture in pictures.items():
        name = f"{frame:04d}_{illumination[frame]}_{band:g}nm_{cameras[polarisation]}.png"
        assert cv2.imwrite(str(folder / name), picture)
    if items:
        (folder / "calibration").mkdir(exist_ok=True)
        for kind, item in items.items():
            (folder / "calibration" / f"{kind}.yaml").write_text(yaml.safe_dump(dict(item), sort_keys=False))
        for name, picture in (item_pictures or {}).items():
            assert cv2.imwrite(str(folder / "calibration" / name), picture)
    return folder


def sphere_capture(
    folder: Path, *, size: int = 48, bands: Sequence[float] = (576,), seed: int = 0, **more: Any
) -> Path:
    """A small two-camera capture of a sphere under ideal gradients, with a homography that shifts by a pixel."""
    generator = np.random.default_rng(seed)
    normals, _ = sphere_normals(size)
    pictures = {}
    for i, name in enumerate(STATIC):
        for band in bands:
            diffuse = 600 * ideal_gradient(normals, name) + generator.normal(0, 2, (size, size))
            cross = diffuse / 2
            parallel = cross + 100 * ideal_gradient(normals, name)
            pictures[i, band, "cross"] = np.round(np.clip(cross, 0, 1023)).astype(np.uint16)
            pictures[i, band, "parallel"] = np.round(np.clip(np.roll(parallel, 1, axis=1), 0, 1023)).astype(
                np.uint16
            )
    shift = {"item": "homography", "from": "CAM0", "to": "CAM1", "matrix": [[1, 0, -1], [0, 1, 0], [0, 0, 1]]}
    scale = {
        "item": "bands",
        "bands": [{"centre_nm": band, "exposure": 3.0, "transmission": 0.9} for band in bands],
    }
    return write_capture(folder, pictures, illumination=STATIC, items={"homography": shift, "bands": scale}, **more)


def one_camera_capture(
    folder: Path,
    illumination: Sequence[str],
    *,
    polarisation: str = "cross",
    shape: tuple[int, int] = (12, 16),
    **more: Any,
) -> Path:
    """A tiny capture with one camera; every picture has its own numbers."""
    generator = np.random.default_rng(1)
    pictures = {
        (i, 0, polarisation): generator.integers(50, 900, shape).astype(np.uint16) for i in range(len(illumination))
    }
    return write_capture(folder, pictures, illumination=illumination, **more)


LIGHT_MM = 790.0


def light_places(count: int = 41, seed: int = 0, off_mm: float = 4) -> tuple[Array, Array]:
    """(light, xyz) positions in mm spread over a sphere of LIGHT_MM, each some mm off, and their drive vectors."""
    k = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1 - 2 * k / count), np.pi * (1 + 5**0.5) * k  # Fibonacci's lattice
    drive = np.stack([np.cos(azimuth) * np.sin(polar), np.cos(polar), np.sin(azimuth) * np.sin(polar)], axis=1)
    offsets = np.random.default_rng(seed).uniform(-off_mm, off_mm, drive.shape)
    return LIGHT_MM * drive + offsets, drive


def near_ball(
    lights: Array,
    drive: Array,
    *,
    size: int = 96,
    radius_mm: float = 80.0,
    camera_mm: float = 890.0,
    cone_deg: Array | None = None,
) -> tuple[dict[str, Array], Array, Array, dict[str, Any]]:
    """A white ball at the origin under near point lights, as a pinhole camera at (0, 0, camera_mm) sees it.

    With `cone_deg` (y, x) a point sees the lights within that angle about its normal, as if the surface had pits
    that are too fine to be seen.

    Returns:
        pictures by illumination (STATIC), 0 off the ball; normals (xyz, y, x); depth (camera z, mm, NaN off the
        ball); the camera item's values.
    """
    focal = 0.42 * size * camera_mm / radius_mm
    middle = (size - 1) / 2
    y, x = np.mgrid[0:size, 0:size]
    rays = np.stack([(x - middle) / focal, -(y - middle) / focal, -np.ones((size, size))])
    towards, square = -camera_mm * rays[2], np.einsum("ayx,ayx->yx", rays, rays)
    root = towards**2 - square * (camera_mm**2 - radius_mm**2)
    mask = root > 0
    depth = np.where(mask, (towards - np.sqrt(np.maximum(root, 0))) / square, np.nan)
    points = np.array([0, 0, camera_mm])[:, None, None] + depth * rays
    normals = points / radius_mm
    pictures = {name: np.zeros((size, size)) for name in STATIC}
    for place, ideal in zip(lights, drive, strict=True):
        way = place[:, None, None] - points
        distance = np.linalg.norm(way, axis=0)
        cosine = np.einsum("ayx,ayx->yx", normals, way) / distance
        if cone_deg is not None:
            cosine = np.where(cosine > np.cos(np.radians(cone_deg)), cosine, 0)
        shade = np.maximum(cosine, 0) * (LIGHT_MM / distance) ** 2
        for name in STATIC:
            share = 1.0
            if name != "C":
                share = (1 + (-1 if name.endswith("c") else 1) * ideal["XYZ".index(name[0])]) / 2
            pictures[name] += share * np.where(mask, shade, 0)
    camera = {
        "size_px": [size, size],
        "K": [[focal, 0, middle], [0, focal, middle], [0, 0, 1]],
        "distortion": [0, 0, 0, 0, 0],
        "world_to_camera": {"R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "t_mm": [0, 0, camera_mm]},
    }
    return pictures, np.where(mask, normals, np.nan), depth, camera


MINIMAL = ("X", "Z", "C", "Y", "Xc", "C", "Zc", "Yc", "C", "X", "Z", "C")
"""Three windows with a full set, and a last tracking frame without one."""


@dataclass(frozen=True)
class Performer:
    """A textured ellipsoid that slides and stretches; what is at x at time 0 is at x + v(x) t + a(x) t^2 at time t.

    v and a are sums of cosines of the place, in pixels per picture. Normals travel with the surface and do not
    turn, so complements add up to constant light exactly, but for noise.
    """

    shape: tuple[int, int] = (124, 164)
    speed_px: float = 1.2
    bend_px: float = 0.15
    seed: int = 0

    def moved(self, time: float, x: Array, y: Array) -> Array:
        """(xy, y, x), pixels, from time 0."""
        size = self.shape[1]
        a, b = 2 * np.pi * x / size, 2 * np.pi * y / size
        velocity = np.stack([0.8 + 0.2 * np.cos(b + self.seed), 0.3 * np.cos(a) - 0.4 * np.sin(b)])
        change = np.stack([np.cos(0.7 * a + 1), np.cos(0.7 * b - 1 + self.seed)])
        return np.asarray(self.speed_px * time * velocity + self.bend_px * time**2 * change / np.sqrt(2))

    def origin(self, time: float) -> tuple[Array, Array]:
        """x and y at time 0 of what is at each pixel at a time; solved to 1e-6 px."""
        y, x = np.mgrid[0 : self.shape[0], 0 : self.shape[1]].astype(float)
        at = x, y
        for _ in range(100):
            u = self.moved(time, *at)
            new = x - u[0], y - u[1]
            change = max(np.abs(n - o).max() for n, o in zip(new, at, strict=True))
            at = new
            if change < 1e-6:
                return at
        raise ValueError("the motion folds the picture")

    def flow(self, tracking: float, time: float) -> Array:
        """(xy, y, x): what is at x at time `tracking` is at x + flow(x) at `time`."""
        at = self.origin(tracking)
        return self.moved(time, *at) - self.moved(tracking, *at)

    def surface(self, time: float) -> tuple[Array, Array, Array]:
        """Albedo, normals (xyz, y, x), and the inside, where all is away from rim and border."""
        x, y = self.origin(time)
        height, width = self.shape
        px, py = (x - width / 2) / (0.38 * width), (y - height / 2) / (0.42 * height)
        square = px**2 + py**2
        hills = [0.08 * np.cos(0.23 * x + self.seed), 0.08 * np.sin(0.19 * y - 0.07 * x)]
        normal = np.stack([0.8 * px + hills[0], -0.8 * py + hills[1], np.ones_like(x)])
        normal /= np.linalg.norm(normal, axis=0)
        # beyond the picture is a periodic continuation: what comes in at the border has a texture of its own
        fine = map_coordinates(self._texture(), [y, x], order=3, mode="grid-wrap")
        rim = np.clip((1 - np.sqrt(square)) * 0.38 * width + 0.5, 0, 1)
        inner = square < 0.85
        inner[:8] = inner[-8:] = inner[:, :8] = inner[:, -8:] = False
        return (0.7 + 0.08 * fine) * rim, normal, inner

    def _texture(self) -> Array:
        generator = np.random.default_rng([self.seed, 5])
        sums = np.zeros(self.shape)
        for sigma in (1.3, 3.0, 8.0):
            noise = cv2.GaussianBlur(
                generator.normal(size=self.shape), (0, 0), sigma, borderType=cv2.BORDER_REFLECT
            )
            sums += noise / noise.std()
        return np.clip(sums, -3, 3)

    def picture(self, time: float, illumination: str, *, noise: int | None = 0) -> Array:
        """Counts of 10 bits, 10 electrons each, with shot noise and 10 electrons of read noise; None: neither."""
        albedo, normal, _ = self.surface(time)
        counts = 950 * ideal_gradient(normal, illumination, albedo)
        if noise is None:
            return counts
        generator = np.random.default_rng([noise, round(1000 * time) % 2**32])
        electrons = 10 * counts
        electrons = electrons + generator.normal(size=electrons.shape) * np.sqrt(electrons + 100)
        return np.round(np.clip(electrons / 10, 0, 1023)).astype(np.uint16)


def performance_capture(
    folder: Path, performer: Performer, illumination: Sequence[str] = MINIMAL, **replaced: Array
) -> Path:
    """One camera, 60 pictures a second, time in pictures; `f4=...` replaces picture 4."""
    pictures = {
        (i, 0, "cross"): replaced.get(f"f{i}", performer.picture(i, name)) for i, name in enumerate(illumination)
    }
    frames = [{"illumination": name, "time_s": i / 60} for i, name in enumerate(illumination)]
    return write_capture(folder, pictures, illumination=illumination, frames=frames, frame_rate_hz=60.0)

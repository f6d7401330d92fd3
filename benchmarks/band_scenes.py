"""Multispectral captures whose bands were moved by known flows: the truth for `benchmarks.alignment --only bands`.

A scene is a head under constant light and the six gradients, in six bands, free of noise; between two bands the
subject moved, within a band it was still. `plane` moves the pictures: a shift of the whole, a turn in the plane and a
bend, so the specular component moves with the skin. `turned` renders the virtual rig's head anew in each band's pose,
so highlights stay with the lights while the skin moves beneath them. Then come shot and read noise of two cameras, an
exposure for each band, and the components D = 2 I_cross, S = I_parallel - I_cross.

Warped pictures are sampled by SciPy's quintic spline, not by the code under test.
"""

from dataclasses import dataclass
from functools import cache, partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, map_coordinates

from benchmarks.accuracy import DATA
from lightstage.hw import head, motion, virtual_rig
from lightstage.hw.gradients import weights
from lightstage.hw.sensor import ELECTRONS_PER_COUNT, OFFSET, READ_NOISE_ELECTRONS, WHITE
from lightstage.store.document import load

Array = NDArray[Any]
Motion = Literal["still", "plane", "turned"]
NAMES = ("C", "X", "Y", "Z", "Xc", "Yc", "Zc")
BANDS = virtual_rig.THESIS_BANDS
REFERENCE = 3
MARGIN_PX = 6
"""Judged is the mask without this rim, and without what leaves the picture."""


@dataclass(frozen=True)
class Ideal:
    """A subject without noise, at rest."""

    diffuse: Array
    """(band, picture, y, x) radiance."""
    specular: Array
    """(band, picture, y, x); the same in every band, but for the pose."""
    mask: Array
    """(band, y, x)"""
    albedo: Array
    """(band, y, x)"""
    flow: Array | None = None
    """(band, xy, y, x) from the reference band, where each band has a pose of its own."""


@dataclass(frozen=True)
class BandScene:
    """What `align` would get, and the truth."""

    radiance: Array
    """(band, picture, component, y, x) float32."""
    flow: Array
    """(band, xy, y, x): what band REFERENCE shows at x, band b shows at x + flow."""
    inner: NDArray[np.bool_]
    """(y, x): what is judged."""
    albedo: Array
    """(band, y, x), on the reference band's grid."""


def head_a() -> Ideal | None:
    """The rendered head of the shared data; None where they are not."""
    folder = DATA / "rendered" / "static_A" / "truth"
    if not folder.is_dir():
        return None
    lights, truth = np.load(folder / "olat_noisefree_cam1.npz"), np.load(folder / "ground_truth_cam1.npz")
    levels = load(folder / "meta.yaml", what="truth").value["leds"]["weights"]
    drive = np.array([levels[name] for name in NAMES])
    diffuse, specular = (np.tensordot(drive, lights[k].astype(float), 1) for k in "DS")
    mask = truth["mask"]
    mono = np.where(mask, truth["albedo_mono"].astype(float), 1)
    albedo = np.where(mask, np.moveaxis(truth["albedo_bands"].astype(float), 2, 0), 0)
    count = len(BANDS)
    return Ideal(
        albedo[:, None] * np.where(mask, diffuse / mono, 0),
        np.broadcast_to(specular, (count, *specular.shape)),
        np.broadcast_to(mask, (count, *mask.shape)),
        albedo,
    )


@cache
def _rig_views(seed: int, times: tuple[float, ...]) -> Ideal:
    """The virtual rig's head, rendered in its pose of each time of the slow motion (0: at rest)."""
    shot = virtual_rig.Shot(seed=seed)
    rig = virtual_rig.Rig.made(shot)
    shape = head.parts(seed)
    field = head.coarse_field(shape)
    drive = np.stack([weights(name, rig.ideal) for name in NAMES])
    y, x = np.mgrid[0 : shot.height, 0 : shot.width].astype(float)
    grid = np.stack([x, y], axis=-1)
    poses = [motion.pose("slow", time) for time in times]
    fields = [head.bent_field(shape, field, pose.warp) for pose in poses]
    seen = {
        time: virtual_rig._render(shape, part, pose, rig, shot, grid, drive)
        for time, part, pose in zip(times, fields, poses, strict=True)
    }
    views = [seen[time] for time in times]
    albedo = np.stack([np.where(v.mask, v.albedo(b), 0) for v, b in zip(views, BANDS, strict=True)])
    flow = np.stack([np.moveaxis(virtual_rig._flow(views[REFERENCE], pose, rig, grid), 2, 0) for pose in poses])
    mask = np.stack([v.mask for v in views])
    for b, (pose, part) in enumerate(zip(poses, fields, strict=True)):
        at = grid + np.moveaxis(flow[b], 0, 2)
        mask[REFERENCE] &= virtual_rig._visible(shape, part, views[REFERENCE], pose, at) | (b == REFERENCE)
    return Ideal(
        np.stack([a * v.diffuse for a, v in zip(albedo, views, strict=True)]),
        np.stack([v.specular for v in views]),
        mask,
        albedo,
        flow,
    )


def virtual(seed: int, times: tuple[float, ...] = (0.0,) * len(BANDS)) -> Ideal:
    """The virtual rig's head: in each band at this moment of its slow motion, in seconds; 0 is at rest."""
    return _rig_views(seed, times)


def scene(ideal: Ideal, kind: Motion, *, seed: int = 0, specular: float = 1.0, noise: bool = True) -> BandScene:
    """A capture of `ideal`.

    Args:
        kind: still; plane: each band's pictures are moved by 0.5 to 4 px; turned: as rendered.
        seed: of motion and noise.
        specular: factor on the specular component; 0 leaves its noise alone.
        noise: whether there is any.
    """
    generator = np.random.default_rng([seed, 21])
    count, pictures, height, width = ideal.diffuse.shape
    rows, columns = np.mgrid[0:height, 0:width].astype(float)
    flow = np.zeros((count, 2, height, width)) if ideal.flow is None else ideal.flow
    diffuse, gloss = ideal.diffuse, specular * ideal.specular
    if kind == "plane":
        diffuse, gloss, flow = diffuse.copy(), gloss.copy(), np.zeros((count, 2, height, width))
        sizes = generator.permutation(np.linspace(0.5, 4.0, count - 1))
        others = [b for b in range(count) if b != REFERENCE]
        for b, size in zip(others, sizes, strict=True):
            back = partial(_moved, generator.uniform(0, 2 * np.pi, 6), float(size), (height, width))
            at = back(columns, rows)
            for part in (diffuse, gloss):
                for k in range(pictures):
                    source = ideal.diffuse[b, k] if part is diffuse else specular * ideal.specular[b, k]
                    part[b, k] = map_coordinates(source, [rows + at[1], columns + at[0]], order=5, mode="nearest")
            flow[b] = _inverse(back, columns, rows)
    radiance = np.empty((count, pictures, 2, height, width), np.float32)
    for b in range(count):
        exposure = 0.85 * (WHITE - OFFSET) / np.percentile(diffuse[b, 0] / 2 + gloss[b, 0], 99.5)
        for k in range(pictures):
            cross = np.maximum(exposure * diffuse[b, k] / 2, 0)
            parallel = cross + np.maximum(exposure * gloss[b, k], 0)
            if noise:
                cross, parallel = _exposed(cross, generator), _exposed(parallel, generator)
            radiance[b, k] = np.stack([2 * cross, parallel - cross]) / exposure
    inner = binary_erosion(ideal.mask[REFERENCE], iterations=MARGIN_PX)
    for f in flow:
        px, py = columns + f[0], rows + f[1]
        inner &= (np.minimum(px, py) > MARGIN_PX) & (px < width - 1 - MARGIN_PX) & (py < height - 1 - MARGIN_PX)
    border = np.minimum(np.minimum(rows, columns), np.minimum(height - 1 - rows, width - 1 - columns))
    return BandScene(radiance, flow, inner & (border >= MARGIN_PX), ideal.albedo)


def _moved(phase: Array, size: float, shape: tuple[int, int], x: Array, y: Array) -> Array:
    """(xy, y, x): a shift of `size` pixels, a turn and a bend that add up to a quarter of it, at most."""
    height, width = shape
    u, v = (x - width / 2) / width, (y - height / 2) / width
    turn = size / 4 * np.sin(phase[1])
    bend = size / 8
    return np.stack(
        [
            size * np.cos(phase[0]) - turn * v + bend * np.cos(2 * np.pi * (1.5 * v + u) + phase[2]),
            size * np.sin(phase[0]) + turn * u + bend * np.cos(2 * np.pi * (1.3 * u - 0.6 * v) + phase[3]),
        ]
    )


def _inverse(back: Any, x: Array, y: Array) -> Array:
    """g with z = x + g and z + back(z) = x, by fixed-point iteration to 1e-9 px."""
    g = -back(x, y)
    for _ in range(60):
        g = -back(x + g[0], y + g[1])
    return np.asarray(g)


def _exposed(counts: Array, generator: np.random.Generator) -> Array:
    """Counts of 10 bits with shot and read noise, dark taken off."""
    electrons = generator.poisson(counts * ELECTRONS_PER_COUNT)
    noisy = electrons + READ_NOISE_ELECTRONS * generator.standard_normal(counts.shape)
    return np.clip(np.round(OFFSET + noisy / ELECTRONS_PER_COUNT), 0, WHITE) - OFFSET

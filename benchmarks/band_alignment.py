"""Bands of a multispectral capture against the true flow: what they are aligned on, and what that does to spectra.

Heads whose bands were moved by known flows (`band_scenes.py`), seeds 2 and 3; what there is to set in
`kernels/motion/band_alignment.py` was set on seed 1. Rows of the rendered head need the shared data.
`python -m benchmarks.alignment --only bands` writes the table.
"""

import time
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import band_scenes
from benchmarks.band_scenes import BANDS, NAMES, REFERENCE, BandScene
from lightstage.kernels.motion.band_alignment import KINDS, Kind, Light, band_flow, gathered
from lightstage.kernels.motion.flow_warp import warp
from lightstage.kernels.motion.picture_flow import direct, plain
from tests.rendered import angle

Array = NDArray[Any]
SEEDS = (2, 3)
TURNED_S = (0.07, 0.03, 0.05, 0.0, 0.02, 0.09)
"""Moments of the slow motion: the skin moves by 0.5 to 2.5 px in the mean."""
_KINDS: dict[str, tuple[Kind, ...]] = {
    "specular": ("specular",),
    "relief": ("relief",),
    "gradient": ("gradient",),
    "auto": KINDS,
    "auto, no complements": KINDS,
}


def table() -> list[str]:
    """Six bands brought to one: endpoint error and spectra, by what they are aligned on."""
    lines = ["| scene | aligned on | endpoint error, px | worst band | 99 in 100 below | CPU s a band | "
             "spectral angle, degrees | at albedo edges |", "|---|---|---|---|---|---|---|---|"]  # fmt: skip
    for name, scenes in _scenes():
        errors = _ways(scenes)
        for way, (flows, seconds) in errors.items():
            off = [
                [
                    np.hypot(*(f - t))[s.inner]
                    for b, (f, t) in enumerate(zip(found, s.flow, strict=True))
                    if b != REFERENCE
                ]
                for s, found in zip(scenes, flows, strict=True)
            ]
            each = np.array([[band.mean() for band in one] for one in off]).mean(axis=0)
            tail = np.percentile(np.concatenate([band for one in off for band in one]), 99)
            spectral = np.mean([_spectral_angle(s, found) for s, found in zip(scenes, flows, strict=True)], axis=0)
            time_s = f"{seconds:.2f}" if seconds else ""
            lines.append(
                f"| {name} | {way} | {each.mean():.3f} | {each.max():.3f} | {tail:.2f} | {time_s} | "
                f"{spectral[0]:.2f} | {spectral[1]:.2f} |"
            )
            print(lines[-1], flush=True)
    return lines


def _scenes() -> Iterable[tuple[str, list[BandScene]]]:
    """Names and scenes, made one after the other."""
    still, turned = band_scenes.virtual(2), band_scenes.virtual(2, TURNED_S)
    for name, ideal in (("virtual rig", still), ("rendered head", band_scenes.head_a())):
        if ideal is None:
            print("no rows of the rendered head: the shared data are not here")
            continue
        yield f"{name}, still", [band_scenes.scene(ideal, "still", seed=s) for s in SEEDS]
        yield f"{name}, moved 0.5 to 4 px", [band_scenes.scene(ideal, "plane", seed=s) for s in SEEDS]
        for factor, called in ((0.2, "a fifth of the specular light"), (0.0, "no specular light")):
            yield (
                f"{name}, moved, {called}",
                [band_scenes.scene(ideal, "plane", seed=s, specular=factor) for s in SEEDS],
            )
    yield "virtual rig, turned and talking", [band_scenes.scene(turned, "turned", seed=s) for s in SEEDS]


def _ways(scenes: list[BandScene]) -> dict[str, tuple[list[Array], float]]:
    """Flows (band, xy, y, x) of each scene and CPU seconds a band, by way."""
    out: dict[str, tuple[list[Array], float]] = {"nothing": ([np.zeros_like(s.flow) for s in scenes], 0.0)}
    light = [[_light(s, b) for b in range(len(BANDS))] for s in scenes]
    ways: dict[str, Callable[[Light, Light], Array]] = {
        "diffuse as it is (DIS)": lambda a, b: plain(_level(a.diffuse), _level(b.diffuse), flow="dis"),
        "diffuse / local mean (DIS)": lambda a, b: direct(a.diffuse, b.diffuse),
        **{name: _on(kinds) for name, kinds in _KINDS.items() if name != "auto, no complements"},
    }
    for name, way in ways.items():
        began = time.process_time()
        flows = [np.stack([way(one[REFERENCE], other) for other in one]) for one in light]
        out[name] = flows, (time.process_time() - began) / len(scenes) / len(BANDS)
    few = [[_light(s, b, ("C", "X", "Y", "Z")) for b in range(len(BANDS))] for s in scenes]
    out["auto, no complements"] = [np.stack([_on(KINDS)(o[REFERENCE], b) for b in o]) for o in few], 0.0
    for flows, _ in out.values():
        for flow in flows:
            flow[REFERENCE] = 0
    out["the true flow"] = [s.flow for s in scenes], 0.0
    return out


def _light(s: BandScene, band: int, names: tuple[str, ...] = NAMES) -> Light:
    pictures = {name: s.radiance[band, NAMES.index(name)] for name in names}
    return gathered(pictures, ("diffuse", "specular"), still=True)


def _on(kinds: tuple[Kind, ...]) -> Callable[[Light, Light], Array]:
    return lambda here, there: band_flow(here, there, kinds=kinds).flow


def _level(picture: Array) -> Array:
    """With its bright end at 1: the fairest start for a flow that takes brightness for equal."""
    return np.asarray(picture / np.percentile(picture, 99), np.float32)


def _spectral_angle(s: BandScene, flows: Array) -> tuple[float, float]:
    """Degrees between the measured spectrum of constant light and the true albedo's; also where albedo has edges."""
    pairs = zip(s.radiance[:, 0, 0], flows, strict=True)
    measured = np.stack([p if not f.any() else warp(p, f.astype(np.float32)) for p, f in pairs])
    off = angle(_unit(measured), _unit(s.albedo))
    slope = sum(np.hypot(*np.gradient(np.log(np.maximum(a, 1e-3)))) for a in s.albedo)
    known = s.inner & np.isfinite(off)
    edge = known & (slope > np.percentile(slope[known], 95))
    return float(off[known].mean()), float(off[edge].mean())


def _unit(spectra: Array) -> Array:
    return np.asarray(spectra / np.maximum(np.linalg.norm(spectra, axis=0), 1e-9))

"""Albedo against truth: what is divided out, with bounced light and without; writes docs/methods/reflectance.md.

Runs the real command on `rendered/static_A` of the shared data (six bands, albedo of each known). All is judged inside the
truth mask eroded by two pixels, where the found surface reaches. The true shading is the sum of the noise-free
one-light pictures over the albedo that they were made with; correlation with it is Pearson's, in linear light.
"""

from typing import Any

import cv2
import numpy as np
import xarray
from numpy.typing import NDArray

from benchmarks.accuracy import DATA, DOCS, Bench, partial_correlation
from benchmarks.pages import write_tables

Array = NDArray[Any]
ROWS = {
    "constant light, as captured": ["reflectance.shading=none"],
    "smooth": ["reflectance.shading=smooth"],
    "geometry, bounced light left in": ["reflectance.bounced=kept"],
    "geometry, openness as modelled": ["relief.openness=modelled"],
    "geometry (the default)": [],
}


def albedos(bench: Bench) -> list[str]:
    """One row per way of dividing shading out."""
    folder = DATA / "rendered" / "static_A"
    session = bench.take_in(folder)
    truth = np.load(folder / "truth" / "ground_truth_cam1.npz")
    lights = np.load(folder / "truth" / "olat_noisefree_cam1.npz")
    inner = cv2.erode(truth["mask"].astype(np.uint8), np.ones((5, 5))) > 0
    shading = lights["D"].astype(float).sum(axis=0) / np.maximum(truth["albedo_mono"].astype(float), 1e-3)
    true = np.moveaxis(truth["albedo_bands"].astype(float), 2, 0)
    made = {}
    for name, settings in ROWS.items():
        words = [word for setting in settings for word in ("--set", setting)]
        path = bench.call("run", "reflectance", "--session", session, *words)["nodes"]["reflectance"]["path"]
        made[name] = xarray.open_zarr(path, chunks=None).load()
    # the same pixels for all rows
    judged = inner & np.all([np.isfinite(m.reflectance.values[0]).all(axis=0) for m in made.values()], axis=0)
    lines = [
        "| divided out | median of estimate / truth, 407 to 655 nm | RMS error | scale-free RMS error | correlation with shading | given the true albedo |",
        "|---|---|---|---|---|---|",
    ]
    for name, result in made.items():
        found = result.reflectance.values[0].astype(float)
        ratio = [np.median(found[b][judged] / true[b][judged]) for b in range(len(found))]
        rms = [np.sqrt(np.mean((found[b] - true[b])[judged] ** 2)) for b in range(len(found))]
        free = [_scale_free(found[b][judged], true[b][judged]) for b in range(len(found))]
        tied = [np.corrcoef(found[b][judged], shading[judged])[0, 1] for b in range(len(found))]
        partly = [
            partial_correlation(found[b][judged], shading[judged], true[b][judged]) for b in range(len(found))
        ]
        lines.append(
            f"| {name} | {' '.join(f'{r:.3f}' for r in ratio)} | {np.mean(rms):.4f} | {np.mean(free):.4f} "
            f"| {np.mean(tied):+.3f} | {np.mean(partly):+.3f} |"
        )
    tied = np.mean([np.corrcoef(true[b][judged], shading[judged])[0, 1] for b in range(len(true))])
    return [*lines, f"| the true albedo | 1 | 0 | 0 | {tied:+.3f} | 0 |"]


def bodies(bench: Bench) -> list[str]:
    """Openness where there is nothing to correct: convex bodies of one albedo."""
    lines = [
        "| body | openness | scale-free RMS error / albedo | 5 to 95 % of estimate / median |",
        "|---|---|---|---|",
    ]
    for name in ("static_sphere", "static_cylinder"):
        folder = DATA / "rendered" / name
        session = bench.take_in(folder)
        mask = np.load(folder / "truth" / "ground_truth_cam1.npz")["mask"].astype(np.uint8)
        inner = cv2.erode(mask, np.ones((5, 5))) > 0
        for openness in ("modelled", "measured"):
            words = ("--set", f"relief.openness={openness}")
            path = bench.call("run", "reflectance", "--session", session, *words)["nodes"]["reflectance"]["path"]
            found = xarray.open_zarr(path, chunks=None).reflectance.values[0, 0].astype(float)
            found = found[inner & np.isfinite(found)] / np.nanmedian(found[inner])
            low, high = np.percentile(found, [5, 95])
            error = _scale_free(found, np.ones_like(found))
            lines.append(f"| {name.removeprefix('static_')} | {openness} | {error:.4f} | {low:.3f} to {high:.3f} |")
    return lines


def errors(bench: Bench) -> list[str]:
    """The stated standard error against the scatter of what noise alone does: finest detail of estimate over truth."""
    folder = DATA / "rendered" / "static_A"
    session = bench.take_in(folder)
    truth = np.load(folder / "truth" / "ground_truth_cam1.npz")
    path = bench.call("run", "reflectance", "--session", session)["nodes"]["reflectance"]["path"]
    result = xarray.open_zarr(path, chunks=None).load()
    laplacian = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], float) / 6  # unit gain for white noise
    lines = ["| band, nm | standard error, median | scatter / stated |", "|---|---|---|"]
    for b, band in enumerate(result.band.values):
        found, stated = (
            result.reflectance.values[0, b].astype(float),
            result.standard_error.values[0, b].astype(float),
        )
        true = truth["albedo_bands"][..., b].astype(float)
        quotient = np.where(np.isfinite(found) & (true > 0.01), found / np.maximum(true, 0.01), np.nan)
        rough = cv2.filter2D(quotient, -1, laplacian) * true / stated
        known = np.isfinite(rough) & (cv2.erode(truth["mask"].astype(np.uint8), np.ones((9, 9))) > 0)
        scatter = 1.4826 * np.median(np.abs(rough[known]))
        lines.append(f"| {band:g} | {np.nanmedian(stated[known]):.4f} | {scatter:.2f} |")
    return lines


def _scale_free(found: Array, true: Array) -> float:
    gain = (found * true).sum() / (found**2).sum()
    return float(np.sqrt(np.mean((gain * found - true) ** 2)))


if __name__ == "__main__":
    works = {"albedos": albedos, "bodies": bodies, "errors": errors}
    write_tables(__doc__, DOCS / "methods" / "reflectance.md", works)

"""A head relit under each of the rig's lights against its renderer's pictures; writes docs/methods/relighting.md.

Runs the real command for the surface and its gloss, and the kernel under one light at a time. The albedo is the true
mono one, because the one-light pictures are unfiltered and the capture is in six bands.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import xarray
from numpy.typing import NDArray
from skimage.metrics import structural_similarity

from benchmarks.accuracy import DOCS, Bench
from benchmarks.near_light import Subject
from stages.relighting import Lamps, Surface, relight

Array = NDArray[Any]
AXIS_DEG = 75.0
"""A light farther from the camera's axis is grazing."""


class Head:
    """The found surface and the renderer's pictures."""

    def __init__(self, bench: Bench) -> None:
        self.subject = Subject(bench, "static_A")
        paths = bench.call("run", "relief", "gloss", "--session", self.subject.session)["nodes"]
        relief, gloss = (xarray.open_zarr(paths[name]["path"], chunks=None) for name in ("relief", "gloss"))
        truth = self.subject.folder / "truth"
        albedo = np.load(truth / "ground_truth_cam1.npz")["albedo_mono"].astype(float)
        pictures = np.load(truth / "olat_noisefree_cam1.npz")
        self.diffuse, self.specular = (pictures[name].astype(float) for name in "DS")
        self.visibility = relief.visibility.values[0]
        self.surface = Surface(
            np.moveaxis(relief.normal.values[0, 0], 0, 2).astype(float),
            relief.depth_mm.values[0].astype(float),
            albedo[..., None],
            gloss.specular.values[0].astype(float),
            gloss.roughness.values[0].astype(float),
            float(gloss.attrs["index"]),
        )
        self.mask = self.subject.inner & np.isfinite(self.surface.depth_mm)
        places = self.subject.lights.position
        self.angles = np.degrees(np.arccos(places[:, 2] / np.linalg.norm(places, axis=1)))
        self.front = np.flatnonzero(self.angles < AXIS_DEG)

    def relit(self, surface: Surface, **options: Any) -> tuple[Array, Array]:
        """Diffuse and specular pictures (light, y, x) under each light in front."""
        lights = self.subject.lights
        made = [
            relight(
                surface,
                self.subject.camera,
                Lamps(lights.position[[k]], lights.power[[k], None], np.array([lights.distance])),
                **options,
            )
            for k in self.front
        ]
        return np.stack([m.diffuse[..., 0] for m in made]), np.stack([m.specular[..., 0] for m in made])

    def compared(self, made: Array, truth: Array) -> list[tuple[float, float]]:
        """PSNR (dB) and SSIM of each light in front."""
        return [compare(picture, truth[k], self.mask) for picture, k in zip(made, self.front, strict=True)]


def compare(picture: Array, truth: Array, mask: Array) -> tuple[float, float]:
    """PSNR (dB) and SSIM inside a mask; the peak is the 99.9th percentile of the truth there."""
    peak = float(np.percentile(truth[mask], 99.9))
    made, true = np.where(mask, np.nan_to_num(picture), 0.0), np.where(mask, truth, 0.0)
    error = float(((made - true)[mask] ** 2).mean())
    options = {"data_range": peak, "gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    _, local = structural_similarity(made, true, full=True, **options)
    return float(10 * np.log10(peak**2 / error)), float(local[mask].mean())


def table(head: Head) -> list[str]:
    """Ways to relight, and every light in the best of them."""
    ways: list[tuple[str, dict[str, Any]]] = [
        ("no cast shadows", {"bounces": 0, "shadows": False}),
        ("sharp shadows", {"bounces": 0, "edge_px": 0.0}),
        ("shadows averaged over 1.5 px", {"bounces": 0}),
        ("and light bounced once (the default)", {}),
    ]
    lines = [
        "| | diffuse: PSNR mean, least | over 30 dB | SSIM | diffuse + specular: PSNR mean, least | over 30 dB | SSIM |",
        "|---|---|---|---|---|---|---|",
    ]
    plain, _ = head.relit(head.surface, bounces=0, shadows=False)
    lines.append(
        _row("visibility of `relief`", head.compared(plain * head.visibility[head.front], head.diffuse), None)
    )
    for label, options in ways:
        diffuse, specular = head.relit(head.surface, **options)
        of_diffuse = head.compared(diffuse, head.diffuse)
        of_both = head.compared(diffuse + specular, head.diffuse + head.specular)
        lines.append(_row(label, of_diffuse, of_both))
    subject = head.subject
    true = head.surface._replace(
        normal=np.moveaxis(subject.truth, 0, 2), depth_mm=np.where(subject.whole, subject.depth, np.nan)
    )
    lines.append(
        _row("true surface, sharp shadows", head.compared(head.relit(true, edge_px=0.0)[0], head.diffuse), None)
    )
    lines += [
        "",
        "| light | degrees from the axis | diffuse PSNR, SSIM | diffuse + specular PSNR, SSIM |",
        "|---|---|---|---|",
    ]
    for k, (p, s), (q, t) in zip(head.front, of_diffuse, of_both, strict=True):
        lines.append(f"| L{k:02d} | {head.angles[k]:.0f} | {p:.1f}, {s:.3f} | {q:.1f}, {t:.3f} |")
    return lines


def _row(label: str, diffuse: list[tuple[float, float]], both: list[tuple[float, float]] | None) -> str:
    def cells(values: list[tuple[float, float]]) -> str:
        psnr, ssim = np.array(values).T
        return f"{psnr.mean():.2f}, {psnr.min():.2f} | {(psnr > 30).sum()} of {len(psnr)} | {ssim.mean():.3f}"

    return f"| {label} | {cells(diffuse)} | {'- | - | -' if both is None else cells(both)} |"


def main() -> None:
    """Measure, and write the page's table."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    cv2.setNumThreads(1)
    page = DOCS / "methods" / "relighting.md"
    text = page.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        lines = table(Head(Bench(Path(folder) / "store")))
    first, last = "<!-- relighting -->\n", "<!-- end of relighting -->"
    before, _, rest = text.partition(first)
    page.write_text(
        before + first + "\n" + "\n".join(lines) + "\n\n" + last + rest.partition(last)[2], encoding="utf-8"
    )


if __name__ == "__main__":
    main()

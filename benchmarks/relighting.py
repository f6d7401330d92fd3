"""A head relit under each of the rig's lights against its renderer's pictures; writes docs/methods/relighting.md.

Runs the real command for the surface and its gloss, and the kernel under one light at a time. The albedo is the true
mono one, because the one-light pictures are unfiltered and the capture is in six bands. The figure is of the virtual rig,
made with the real command alone: `--figure` draws nothing else, and needs no other data.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import numpy as np
import OpenImageIO
import xarray
from numpy.typing import NDArray

from benchmarks.accuracy import DATA, DOCS, Bench
from benchmarks.near_light import Subject
from benchmarks.pages import put
from lightstage.hw.virtual_rig import Shot, radiance
from lightstage.kernels.appearance.colour import encode_srgb, linear_srgb_matrix
from lightstage.kernels.appearance.relighting import Fidelity, Lamps, Surface, compare, relight
from tests.rendered import truth_of

matplotlib.use("Agg")
import matplotlib.pyplot as plt

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

    def compared(self, made: Array, truth: Array) -> list[Fidelity]:
        """PSNR (dB) and SSIM of each light in front."""
        return [compare(picture, truth[k], self.mask) for picture, k in zip(made, self.front, strict=True)]


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


CAPTURES = {"static_sphere": "sphere, 1 band", "static_cylinder": "cylinder, 1 band", "static_A": "head, 6 bands"}
ROUGHNESS, AT_NORMAL_INCIDENCE = 0.25, (0.4 / 2.4) ** 2
"""Of the renderer's coating."""


def gloss_table(bench: Bench) -> list[str]:
    """Roughness and intensity against truth, and their stated errors."""
    lines = [
        "| capture | roughness: median, 5 to 95 % | stated error (median) | rms error | over stated | specular: median, 5 to 95 % "
        "| stated error (median) | rms error | over stated |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, label in CAPTURES.items():
        folder = DATA / "rendered" / name
        path = bench.call("run", "gloss", "--session", bench.take_in(folder))["nodes"]["gloss"]["path"]
        found = xarray.open_zarr(path, chunks=None).isel(tracking=0)
        _, inner = truth_of(folder)
        cells = [label]
        for array, true, digits in (("roughness", ROUGHNESS, 3), ("specular", AT_NORMAL_INCIDENCE, 4)):
            values, stated = (found[part].values[inner].astype(float) for part in (array, f"{array}_error"))
            known = np.isfinite(values)
            values, stated = values[known], stated[known]
            off = values - true
            low, high = np.percentile(values, [5, 95])
            over = off / stated
            cells += [
                f"{np.median(values):.{digits}f}, {low:.{digits}f} to {high:.{digits}f}",
                f"{np.median(stated):.{digits}f}",
                f"{np.sqrt((off**2).mean()):.{digits}f}",
                f"{np.sqrt((over**2).mean()):.2f}, {1.4826 * np.median(np.abs(over)):.2f}",
            ]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _row(label: str, diffuse: list[Fidelity], both: list[Fidelity] | None) -> str:
    def cells(values: list[Fidelity]) -> str:
        psnr, ssim = np.array(values).T
        return f"{psnr.mean():.2f}, {psnr.min():.2f} | {(psnr > 30).sum()} of {len(psnr)} | {ssim.mean():.3f}"

    return f"| {label} | {cells(diffuse)} | {'- | - | -' if both is None else cells(both)} |"


SHOT = Shot()
"""The virtual rig's demo."""
WIDTHS_NM = (17, 17, 20, 16, 10, 15)
SHOWN = ("L16", "L06", "L17")
"""18, 46 and 54 degrees from the camera's axis."""


def sky(rows: int = 64) -> Array:
    """(y, x, rgb): a blue sky over brown ground, with a blurred sun of 10 degrees, up and to the right, behind the camera."""
    latitude = np.pi * (0.5 - (np.arange(rows)[:, None] + 0.5) / rows)
    longitude = np.pi * (1 - 2 * (np.arange(2 * rows)[None, :] + 0.5) / (2 * rows))
    x, z = (np.cos(latitude) * f(longitude) for f in (np.sin, np.cos))
    y = np.broadcast_to(np.sin(latitude), x.shape)
    sun = np.array([0.6, 0.5, 0.62]) / np.linalg.norm([0.6, 0.5, 0.62])
    towards = x * sun[0] + y * sun[1] + z * sun[2]
    above = np.array([0.25, 0.45, 0.9]) * (1 - 0.6 * np.clip(y, 0, 1))[..., None]
    made = np.where((y > 0)[..., None], above, np.array([0.18, 0.14, 0.1]))
    return np.asarray(made + np.exp((towards - 1) / 0.004)[..., None] * np.array([60.0, 52.0, 40.0]))


def figure(bench: Bench, folder: Path) -> None:
    """The virtual rig's head under the sky, and under three lights beside what the rig renders."""
    session = bench.call("demo")["session"]
    values = sky().astype(np.float32)
    target = OpenImageIO.ImageOutput.create("sky.hdr")
    target.open(str(folder / "sky.hdr"), OpenImageIO.ImageSpec(values.shape[1], values.shape[0], 3, "float"))
    target.write_image(values)
    target.close()
    words = ("relight", session, "--environment", folder / "sky.hdr")
    bench.call(*words, *(word for led in SHOWN for word in ("--led", led)), "--to", folder / "ahead")
    bench.call(*words, "--rotate", "180", "--to", folder / "behind")
    panels, axes = plt.subplots(3, 4, figsize=(14, 8.6), layout="constrained")
    axes[0, 0].imshow(encode_srgb(0.8 * values))
    axes[0, 0].set_title("an environment map")
    for axis, name, title in zip(
        axes[1:, 0], ("ahead", "behind"), ("relit under it", "turned by 180 degrees"), strict=True
    ):
        picture, alpha = _picture(folder / name / "environment.exr")
        axis.imshow(encode_srgb(_on_grey(1.2 * picture, alpha)))
        axis.set_title(title)
    diffuse, specular = radiance(SHOT, SHOWN)
    matrix = linear_srgb_matrix(SHOT.bands_nm, WIDTHS_NM)
    for column, led in enumerate(SHOWN):
        picture, alpha = _picture(folder / "ahead" / f"{led}.exr")
        true = np.moveaxis(np.tensordot(matrix, diffuse[column] + specular[column], 1), 0, 2)
        inside = cv2.erode(alpha.astype(np.uint8), np.ones((3, 3))) > 0
        green = picture[..., 1], true[..., 1]
        psnr, ssim = compare(*green, inside)
        shown = 0.6
        axes[0, column + 1].imshow(encode_srgb(_on_grey(shown * picture, alpha)))
        axes[0, column + 1].set_title(f"{led}, relit: PSNR {psnr:.1f} dB, SSIM {ssim:.3f}")
        axes[1, column + 1].imshow(encode_srgb(_on_grey(shown * true, alpha)))
        axes[1, column + 1].set_title("rendered by the rig")
        top = 0.3
        off = np.where(inside, green[0] - green[1], np.nan)
        drawn = axes[2, column + 1].imshow(off, cmap="RdBu_r", vmin=-top, vmax=top)
        axes[2, column + 1].set_title("relit - rendered, green")
    panels.colorbar(drawn, ax=axes[2, 3], shrink=0.8)
    for axis in axes.ravel():
        axis.set_axis_off()
    path = DOCS / "figures" / "relighting.png"
    panels.savefig(path, dpi=80)
    plt.close(panels)


def _picture(file: Path) -> tuple[Array, Array]:
    """(y, x, rgb) and (y, x) alpha of an EXR file."""
    source = OpenImageIO.ImageInput.open(str(file))
    pixels = source.read_image("float")[..., [list(source.spec().channelnames).index(c) for c in "RGBA"]]
    source.close()
    return pixels[..., :3], pixels[..., 3] == 1


def _on_grey(picture: Array, alpha: Array) -> Array:
    return np.where(alpha[..., None], picture, 0.01)


def main() -> None:
    """Measure, and write the page's table and figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--figure", action="store_true", help="only the figure")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        figure(Bench(Path(folder) / "store"), Path(folder))
    if options.figure:
        return
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder) / "store")
        page = DOCS / "methods" / "relighting.md"
        put(page, "gloss", gloss_table(bench))
        put(page, "relighting", table(Head(bench)))


if __name__ == "__main__":
    main()

"""Height maps against truth, and meshes of them: depth, breaks, files, a picture; writes docs/methods/shape.md.

Runs the real command on `rendered/static_sphere` and `static_A` of the shared data and on the virtual rig's head. A depth
error is the mean absolute one within the truth mask, where the height map reaches, with the mean removed; as a part of the
sphere's radius, or of the head's range of depths.
"""

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import numpy as np
import trimesh
import xarray
from numpy.typing import NDArray

from benchmarks.accuracy import DATA, DOCS, Bench
from benchmarks.pages import put
from lightstage.kernels.encodings import EDGE_BELOW, EDGE_RIGHT
from lightstage.kernels.surface.integration import integrate
from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.kernels.surface.shape import breaks
from lightstage.store.document import load

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.collections import PolyCollection

Array = NDArray[Any]
ROWS = {
    "found with the normals, `full` (the default)": "full",
    "found with the normals, `near+shadows`": "near+shadows",
    "found with the normals, `near`": "near",
    "integrated, `lights`": "lights",
    "integrated, `none`": "none",
}
"""Label -> `correct` of the node that shape reads."""
_LIGHT = np.array([-0.45, 0.35, 0.82])


@dataclass(frozen=True)
class Subject:
    """A capture with truth."""

    session: str
    depth_mm: Array
    mask: Array
    camera: Pinhole

    @classmethod
    def of(cls, bench: Bench, name: str) -> "Subject":
        """From the shared data."""
        folder = DATA / "rendered" / name
        truth = np.load(folder / "truth" / "ground_truth_cam1.npz")
        return cls(bench.take_in(folder), truth["depth_mm"].astype(float), truth["mask"], camera_of(folder))

    def off(self, depth: Array) -> Array:
        """Estimate less truth, mm, of the points that have both."""
        return (depth - self.depth_mm)[np.isfinite(depth) & self.mask]


def depths(bench: Bench) -> list[str]:
    """One row per way to a height map."""
    ball, head = Subject.of(bench, "static_sphere"), Subject.of(bench, "static_A")
    radius = float(np.median(np.linalg.norm(ball.camera.points(ball.depth_mm)[ball.mask], axis=1)))
    whole = float(np.ptp(head.depth_mm[head.mask]))
    lines = [
        "| depth | sphere, of its radius | head, of its range | head, 95th percentile, mm | head, distance, mm | head, covered |",
        "|---|---|---|---|---|---|",
    ]

    def row(label: str, on_ball: Array, on_head: Array) -> None:
        one, two = ball.off(on_ball), head.off(on_head)
        error = np.abs(two - two.mean())
        lines.append(
            f"| {label} | {np.abs(one - one.mean()).mean() / radius:.2%} | {error.mean() / whole:.2%} "
            f"| {np.percentile(error, 95):.1f} | {np.median(two):+.1f} | {two.size / head.mask.sum():.1%} |"
        )

    for label, correct in ROWS.items():
        found = []
        for subject in (ball, head):
            words = ("--set", f"relief.correct={correct}", "--set", "relief.fuse=bands")
            made = bench.call("run", "shape", "--session", subject.session, *words)["nodes"]
            found.append(xarray.open_zarr(made["shape"]["path"], chunks=None).depth_mm.values[0].astype(float))
        row(label, *found)
        if correct == "full":
            for rounds in (1, 6, 12, 25):
                again = [integrated_again(bench, subject, rounds) for subject in (ball, head)]
                row(f"the normals of `full` integrated again, {rounds} round(s)", *again)
    return lines


def integrated_again(bench: Bench, subject: Subject, rounds: int) -> Array:
    """Depth from the normals in use, beginning from the depth that was found with them."""
    path = bench.call("path", "relief", "--session", subject.session)["path"]
    relief = xarray.open_zarr(path, chunks=None)
    depth, normal = relief.depth_mm.values[0].astype(float), np.moveaxis(relief.normal.values[0, 0], 0, 2)
    mask = np.isfinite(depth) & np.isfinite(normal).all(axis=2)
    in_camera = np.nan_to_num(normal).astype(float) @ subject.camera.rotation.T
    start = np.where(mask, np.log(np.where(mask, depth, 1.0)), np.nan)
    log_depth = integrate(in_camera, mask, subject.camera.rays, start=start, rounds=rounds)
    return np.asarray(np.exp(log_depth + np.nanmedian(start - log_depth)))


def camera_of(folder: Path) -> Pinhole:
    """The camera of a capture folder."""
    item = load(folder / "calibration" / "camera.yaml", what="an item").value
    return Pinhole.of(item, (item["size_px"][1], item["size_px"][0]))


def broken(bench: Bench) -> list[str]:
    """`edge` against the breaks of the truth, by pixels on either side of one."""
    folder = DATA / "rendered" / "static_A"
    session, camera = bench.take_in(folder), camera_of(folder)
    path = bench.call("run", "shape", "--session", session)["nodes"]["shape"]["path"]
    shape = xarray.open_zarr(path, chunks=None)
    depth = shape.depth_mm.values[0]
    stored = np.load(folder / "truth" / "ground_truth_cam1.npz")
    known = stored["mask"] & np.isfinite(depth)
    normal = stored["normal"].astype(float)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True) + 1e-30
    true = beside(breaks(np.where(known, stored["depth_mm"], np.nan), normal @ camera.rotation.T, camera)) & known
    ways = {
        "`edge`": shape["edge"].values[0],
        "steeper than 83 degrees alone": breaks(depth, np.zeros((*depth.shape, 3)), camera),
    }
    lines = ["| | pixels | true within 1 px | within 2 px | of the true found within 1 px | within 2 px |"]
    lines += ["|---|---|---|---|---|---|"]
    for label, edge in ways.items():
        found = beside(edge) & known
        right = [(found & near(true, px)).sum() / found.sum() for px in (1, 2)]
        caught = [(true & near(found, px)).sum() / true.sum() for px in (1, 2)]
        lines.append(f"| {label} | {found.sum()} | " + " | ".join(f"{v:.0%}" for v in right + caught) + " |")
    return [*lines, f"| the truth, by the same rule | {true.sum()} | | | | |"]


def beside(edge: Array) -> Array:
    """(y, x): pixels on either side of a break."""
    out = edge > 0
    out[:, 1:] |= (edge[:, :-1] & EDGE_RIGHT) > 0
    out[1:] |= (edge[:-1] & EDGE_BELOW) > 0
    return out


def near(mask: Array, px: int) -> Array:
    """A mask with all that is within `px` pixels, diagonals in."""
    return cv2.dilate(mask.astype(np.uint8), np.ones((2 * px + 1, 2 * px + 1), np.uint8)) > 0


def files(bench: Bench) -> list[str]:
    """Every format: size, seconds, triangles, and what trimesh reads back."""
    session = bench.take_in(DATA / "rendered" / "static_A")
    bench.call("run", "shape", "reflectance", "--session", session)
    lines = [
        "| format | options | vertices | triangles | MB | seconds | size read back, mm |",
        "|---|---|---|---|---|---|---|",
    ]
    for form in ("ply", "obj", "glb"):
        for every in (1, 4):
            folder = bench.store.parent / f"{form}{every}"
            began = time.perf_counter()
            answer = bench.call(
                "export", "shape", "--session", session, "--to", folder, "--format", form, "--every", str(every)
            )
            seconds = time.perf_counter() - began
            mesh = trimesh.load_mesh(next(f for f in answer["files"] if f.endswith(form)), process=False)
            size = mesh.extents * (1000 if form == "glb" else 1)
            mega = sum(Path(f).stat().st_size for f in answer["files"]) / 1e6
            lines.append(
                f"| {form} | `--every {every}` | {len(mesh.vertices)} | {len(mesh.faces)} | {mega:.2f} "
                f"| {seconds:.1f} | {' x '.join(f'{s:.1f}' for s in size)} |"
            )
    return lines


def picture(bench: Bench, path: Path) -> None:
    """The virtual rig's head as a mesh, read back from its GLB, from three sides."""
    bench.call("demo", "--session", "head")
    bench.call("run", "shape", "reflectance", "--session", "head")
    folder = bench.store.parent / "picture"
    (file,) = bench.call("export", "shape", "--session", "head", "--to", folder, "--format", "glb")["files"]
    mesh = trimesh.load_mesh(file, process=False)
    figure, axes = plt.subplots(1, 3, figsize=(10, 4), layout="constrained")
    for axis, turn in zip(axes, (-55, 0, 55), strict=True):
        draw(axis, mesh.vertices * 1000, mesh.faces, turn)
        axis.set_title(f"from {abs(turn)}° {'left' if turn < 0 else 'right'}" if turn else "from the camera")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def draw(axis: Any, vertices: Array, faces: Array, turn_deg: float) -> None:
    """Triangles, flat shaded, the farthest first, seen from `turn_deg` to the right; backs are red."""
    a = np.radians(-turn_deg)
    turned = vertices @ np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]).T
    corners = turned[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    shade = 0.12 + 0.85 * np.maximum(normal @ _LIGHT, 0)
    colour = np.repeat(shade[:, None], 3, axis=1)
    colour[normal[:, 2] < 0] = (0.7, 0.1, 0.1)
    order = np.argsort(corners[:, :, 2].mean(axis=1), kind="stable")
    flat = corners[order][..., :2]
    axis.add_collection(PolyCollection(flat, facecolors=colour[order], edgecolors=colour[order], linewidths=0.2))
    axis.set_aspect("equal")
    axis.autoscale_view()
    axis.set_axis_off()


def main() -> None:
    """Measure everything, write the page and its figure."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder) / "store")
        tables = {"depth": depths(bench), "breaks": broken(bench), "files": files(bench)}
        picture(bench, DOCS / "figures" / "shape_head.png")
    for name, lines in tables.items():
        put(DOCS / "methods" / "shape.md", name, lines)


if __name__ == "__main__":
    main()

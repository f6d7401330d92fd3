"""Performances against truth: every engine on the rendered moving heads, upsampling, and growth with frames; writes its
tables into docs/methods/alignment.md.

Flow errors and normals are judged where the subject is, hidden points left out; confidence is judged on all pictures
of all sets. Normals are those of the plain method that the sequence supports, no light model, so most of their error
is the method's own: what counts is the difference from the row with the true flow. Needs ../shared/data.
"""

import argparse
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import xarray
import yaml
from numpy.typing import NDArray

from benchmarks.accuracy import DOCS
from benchmarks.pages import put
from benchmarks.pipeline import ROOT, command, timed
from lightstage.kernels.motion.flow_warp import warp
from lightstage.kernels.normals import quantised, spherical_gradients
from lightstage.kernels.normals.gradient_methods import table
from lightstage.kernels.pictures.picture_sets import choose
from tests.rendered import angle

Array = NDArray[Any]
DATA = ROOT.parent / "shared" / "data" / "rendered"
HEADS = ("dynamic_A_slow_wilson", "dynamic_A_slow_minimal", "dynamic_A_fast_minimal")
ENGINES = {
    "as captured": ["align.engine=none"],
    "direct": ["align.engine=direct"],
    "alternating (DIS), half": ["align.engine=alternating", "align.middle=half"],
    "alternating (DIS), refine": ["align.engine=alternating"],
    "joint, half": ["align.engine=joint", "align.middle=half"],
    "joint, refine": ["align.engine=joint"],
    "motion": [],
}
BETWEEN = {
    "nearness, proper inverse, cubic": [],
    "equal weights": ["upsample.weights=equal"],
    "the thesis' printed weights": ["upsample.weights=printed"],
    "W(n, -f)": ["upsample.inverse=negated"],
    "linear": ["upsample.interpolation=linear"],
    "spline": ["upsample.interpolation=spline"],
}


class Truth:
    """What is known of one rendered performance."""

    def __init__(self, name: str) -> None:
        self.folder = DATA / name / "truth"

    def surface(self, frame: int) -> tuple[Array, Array]:
        """Unit normals (xyz, y, x) and the mask."""
        stored = np.load(self.folder / f"gt_t{frame:02d}.npz")
        normal = np.moveaxis(stored["normal"].astype(float), 2, 0)
        return normal / np.maximum(np.linalg.norm(normal, axis=0), 1e-6), stored["mask"]

    def flow(self, tracking: int, frame: int) -> tuple[Array, Array] | None:
        """Flow (xy, y, x) from a tracking frame to another frame, and where the point is seen there."""
        stored = np.load(self.folder / f"flow_t{tracking:02d}.npz")
        ends = [(f"flow_to_t{frame:02d}", f"visible_t{frame:02d}")]
        for end in ("prevC", "nextC"):
            if f"t_{end}" in stored and int(stored[f"t_{end}"]) == frame:
                ends.append((f"flow_to_{end}", f"visible_{end}"))
        for flow, seen in ends:
            if flow in stored:
                return np.moveaxis(stored[flow].astype(np.float32), 2, 0), stored[seen]
        return None


class Bench:
    """A store with the heads imported."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.sessions = {}
        for name in HEADS:
            _, _, out = timed(command(root, "import", DATA / name, "--json"))
            self.sessions[name] = json.loads(out)["session"]

    def run(self, name: str, settings: list[str], *nodes: str) -> tuple[dict[str, xarray.Dataset], float]:
        """Results by node, and the seconds of align."""
        overrides = [word for setting in settings for word in ("--set", setting)]
        words = command(self.root, "run", *nodes, "--session", self.sessions[name], "--json", *overrides)
        _, _, out = timed(words)
        found = json.loads(out)["nodes"]
        opened = {n: xarray.open_zarr(v["path"], chunks=None) for n, v in found.items() if v["path"]}
        return opened, found["align"]["seconds"]


def _error(normal: Array, truth: Array, mask: Array) -> Array:
    found = angle(normal.astype(float), truth)
    return found[mask & np.isfinite(found)]


def _means(errors: list[Array]) -> str:
    whole = np.concatenate(errors)
    return f"{whole.mean():.2f} / {np.median(whole):.2f}"


def heads(bench: Bench) -> list[str]:
    """Every engine, by the command."""
    lines = [
        "| capture | engine | flow error, px | over 1 px | of these confidence < 0.5 | flagged in all | normals, "
        "mean / median | align, s a tracking frame |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name in HEADS:
        truth = Truth(name)
        bench.run(name, [], "normals")  # numba compiles outside the clock
        for engine, settings in ENGINES.items():
            fresh = bench.root.parent / "fresh"
            shutil.rmtree(fresh, ignore_errors=True)
            shutil.copytree(bench.root, fresh, symlinks=True)
            other = Bench.__new__(Bench)
            other.root, other.sessions = fresh, bench.sessions
            # another set of parameters, so that a reused block does not hide the time
            results, seconds = other.run(name, [*settings, "align.iterations=6"], "normals")
            lines.append(_row(name, engine, truth, results, seconds))
        lines.append(_with_true_flow(name, truth, results))
    return lines


def _row(name: str, engine: str, truth: Truth, results: dict[str, xarray.Dataset], seconds: float) -> str:
    aligned, normals = results["align"], results["normals"]
    far, sure, errors = [], [], []
    for k, tracking in enumerate(aligned.tracking.values.tolist()):
        surface, mask = truth.surface(tracking)
        errors.append(_error(normals.normal.values[k, 0], surface, mask))
        for m, frame in enumerate(aligned.frame.values[k].tolist()):
            known = None if frame in (-1, tracking) else truth.flow(tracking, frame)
            if known is None:
                continue
            away = np.hypot(*(aligned.flow.values[k, m] - known[0]))
            here = mask & known[1] & np.isfinite(away)
            far.append(away[here])
            sure.append(aligned.confidence.values[k, m][here])
    distance, confidence = np.concatenate(far), np.concatenate(sure)
    wrong = distance > 1
    caught = f"{(confidence[wrong] < 0.5).mean():.0%}" if wrong.any() else "-"
    count = aligned.sizes["tracking"]
    time = "" if engine == "as captured" else f"{seconds / count:.2f}"
    return (
        f"| {name} | {engine} | {distance.mean():.3f} | {wrong.mean():.2%} | {caught} | "
        f"{(confidence < 0.5).mean():.0%} | {_means(errors)} | {time} |"
    )


def _with_true_flow(name: str, truth: Truth, results: dict[str, xarray.Dataset]) -> str:
    """The same method on pictures brought by the true flow, with our interpolation."""
    aligned, radiance = results["align"], results["stack"].radiance.values[:, 0, 0]
    errors = []
    for k, tracking in enumerate(aligned.tracking.values.tolist()):
        surface, mask = truth.surface(tracking)
        names = aligned.illumination.values[k].tolist()
        moved = {}
        for m, frame in enumerate(aligned.frame.values[k].tolist()):
            known = None if frame in (-1, tracking) else truth.flow(tracking, frame)
            if known is not None and names[m] != "C":
                moved[names[m]] = warp(radiance[frame], known[0])
        moved["C"] = radiance[tracking]
        choice = choose(list(moved))
        method = table(choice.method, choice.base, list(moved), qp=False)
        solved = spherical_gradients.solve([moved[p] for p in method.pictures], method, view=None).normal
        errors.append(_error(quantised.decode(solved), surface, mask))
    return f"| {name} | the true flow | 0 | 0 | - | - | {_means(errors)} | |"


def between(bench: Bench) -> list[str]:
    """Normals at pictures between tracking frames."""
    lines = [
        "| capture | upsampling | mean error at gradient frames, degrees | more than the nearest tracking frames' own, "
        "worst frame |",
        "|---|---|---|---|",
    ]
    for name in HEADS:
        truth = Truth(name)
        for label, settings in BETWEEN.items():
            results, _ = bench.run(name, settings)
            normals, whole = results["normals"], results["upsample"]
            tracking = normals.tracking.values
            own = [
                _error(normals.normal.values[k, 0], *truth.surface(int(t))).mean() for k, t in enumerate(tracking)
            ]
            errors, excess = [], []
            for k, frame in enumerate(whole.frame.values.tolist()):
                if str(whole.illumination.values[k]) == "C":
                    continue
                errors.append(_error(whole.normal.values[k], *truth.surface(frame)))
                away = np.abs(tracking - frame)
                excess.append(errors[-1].mean() - np.mean([own[i] for i in np.argsort(away)[:2]]))
            lines.append(f"| {name} | {label} | {np.concatenate(errors).mean():.2f} | {max(excess):+.2f} |")
    return lines


def growth(work: Path) -> list[str]:
    """Time and peak memory of whole runs against the number of frames."""
    lines = ["| frames, 406 x 309 | run, s | ms a frame | peak memory, MB |", "|---|---|---|---|"]
    for frames in (30, 120, 480):
        folder = _long(work / f"long{frames}", frames)
        store = work / f"store{frames}"
        timed(command(store, "import", folder))
        wall, memory, _ = timed(command(store, "run", "--session", folder.name))
        lines.append(f"| {frames} | {wall:.1f} | {1000 * wall / frames:.0f} | {memory:.0f} |")
        shutil.rmtree(store)
        shutil.rmtree(folder)
    return lines


def _long(folder: Path, frames: int) -> Path:
    """The slow head's first nine pictures again and again, each with noise of its own, so that nothing is reused."""
    source = DATA / "dynamic_A_slow_minimal"
    folder.mkdir()
    shutil.copytree(source / "calibration", folder / "calibration")
    told = yaml.safe_load((source / "capture.yaml").read_text())
    lights = [told["frames"][i % 9]["illumination"] for i in range(frames)]
    told["session"] = folder.name
    told["frames"] = [{"illumination": name, "time_s": round(i / 60, 6)} for i, name in enumerate(lights)]
    (folder / "capture.yaml").write_text(yaml.safe_dump(told))
    pictures = [
        cv2.imread(str(source / f"{i:04d}_{lights[i]}_0nm_CAM1.png"), cv2.IMREAD_UNCHANGED) for i in range(9)
    ]
    for i, name in enumerate(lights):
        noise = np.random.default_rng(i).integers(0, 2, pictures[0].shape, dtype=np.uint16)
        path = folder / f"{i:04d}_{name}_0nm_CAM1.png"
        cv2.imwrite(str(path), np.minimum(pictures[i % 9] + noise, 1023), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return folder


def main() -> None:
    """Measure and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    names = ("heads", "between", "growth")
    parser.add_argument("--only", choices=names, help="measure and write this table alone")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        bench = Bench(work / "store") if asked.only != "growth" else None
        for name in names:
            if asked.only not in (None, name):
                continue
            if name == "growth":
                lines = growth(work)
            else:
                assert bench is not None
                lines = heads(bench) if name == "heads" else between(bench)
            print("\n".join(lines), flush=True)
            put(DOCS / "methods" / "alignment.md", name, lines)


if __name__ == "__main__":
    main()

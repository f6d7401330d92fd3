"""Matched sets, eyes and morphs against what is known; writes docs/methods/stimuli.md and its figures.

Runs the real command on six heads of the virtual rig (seeds 1 to 6: six shapes, six skins), reads the stored pictures
back with Pillow and measures them here, from the definitions. Eyes and flows are held against the heads' own geometry
(`tests/face_scenes.py`), from the true normals.
"""

import argparse
import csv
import json
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmarks.accuracy import DOCS, Bench
from benchmarks.pages import put
from lightstage.kernels.faces.face_flow import face_flow, landed
from lightstage.kernels.faces.face_frame import Frame, find_face
from lightstage.products.face_points import find_points, mean_face
from tests.face_scenes import PARTS, framed, true_flow, view

Array = NDArray[Any]
SEEDS = range(1, 7)
SESSIONS = [f"s{seed}" for seed in SEEDS]
KINDS = ("shape", "texture", "both")
WAYS = ("none", "mean-contrast", "histogram", "spectrum", "histogram,spectrum")
MORPH = ("s2", "s6")
_LEVELS = (0, 25, 50, 75, 100)


def heads(bench: Bench) -> None:
    """Capture the six heads, and compute what stimuli are made from, so that it is in no row's seconds."""
    for seed, name in zip(SEEDS, SESSIONS, strict=True):
        bench.call("demo", "--session", name, "--seed", str(seed))
        bench.call("run", "stimulus", "--session", name)


def matching(bench: Bench) -> list[str]:
    """One row per way of matching: how far apart any two of the stored pictures are."""
    lines = [
        "| `--match` | mean, contrast of luminance | mean, contrast of code values | histograms | spectra | clipped, worst picture | s |",
        "|---|---|---|---|---|---|---|",
    ]
    for grey in (False, True):
        for way in WAYS:
            start = time.perf_counter()
            folder = _made(bench, way, *(["--grey"] if grey else []))
            seconds = time.perf_counter() - start
            off = _apart(folder)
            clipped = max(float(row["clipped"]) for row in _told(folder))
            lines.append(
                f"| {way}{', grey' if grey else ''} | {off['mean']:.2f}, {off['contrast']:.2f} | {off['mean_code']:.2f}, "
                f"{off['contrast_code']:.2f} | {100 * off['histogram']:.2f} % | {100 * off['spectrum']:.2f} % "
                f"| {100 * clipped:.2f} % | {seconds:.0f} |"
            )
    return lines


def eyes(bench: Bench) -> list[str]:
    """Where eyes are found on heads whose eyes are known."""
    template, places = mean_face()
    plain, carried, apart = [], [], []
    for seed in range(1, 13):
        seen = view(seed)
        true = seen.places[:2]
        between = float(np.linalg.norm(true[1] - true[0]))
        matrix, _ = find_face(seen.normal, template)
        at = places @ matrix[:, :2].T + matrix[:, 2]
        plain.append(np.linalg.norm(at - true, axis=1) / between)
        found, _ = find_points(seen.normal)
        at = np.stack(list(found.values()))
        carried.append(np.linalg.norm(at - true, axis=1) / between)
        apart.append(abs(np.linalg.norm(at[1] - at[0]) / between - 1))
    lines = ["| eyes, 12 heads | off, median | mean | worst |", "|---|---|---|---|"]
    rows = {"mean head laid over the face": plain, "and carried by the flow": carried, "their distance": apart}
    for label, off in rows.items():
        cells = (f"{100 * figure(off):.1f} %" for figure in (np.median, np.mean, np.max))
        lines.append(f"| {label} | {' | '.join(cells)} |")
    return lines


def flows(bench: Bench) -> list[str]:
    """Parts of one head on another, and every pixel of a bent head on the one at rest."""
    frame = Frame(60)
    oval = frame.oval()
    faces = [framed(view(seed), frame) for seed in SEEDS]
    before, after = [], []
    for one in faces:
        for other in faces:
            if one is not other:
                flow = face_flow(one.normal, other.normal, oval, frame.eyes_px)
                before.append(np.linalg.norm(one.places - other.places, axis=1))
                after.append(np.linalg.norm(landed(one.places, flow) - other.places, axis=1))
    lines = ["| | apart: mean, worst | with the flow: mean, worst |", "|---|---|---|"]

    def row(label: str, apart: Array, left: Array) -> str:
        cells = (
            f"{100 * v.mean() / frame.eyes_px:.1f} %, {100 * v.max() / frame.eyes_px:.1f} %" for v in (apart, left)
        )
        return f"| {label} | {' | '.join(cells)} |"

    for k, name in enumerate(PARTS):
        lines.append(row(name, np.array(before)[:, k], np.array(after)[:, k]))
    bent, rest = framed(view(0, bent=True), frame), framed(view(0), frame)
    true = true_flow(frame)
    inside = (oval > 0.5) & np.isfinite(true[0])
    off = face_flow(bent.normal, rest.normal, oval, frame.eyes_px) - true
    lines.append(row("bent head, every pixel", np.hypot(*true)[inside], np.hypot(*off)[inside]))
    return lines


def pictures(bench: Bench) -> list[str]:
    """The figures; the page names them itself."""
    sets = [_made(bench, way) for way in ("none", "mean-contrast", "histogram,spectrum")]
    rows = [_beside(folder / f"{s}_{kind}.png" for s in SESSIONS) for kind in KINDS for folder in sets]
    _draw("stimuli_sets.png", rows, 0.55)
    rows = []
    for vary in ("shape", "texture"):
        folder = bench.store / "sets" / f"morph-{vary}"
        words = ("--morph", *MORPH, "--vary", vary, "--kinds", "both", "--to", folder)
        bench.call("stimuli", *MORPH, *words)
        rows.append(_beside(folder / f"{'-'.join(MORPH)}-{vary}-{level:03d}_both.png" for level in _LEVELS))
    _draw("stimuli_morph.png", rows, 0.8)
    return []


def _made(bench: Bench, way: str, *words: str) -> Path:
    folder = bench.store / "sets" / "".join([way.replace(",", "+"), *words])
    bench.call("stimuli", *SESSIONS, "--match", way, *words, "--to", folder)
    return folder


def _told(folder: Path) -> list[dict[str, str]]:
    with (folder / "stimuli.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def _apart(folder: Path) -> dict[str, float]:
    """Largest differences between any two pictures: grey levels, parts of a histogram, parts of a ring."""
    oval = Frame(json.loads((folder / "recipe.json").read_text())["eyes_px"]).oval() > 0
    light = [_luminance(np.asarray(Image.open(folder / row["file"]))) for row in _told(folder)]
    code = [255 * np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055) for v in light]
    fy, fx = np.fft.fftfreq(oval.shape[0])[:, None], np.fft.fftfreq(oval.shape[1])
    ring = np.minimum(np.rint(np.hypot(fy, fx) * min(oval.shape)).astype(int), min(oval.shape) // 2).ravel()
    spectra = np.array([np.bincount(ring, np.abs(np.fft.fft2(v)).ravel())[1:] for v in light])
    below = [np.searchsorted(np.sort(v[oval]), np.arange(256) + 0.5) / np.count_nonzero(oval) for v in code]
    return {
        "mean": 255 * float(np.ptp([v[oval].mean() for v in light])),
        "contrast": 255 * float(np.ptp([v[oval].std() for v in light])),
        "mean_code": float(np.ptp([v[oval].mean() for v in code])),
        "contrast_code": float(np.ptp([v[oval].std() for v in code])),
        "histogram": float(np.ptp(below, axis=0).max()),
        "spectrum": float(np.abs(spectra / spectra.mean(axis=0) - 1).max()),
    }


def _luminance(codes: Array) -> Array:
    """0 to 1, of an sRGB picture (IEC 61966-2-1)."""
    c = codes / 255
    light = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    return light @ np.array([0.2126, 0.7152, 0.0722]) if light.ndim == 3 else light


def _beside(files: Iterable[Path]) -> Array:
    """Pictures of one row, without most of their background."""
    row = []
    for file in files:
        picture = np.asarray(Image.open(file).convert("RGB"))
        height, width = picture.shape[:2]
        row.append(picture[height // 10 : -height // 10, width // 10 : -width // 10])
    return np.concatenate(row, axis=1)


def _draw(name: str, rows: list[Array], scale: float) -> None:
    whole = cv2.resize(np.concatenate(rows), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    Image.fromarray(whole).quantize(128).save(DOCS / "figures" / name, optimize=True)


def main() -> None:
    """Measure and write the tables and figures."""
    works: dict[str, Callable[[Bench], list[str]]] = {
        "matching": matching,
        "eyes": eyes,
        "flows": flows,
        "pictures": pictures,
    }
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=works, help="measure and write this alone")
    only = parser.parse_args().only
    with tempfile.TemporaryDirectory() as work:
        bench = Bench(Path(work) / "store")
        if only not in ("eyes", "flows"):
            heads(bench)
        for name, made in works.items():
            if only in (None, name):
                lines = made(bench)
                if lines:
                    print("\n".join(lines))
                    put(DOCS / "methods" / "stimuli.md", name, lines)


if __name__ == "__main__":
    main()

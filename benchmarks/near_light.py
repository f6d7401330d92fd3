"""The near-light model against truth: methods, one row per ingredient, sensitivity, integration, time; writes
docs/methods/near-light.md.

Runs the real command for the methods, and the kernels with one ingredient taken out for the ablation. Captures:
`rendered/static_*` and `fullres_A` of the shared data. Errors are mean / median degrees within the truth mask eroded
by one pixel; the mask is found, and so is the distance, unless a row says otherwise.
"""

import argparse
import contextlib
import resource
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import scipy.sparse
import xarray
from numpy.typing import NDArray

from benchmarks.accuracy import DATA, DOCS, Bench
from benchmarks.pages import put
from lightstage.kernels.normals import near_light, self_consistent
from lightstage.kernels.normals.near_light import Lights, LightVectors
from lightstage.kernels.pictures import subject_mask
from lightstage.kernels.surface import integration, interreflection, loose_parts, visibility
from lightstage.kernels.surface.integration import integrate
from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.store.document import load
from tests.rendered import angle, truth_of

Array = NDArray[Any]


class Subject:
    """A capture as the model gets it, and its truth."""

    def __init__(self, bench: Bench, name: str) -> None:
        self.folder = DATA / "rendered" / name
        self.session = bench.take_in(self.folder)
        path = bench.call("run", "stack", "--session", self.session)["nodes"]["stack"]["path"]
        opened = xarray.open_zarr(path, chunks=None).radiance.sel(component="diffuse")
        self.pictures = [
            {str(n): opened.values[i, b] for i, n in enumerate(opened.illumination.values)}
            for b in range(opened.sizes["band"])
        ]
        items = {
            k: load(self.folder / "calibration" / f"{k}.yaml", what="an item").value for k in ("lights", "camera")
        }
        for light in items["lights"]["lights"]:
            light.setdefault("direction", None)
        self.truth, self.inner = truth_of(self.folder)
        self.camera = Pinhole.of(items["camera"], self.inner.shape)
        self.lights = Lights.of(items["lights"], near=True)
        stored = np.load(self.folder / "truth" / "ground_truth_cam1.npz")
        self.depth, self.whole = stored["depth_mm"].astype(float), stored["mask"]

    def error(self, normal: Array) -> str:
        """mean / median degrees of (xyz, y, x)."""
        off = angle(normal, self.truth)[self.inner]
        off = off[np.isfinite(off)]
        return f"{off.mean():.2f} / {np.median(off):.2f}"

    def depth_error(self, depth: Array) -> str:
        """Mean absolute error, mean removed, percent of the range; and the distance's."""
        off = (depth - self.depth)[np.isfinite(depth) & self.whole]
        spread = np.abs(off - off.mean()).mean() / np.ptp(self.depth[self.whole])
        return f"{100 * spread:.2f} % | {np.median(off):+.1f}"


def solved(
    subject: Subject,
    model: str,
    *,
    lights: Lights | None = None,
    mask: Array | None = None,
    measured: LightVectors | None = None,
) -> tuple[Array, Array]:
    """Fused normals (xyz, y, x) and depth (y, x), by the kernels."""
    measured = near_light.measure(subject.pictures) if measured is None else measured
    lights = lights or subject.lights
    mask = subject_mask.find_subject(measured.constant.mean(axis=0)) if mask is None else mask
    found = self_consistent.solve(measured, mask, subject.camera, lights, model=model)
    points = subject.camera.points(found.depth)[found.mask]
    direct = np.ones(found.mask.shape)
    direct[found.mask] = near_light.invert(
        near_light.fused(measured).vector[0][found.mask], points, lights, found.seen
    ).direct
    one = near_light.fused(found.without_bounces(measured, direct))
    normal = np.full((3, *found.mask.shape), np.nan)
    normal[:, found.mask] = near_light.invert(one.vector[0][found.mask], points, lights, found.seen).normal.T
    return normal, found.depth


@contextlib.contextmanager
def changed(module: Any, **values: Any) -> Iterator[None]:
    """A module with other names bound for a while."""
    before = {name: getattr(module, name) for name in values}
    for name, value in values.items():
        setattr(module, name, value)
    try:
        yield
    finally:
        for name, value in before.items():
            setattr(module, name, value)


def methods(bench: Bench, subjects: dict[str, Subject]) -> list[str]:
    """Every correction, by the command."""
    lines = [
        "| correct | sphere | cylinder | head, 576 nm alone | head, six bands fused |",
        "|---|---|---|---|---|",
    ]
    alone = _one_band(bench, subjects["head"])
    settings = [("none", []), ("lights", []), ("near", []), ("near+shadows", []), ("full", [])]
    settings += [("near", ["filter=nlm"]), ("full", ["filter=nlm"]), ("full", ["method=minimal"])]
    for correct, more in settings:
        cells = []
        for name, session, fuse in (
            ("sphere", subjects["sphere"].session, []),
            ("cylinder", subjects["cylinder"].session, []),
            ("head", alone, []),
            ("head", subjects["head"].session, ["fuse=bands"]),
        ):
            result = bench.normals(session, [f"correct={correct}", *more, *fuse])
            cells.append(subjects[name].error(result.normal[0]))
        shown = " ".join([correct, *(m.split("=")[1] for m in more)])
        lines.append(f"| {shown} | " + " | ".join(cells) + " |")
    return lines


def _one_band(bench: Bench, subject: Subject) -> str:
    """The head's 576 nm pictures as a capture of their own."""
    import yaml

    folder = bench.store.parent / "one_band"
    folder.mkdir(exist_ok=True)
    plain = load(subject.folder / "capture.yaml", what="a capture").value
    plain |= {"session": "head-576", "bands_nm": [576]}
    for path in subject.folder.glob("*_576nm_*.png"):
        (folder / path.name).write_bytes(path.read_bytes())
    (folder / "calibration").mkdir(exist_ok=True)
    for path in (subject.folder / "calibration").iterdir():
        (folder / "calibration" / path.name).write_bytes(path.read_bytes())
    (folder / "capture.yaml").write_text(yaml.safe_dump(plain))
    return bench.take_in(folder)


def ablation(head: Subject) -> list[str]:
    """One ingredient less at a time, head, six bands fused."""
    plain_weights = _unweighted(head)
    rows: list[tuple[str, str, Callable[[], tuple[Array, Array]]]] = [
        ("full, all ingredients", "", lambda: solved(head, "full")),
        ("near+shadows, all ingredients", "", lambda: solved(head, "near+shadows")),
        ("near, all ingredients", "", lambda: solved(head, "near")),
        ("pictures not weighted by noise", "full", lambda: solved(head, "full", measured=plain_weights)),
    ]
    lines = ["| | mean / median | depth, of range | distance, mm |", "|---|---|---|---|"]
    for label, _, work in rows:
        normal, depth = work()
        lines.append(f"| {label} | {head.error(normal)} | {head.depth_error(depth)} |")
    without: list[tuple[str, Any, dict[str, Any]]] = [
        ("body not continued below the picture", visibility, {"_continued": lambda depth, _: (depth, 0)}),
        ("body without a back", visibility, {"_backs": lambda front: np.full(front.shape, 1e9)}),
        ("parts left where normals put them", loose_parts, {"_MOST": 0}),
        ("distance from all points, not open ones", self_consistent, {"_OPEN": -1.0}),
        ("depth by plain least squares", self_consistent, {"integrate": partial(integrate, stiffness=0.0)}),
        ("bounces by radiosity, not spectral", self_consistent, {"_SPECTRAL_BANDS": 99}),
        ("spectral slope from around 3 px alone", interreflection, {"_WIDE_PRIOR": 1e-6, "_LOCAL_PRIOR": 0.05}),
        ("3 rounds instead of 6", self_consistent, {"ROUNDS": {"full": 3}}),
        ("10 rounds instead of 6", self_consistent, {"ROUNDS": {"full": 10}}),
    ]
    for label, module, values in without:
        with changed(module, **values):
            normal, depth = solved(head, "full")
        lines.append(f"| full, {label} | {head.error(normal)} | {head.depth_error(depth)} |")
    return lines


def _unweighted(subject: Subject) -> LightVectors:
    with changed(near_light, noise_model=lambda _: (1.0, 0.0)):
        flat = near_light.measure(subject.pictures)
    weight = near_light.measure(subject.pictures).weight
    return LightVectors(flat.vector, flat.constant, weight)


def sensitivity(head: Subject) -> list[str]:
    """What a wrong distance, wrong light positions and another mask cost: head, six bands, full."""
    lines = ["| | mean / median | depth, of range | distance, mm |", "|---|---|---|---|"]
    measured = near_light.measure(head.pictures)
    right = self_consistent._distance
    for off in (-20.0, -5.0, 5.0, 20.0):

        def moved(*a: Any, off: float = off) -> tuple[float, bool]:
            distance, told = right(*a)
            return distance + off, told

        with changed(self_consistent, _distance=moved):
            normal, depth = solved(head, "full", measured=measured)
        lines.append(f"| distance {off:+.0f} mm | {head.error(normal)} | {head.depth_error(depth)} |")
    for sigma in (2.0, 5.0, 10.0):
        wrong = head.lights.position + np.random.default_rng(0).normal(0, sigma, head.lights.position.shape)
        lights = Lights(wrong, head.lights.drive, head.lights.power)
        normal, depth = solved(head, "full", lights=lights, measured=measured)
        lines.append(f"| lights off by {sigma:.0f} mm an axis | {head.error(normal)} | {head.depth_error(depth)} |")
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3))
    for pixels in (-4, -2, 0, 1, 2):
        change = cv2.erode if pixels < 0 else cv2.dilate
        mask = change(head.whole.astype(np.uint8), kernel, iterations=abs(pixels)) > 0
        mask = subject_mask.lit(mask, measured.constant.mean(axis=0))
        normal, depth = solved(head, "full", mask=mask, measured=measured)
        word = (
            "the true mask" if pixels == 0 else f"mask {'eroded' if pixels < 0 else 'dilated'} by {abs(pixels)} px"
        )
        lines.append(f"| {word} | {head.error(normal)} | {head.depth_error(depth)} |")
    return lines


def details(bench: Bench, head: Subject) -> list[str]:
    """How much of the true fine detail the normals hold, and what each filter costs of it."""
    lines = ["| filter | whole head | without creases | mean / median |", "|---|---|---|---|"]
    inside = cv2.erode(head.whole.astype(np.uint8), np.ones((9, 9))) > 0
    for name in ("none", "nlm", "surface"):
        normal = bench.normals(head.session, ["correct=full", "fuse=bands", f"filter={name}"]).normal[0]
        known = head.whole & np.isfinite(normal).all(axis=0)
        fine, true = _fine(normal, known), _fine(head.truth, known)
        calm = np.linalg.norm(true, axis=0) < 0.1
        slopes = [
            float((fine[:, part] * true[:, part]).sum() / (true[:, part] ** 2).sum())
            for part in (known, inside & known & calm)
        ]
        lines.append(f"| {name} | {slopes[0]:.2f} | {slopes[1]:.3f} | {head.error(normal)} |")
    return lines


def _fine(normal: Array, known: Array) -> Array:
    """(xyz, y, x) normals less their blurred selves."""
    inside = cv2.GaussianBlur(known.astype(np.float32), (0, 0), 2.0)
    kept = np.where(known, np.nan_to_num(normal), 0).astype(np.float32)
    return np.stack([n - cv2.GaussianBlur(n, (0, 0), 2.0) / np.maximum(inside, 1e-6) for n in kept])


def integrations(head: Subject) -> list[str]:
    """Depth from the true normals: ours, plain Poisson by SciPy, and the bilateral system solved directly."""
    n = np.moveaxis(head.truth, 0, 2) @ head.camera.rotation.T
    mask = head.whole
    n = np.where(mask[..., None], n, np.array([0.0, 0, -1]))
    lines = ["| | seconds | error, of range |", "|---|---|---|"]

    def row(label: str, work: Callable[[], Array]) -> None:
        began = time.perf_counter()
        log_depth = work()
        seconds = time.perf_counter() - began
        depth = np.exp(log_depth)
        depth *= np.median(head.depth[mask] / depth[mask])
        lines.append(f"| {label} | {seconds:.2f} | {head.depth_error(depth).split(' |')[0]} |")

    def directly(sides: Any, weights: Any, start: Array) -> Array:
        system: Any = scipy.sparse.identity(start.size, format="csc") * 1e-9
        right = 1e-9 * start
        for (matrix, side), weight in zip(sides, weights, strict=True):
            system = system + matrix.T @ scipy.sparse.diags(weight) @ matrix
            right = right + matrix.T @ (weight * side)
        return np.asarray(scipy.sparse.linalg.spsolve(system.tocsc(), right))

    row("bilateral, multigrid CG (ours), 25 rounds", lambda: integrate(n, mask, head.camera.rays, rounds=25))
    row("bilateral, multigrid CG (ours), 6 rounds", lambda: integrate(n, mask, head.camera.rays, rounds=6))
    with changed(integration, _solve=directly):
        row("bilateral, SciPy's direct solver, 25 rounds", lambda: integrate(n, mask, head.camera.rays, rounds=25))
        row("plain Poisson, SciPy's direct solver", lambda: integrate(n, mask, head.camera.rays, stiffness=0.0))
    return lines


def times(bench: Bench) -> list[str]:
    """Seconds and memory of the solution itself."""
    lines = ["| capture | model | seconds | peak memory of this process so far, GB |", "|---|---|---|---|"]
    for name, model in (("static_A", "full"), ("fullres_A", "near+shadows"), ("fullres_A", "full")):
        subject = Subject(bench, name)
        began = time.perf_counter()
        solved(subject, model)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        size = f"{subject.inner.shape[1]} x {subject.inner.shape[0]}"
        lines.append(f"| {name}, {size}, {len(subject.pictures)} band(s) | {model} | "
                     f"{time.perf_counter() - began:.1f} | {peak:.2f} |")  # fmt: skip
    return lines


def main() -> None:
    """Measure and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    names = ("methods", "detail", "ablation", "sensitivity", "integration", "time")
    parser.add_argument("--only", choices=names, help="measure and write this table alone")
    only = parser.parse_args().only
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder) / "store")
        head = Subject(bench, "static_A")
        works: dict[str, Callable[[], list[str]]] = {
            "methods": lambda: methods(
                bench,
                {
                    "sphere": Subject(bench, "static_sphere"),
                    "cylinder": Subject(bench, "static_cylinder"),
                    "head": head,
                },
            ),
            "detail": lambda: details(bench, head),
            "ablation": lambda: ablation(head),
            "sensitivity": lambda: sensitivity(head),
            "integration": lambda: integrations(head),
            "time": lambda: times(bench),
        }
        for name in names:
            if only in (None, name):
                put(DOCS / "methods" / "near-light.md", name, works[name]())


if __name__ == "__main__":
    main()

"""Alignment against the true flow: every engine, every kind of scene, residual against iteration; writes
docs/methods/alignment.md and docs/figures/alignment_residual.png.

The scenes are synthetic (`tests/moving_scenes.py`), and only seeds 0 to 4 are shown. Each engine gets one gradient pair; all
is judged inside the outline, 8 px away from the border. Pictures are resampled here by SciPy's cubic spline, not by
the engines' own code. Seconds are CPU seconds of one pair in one thread, both flows, the median over the seeds.

The reference engines were tuned on seeds 100 to 104, textured, 298 x 182: parameter after parameter through `GRID`,
a value kept where it lowered the mean endpoint error of its best iteration by more than 1 %. `--tune` does it again from the present
settings and prints every step; nothing is written. The plain flows have the settings of the alternating ones.

`band_alignment.py` measures the bands of a multispectral capture.
"""

import argparse
import time
from collections.abc import Callable, Iterable
from itertools import islice
from statistics import mean, median
from typing import Any, cast

import cv2
import matplotlib
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from benchmarks import band_alignment
from benchmarks.accuracy import DOCS
from benchmarks.near_light import changed
from benchmarks.pages import put
from lightstage.kernels.motion import picture_flow
from lightstage.kernels.motion.picture_flow import Method, alternating, direct, plain, rounds
from tests.moving_scenes import SIZES, Kind, Scene, scene
from tests.rendered import angle

matplotlib.use("Agg")
import matplotlib.pyplot as plt

Array = NDArray[Any]
Engine = Callable[[Scene], tuple[Array, Array]]
NAMES: dict[Method, str] = {"tvl1": "TV-L1", "dis": "DIS", "farneback": "Farneback"}
ITERATIONS: dict[Method, int] = {"tvl1": 9, "dis": 6, "farneback": 8}
"""Of the least mean endpoint error on the tuning seeds, among the first 10."""
SEEDS = {298: range(5), 812: range(3), 1624: range(2)}
SLOW = {298: range(5), 812: range(1), 1624: range(0)}
"""Seeds of TV-L1, whose alternation takes half a minute at 812 px and minutes at 1624."""
TUNING_SEEDS = range(100, 105)
TUNING_ITERATIONS = 10
FIGURE_ITERATIONS = 30
_REFINED: dict[str, list[Any]] = {
    "VariationalRefinementIterations": [0, 5, 10, 20],
    "VariationalRefinementAlpha": [10.0, 20.0, 40.0, 80.0],
    "VariationalRefinementGamma": [0.0, 10.0, 30.0],
    "VariationalRefinementDelta": [0.0, 5.0, 20.0],
    "PatchSize": [8, 12],
    "UseMeanNormalization": [False, True],
    "FinestScale": [0, 1],
}
GRID: dict[str, dict[str, list[Any]]] = {
    "direct": {"sigma_px": [1.0, 1.5, 2.0, 3.0, 4.0, 6.0], "_SPREAD": [2.0, 4.0, 6.0],
               "_FLOOR": [0.01, 0.02, 0.05], **_REFINED},
    "dis": _REFINED,
    "farneback": {"winsize": [15, 21, 31, 41, 61], "iterations": [1, 3, 10], "poly_n": [3, 5, 7],
                  "poly_sigma": [0.4, 0.5, 0.7, 0.9, 1.1, 1.5], "levels": [3, 4, 5]},
    "tvl1": {"Lambda": [0.1, 0.2, 0.3, 0.4, 0.8], "WarpingsNumber": [1, 2, 5], "InnerIterations": [5, 10, 30],
             "OuterIterations": [1, 2], "MedianFiltering": [1, 5], "ScalesNumber": [3, 4, 5],
             "Theta": [0.1, 0.3, 0.5]},
}  # fmt: skip


def engines() -> dict[str, Engine]:
    """Every engine by its name in the tables; without `joint` where it is not there."""
    out: dict[str, Engine] = {}
    for flow, name in NAMES.items():
        out[f"{name}, plain"] = _plain(flow)
    for flow, name in NAMES.items():
        out[f"{name}, alternating, {ITERATIONS[flow]} iterations"] = _alternating(flow)
    out["direct"] = lambda s: (direct(s.constant, s.gradient), direct(s.constant, s.complement))
    try:
        from lightstage.kernels.motion.joint_flow import joint
    except ModuleNotFoundError:
        print("no row of joint: kernels/motion/joint_flow.py is not there")
        return out
    out["joint"] = lambda s: joint(s.constant, s.gradient, s.complement)
    return out


def _plain(flow: Method) -> Engine:
    return lambda s: (plain(s.constant, s.gradient, flow=flow), plain(s.constant, s.complement, flow=flow))


def _alternating(flow: Method) -> Engine:
    def run(s: Scene) -> tuple[Array, Array]:
        found = alternating(s.constant, s.gradient, s.complement, flow=flow, iterations=ITERATIONS[flow])
        return found.u, found.v

    return run


def aligned(picture: Array, flow: Array) -> Array:
    """picture(x + flow(x)), (y, x), by a cubic spline."""
    y, x = np.indices(picture.shape, np.float32)
    return np.asarray(map_coordinates(picture, [y + flow[1], x + flow[0]], order=3, mode="nearest"))


def endpoint_error(s: Scene, u: Array, v: Array) -> float:
    """Mean over both flows, pixels."""
    return float(mean(np.hypot(*(f - t))[s.inner].mean() for f, t in ((u, s.u), (v, s.v))))


def judged(s: Scene, u: Array, v: Array) -> tuple[float, float, float]:
    """Endpoint error in pixels, residual as a share of the mean of c, and degrees from the true flow's normals."""
    gap, normal = _aligned_result(s, u, v)
    _, right = _aligned_result(s, s.u, s.v)
    residual = float(np.abs(gap)[s.inner].mean() / s.constant[s.inner].mean())
    return endpoint_error(s, u, v), residual, float(angle(normal, right)[s.inner].mean())


def _aligned_result(s: Scene, u: Array, v: Array) -> tuple[Array, Array]:
    """c - r(u) - r'(v), and normals by the difference method with the other axes' still pictures."""
    r, rc = aligned(s.gradient, u), aligned(s.complement, v)
    vector = np.stack([a.astype(float) - b for a, b in s.still])
    vector[s.axis] = r - rc
    return s.constant - r - rc, vector / (np.linalg.norm(vector, axis=0) + 1e-30)


def _row(engine: Engine, scenes: Iterable[Scene]) -> tuple[str, int]:
    """Cells of an engine's row, and over how many scenes."""
    seconds, results = [], []
    for s in scenes:
        began = time.process_time()
        u, v = engine(s)
        seconds.append(time.process_time() - began)
        results.append(judged(s, u, v))
    if not results:
        return "not run | | | |", 0
    error, residual, degrees = (mean(column) for column in zip(*results, strict=True))
    return f"{median(seconds):.2f} | {error:.3f} | {residual:.2%} | {degrees:.2f} |", len(results)


def compared() -> list[str]:
    """Every engine on the textured scenes of each size."""
    lines = ["| size | engine | scenes | CPU s a pair | endpoint error, px | residual | normals, degrees |",
             "|---|---|---|---|---|---|---|"]  # fmt: skip
    for width, seeds in SEEDS.items():
        scenes = [scene(seed, width) for seed in seeds]
        size = f"{width} x {SIZES[width][0]}"
        for name, engine in engines().items():
            chosen = [scenes[i] for i in SLOW[width]] if name.startswith("TV-L1") else scenes
            cells, count = _row(engine, chosen)
            lines.append(f"| {size} | {name} | {count} | {cells}")
            print(lines[-1], flush=True)
        residual = mean(judged(s, s.u, s.v)[1] for s in scenes)
        lines.append(f"| {size} | the true flow | {len(scenes)} | | 0 | {residual:.2%} | 0 |")
        print(lines[-1], flush=True)
    return lines


def kinds() -> list[str]:
    """The engines that know of light, on the other kinds of scene; at the thesis' size DIS as well."""
    lines = ["| size | scene | engine | scenes | CPU s a pair | endpoint error, px | residual (true flow's) | "
             "normals, degrees |", "|---|---|---|---|---|---|---|---|"]  # fmt: skip
    known = engines()
    others: tuple[Kind, ...] = ("smooth", "bumpy", "both", "independent")
    for width, names in ((298, others), (812, others), (1624, ("smooth", "independent"))):
        for kind in names:
            scenes = [scene(seed, width, kind) for seed in SEEDS[width]]
            right = mean(judged(s, s.u, s.v)[1] for s in scenes)
            for name, engine in known.items():
                if name not in ("direct", "joint") and not (width == 298 and name.startswith("DIS")):
                    continue
                cells, count = _row(engine, scenes)
                seconds, error, residual, *rest = cells.split(" | ")
                cells = " | ".join([seconds, error, f"{residual} ({right:.2%})", *rest])
                lines.append(f"| {width} x {SIZES[width][0]} | {kind} | {name} | {count} | {cells}")
                print(lines[-1], flush=True)
    return lines


def draw_iterations(s: Scene) -> list[str]:
    """The figure: residual and endpoint error of the alternating engines over iterations; its figures as a table."""
    bright = float(s.constant[s.inner].mean())
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(6.4, 6.4), sharex=True, layout="constrained")
    lines = ["| engine | residual, least (iteration) | residual, last | endpoint error, px, least (iteration) | last |",
             "|---|---|---|---|---|"]  # fmt: skip
    for flow, name in NAMES.items():
        residuals, errors = [], []
        for one in islice(rounds(s.constant, s.gradient, s.complement, flow=flow), FIGURE_ITERATIONS + 1):
            gap, _ = _aligned_result(s, one.u, one.v)
            residuals.append(100 * float(np.abs(gap)[s.inner].mean()) / bright)
            errors.append(endpoint_error(s, one.u, one.v))
        (line,) = top.plot(residuals, label=name)
        bottom.plot(errors, color=line.get_color())
        i, j = int(np.argmin(residuals)), int(np.argmin(errors))
        lines.append(
            f"| {name} | {residuals[i]:.2f}% ({i}) | {residuals[-1]:.2f}% | {errors[j]:.3f} ({j}) | {errors[-1]:.3f} |"
        )
        print(lines[-1], flush=True)
    fixed: list[tuple[str, tuple[Array, Array], str]] = [("the true flow", (s.u, s.v), "-")]
    if "joint" in (known := engines()):
        fixed.append(("joint", known["joint"](s), "--"))
    for name, (u, v), style in fixed:
        error, residual, _ = judged(s, u, v)
        top.axhline(100 * residual, color="0.2", linestyle=style, linewidth=1, label=name)
        if error > 0:
            bottom.axhline(error, color="0.2", linestyle=style, linewidth=1)
        lines.append(f"| {name} | | {residual:.2%} | | {error:.3g} |")
        print(lines[-1], flush=True)
    top.set_ylabel("residual, % of the mean of c")
    bottom.set_ylabel("endpoint error, px")
    bottom.set_xlabel("iteration")
    for axis, ticks in ((top, [1, 1.5, 2, 3, 4, 5, 7, 10]), (bottom, [0.03, 0.05, 0.1, 0.2, 0.5, 1, 2, 5])):
        axis.set_yscale("log")
        axis.set_xlim(0, FIGURE_ITERATIONS)
        low, high = axis.get_ylim()
        axis.set_yticks([t for t in ticks if low <= t <= high], minor=False)
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter("")
        axis.grid(alpha=0.3)
    top.legend(frameon=False, ncols=2)
    figure.savefig(DOCS / "figures" / "alignment_residual.png", dpi=110)
    plt.close(figure)
    return lines


def tune() -> None:
    """Search `GRID` on the tuning seeds, parameter after parameter, from the present settings."""
    scenes = [scene(seed, 298) for seed in TUNING_SEEDS]
    tables = {"direct": picture_flow._DIRECT, "farneback": picture_flow._FARNEBACK, "dis": picture_flow._DIS,
              "tvl1": picture_flow._TVL1}  # fmt: skip
    for name, grid in GRID.items():
        table = f"_{name.upper()}"
        settings = dict(tables[name])
        globals_: dict[str, Any] = {}
        arguments: dict[str, Any] = {}
        best = _tuning_error(name, scenes, {})
        print(f"{name}: {settings}: {_shown(best)}", flush=True)
        for parameter, values in grid.items():
            for value in values:
                kept = (dict(settings), dict(globals_), dict(arguments))
                place = (
                    globals_ if parameter.startswith("_") else arguments if parameter == "sigma_px" else settings
                )
                if place.get(parameter) == value:
                    continue
                place[parameter] = value
                with changed(picture_flow, **{table: settings}, **globals_):
                    errors = _tuning_error(name, scenes, arguments)
                better = errors.min() < 0.99 * best.min()
                print(f"{name}: {parameter} = {value}: {_shown(errors)}{' (kept)' if better else ''}", flush=True)
                if better:
                    best = errors
                else:
                    settings, globals_, arguments = kept
        print(f"{name}: chosen {settings | globals_ | arguments}, iteration {int(best.argmin()) + 1}", flush=True)


def _shown(errors: Array) -> str:
    return " ".join(f"{e:.4f}" for e in errors)


def _tuning_error(name: str, scenes: list[Scene], arguments: dict[str, Any]) -> Array:
    """Mean endpoint error over the scenes after each iteration, (iteration,)."""
    if name == "direct":
        found = [
            [(direct(s.constant, s.gradient, **arguments), direct(s.constant, s.complement, **arguments))]
            for s in scenes
        ]
    else:
        found = [
            [
                (one.u, one.v)
                for one in islice(
                    rounds(s.constant, s.gradient, s.complement, flow=cast(Method, name)), 1, TUNING_ITERATIONS + 1
                )
            ]
            for s in scenes
        ]
    errors = [[endpoint_error(s, u, v) for u, v in flows] for s, flows in zip(scenes, found, strict=True)]
    return np.asarray(np.mean(errors, axis=0))


def main() -> None:
    """Measure everything and write the page, or tune."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tune", action="store_true", help="search the reference engines' settings, write nothing")
    works: dict[str, Callable[[], list[str]]] = {
        "engines": compared,
        "kinds": kinds,
        "iterations": lambda: draw_iterations(first),
        "bands": band_alignment.table,
    }
    parser.add_argument("--only", choices=works, help="measure and write this table alone")
    asked = parser.parse_args()
    cv2.setNumThreads(1)
    if asked.tune:
        tune()
        return
    began = time.perf_counter()
    first = scene(0, 298)
    for name, engine in engines().items():
        if name == "joint":
            engine(first)  # compiled once, before it is timed
    tables = {name: work() for name, work in works.items() if asked.only in (None, name)}
    for name, lines in tables.items():
        put(DOCS / "methods" / "alignment.md", name, lines)
    print(f"{time.perf_counter() - began:.0f} s in all")


if __name__ == "__main__":
    main()

"""The per-pixel kernels at 1624 x 1236 against naive numpy, blocked numpy, OpenCV, and a copy of the same bytes.

Every row runs in this process on one thread, in turn, and the best of many rounds counts; *bytes* are those that
our kernel reads and writes, and the copy moves the same number (half read, half written).
"""

import argparse
import os
import platform
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.normals.quantised import FILL, STEPS
from lightstage.kernels.normals.spherical_gradients import GRADIENTS, Normals, solve, table

SHAPE = (1236, 1624)
THESIS_SECONDS = 1.78 * 3600
"""Dutta (2010) 4.4.5: MATLAB's quadprog, one 1624 x 1236 map, 3 GHz Core 2 Duo."""
Array = NDArray[Any]
SIX = tuple(GRADIENTS)
SEVEN = (*GRADIENTS, "C")


def naive(p: dict[str, Array]) -> tuple[Array, ...]:
    """The formula as one writes it."""
    g = np.stack([p[a].astype(np.float64) - p[a + "c"] for a in "XYZ"])
    length = np.linalg.norm(g, axis=0)
    total = sum(p[name].astype(np.float64) for name in SIX) / 3
    with np.errstate(divide="ignore", invalid="ignore"):
        normal, norm = g / length, length / (2 * total)
    valid = (length > 0) & (total > 0)
    return (
        np.where(valid, np.floor(normal * STEPS + 0.5), FILL).astype(np.int16),
        total.astype("f4"),
        norm.astype("f4"),
        valid,
    )


def blocked(p: dict[str, Array], rows: int = 16) -> tuple[Array, ...]:
    """The same in float32 on strips that stay in the cache, into arrays made once."""
    normal = np.empty((3, *SHAPE), np.int16)
    total, norm, valid = np.empty(SHAPE, np.float32), np.empty(SHAPE, np.float32), np.empty(SHAPE, bool)
    for first in range(0, SHAPE[0], rows):
        cut = np.s_[first : first + rows]
        strip = {name: p[name][cut].astype(np.float32) for name in SIX}
        g = np.stack([strip[a] - strip[a + "c"] for a in "XYZ"])
        square = np.einsum("ayx,ayx->yx", g, g)
        length = np.sqrt(square)
        t = sum(strip.values()) / np.float32(3)
        with np.errstate(divide="ignore", invalid="ignore"):
            scaled = np.floor(g * (np.float32(STEPS) / length) + np.float32(0.5))
            norm[cut] = length / (2 * t)
        valid[cut] = (square > 0) & (t > 0)
        normal[:, cut] = np.where(valid[cut], scaled, FILL).astype(np.int16)
        total[cut] = t
    return normal, total, norm, valid


def with_opencv(p: dict[str, Array]) -> tuple[Array, ...]:
    """OpenCV's vectorised primitives."""
    g = [cv2.subtract(p[a], p[a + "c"], dtype=cv2.CV_32F) for a in "XYZ"]
    square = cv2.multiply(g[0], g[0])
    for component in g[1:]:
        square = cv2.add(square, cv2.multiply(component, component))
    length = cv2.sqrt(square)
    scale = cv2.divide(float(STEPS), length)
    normal = np.stack([cv2.multiply(component, scale, dtype=cv2.CV_16S) for component in g])
    total = cv2.add(p["X"], p["Xc"], dtype=cv2.CV_32F)
    for name in ("Y", "Yc", "Z", "Zc"):
        total = cv2.add(total, p[name], dtype=cv2.CV_32F)
    total = cv2.multiply(total, 1 / 3)
    return normal, total, cv2.divide(length, total, scale=0.5), cv2.compare(square, 0, cv2.CMP_GT)


def best(tasks: dict[str, Callable[[], Any]], rounds: int) -> dict[str, float]:
    """Milliseconds: the tasks in turn, the best of all rounds each."""
    found = dict.fromkeys(tasks, np.inf)
    for task in tasks.values():
        task()
    for _ in range(rounds):
        for name, task in tasks.items():
            began = time.perf_counter()
            task()
            found[name] = min(found[name], 1e3 * (time.perf_counter() - began))
    return {name: float(value) for name, value in found.items()}


def copy_of(count: int) -> Callable[[], Any]:
    """A copy that reads and writes `count` bytes together."""
    source, target = np.ones(count // 2, np.uint8), np.zeros(count // 2, np.uint8)
    return lambda: np.copyto(target, source)


def moved(inputs: Sequence[Array], out: Normals) -> int:
    """Bytes read and written."""
    return sum(a.nbytes for a in inputs) + sum(a.nbytes for a in out)


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=30)
    rounds = parser.parse_args().rounds
    cv2.setNumThreads(1)
    generator = np.random.default_rng(0)
    pictures = {name: generator.integers(100, 1000, SHAPE).astype(np.uint16) for name in SEVEN}
    out = Normals.empty(SHAPE)

    def ours(names: Sequence[str], method: str, base: str = "", qp: bool = False) -> tuple[Callable[[], Any], int]:
        how = table(method, base, names, qp=qp)
        used = [pictures[name] for name in how.pictures]
        return (lambda: solve(used, how, out=out)), moved(used, out)

    six, count = ours(SIX, "difference")
    tasks = {
        "naive numpy": lambda: naive(pictures),
        "blocked numpy": lambda: blocked(pictures),
        "OpenCV": lambda: with_opencv(pictures),
        "ours": six,
        "copy of the same bytes": copy_of(count),
    }
    np.testing.assert_allclose(
        naive(pictures)[0], solve([pictures[n] for n in SIX], table("difference", "", SIX)).normal, atol=1
    )
    times = best(tasks, rounds)
    print(f"{platform.processor() or platform.machine()}, one thread, {SHAPE[1]} x {SHAPE[0]}, best of {rounds}\n")
    print("difference from six uint16 pictures: int16 normals, r_c, norm, valid\n")
    print("| | ms | naive / this | speed of the copy |\n|---|---|---|---|")
    for name, value in times.items():
        speed = times["copy of the same bytes"] / value
        print(f"| {name} | {value:.2f} | {times['naive numpy'] / value:.1f} | {speed:.2f} |")

    print("\n| kernel | pictures | ms | copy, ms | speed of the copy |\n|---|---|---|---|---|")
    rows = {
        "difference": ours(SEVEN, "difference"),
        "ratio": ours(SEVEN, "ratio"),
        "minimal": ours(("X", "Xc", "Y", "Z"), "minimal", "X"),
        "difference + QP": ours(SEVEN, "difference", qp=True),
    }
    for dtype in (np.uint16, np.float32):
        pictures = {name: picture.astype(dtype) for name, picture in pictures.items()}
        if dtype is np.float32:
            rows = {
                "difference": ours(SEVEN, "difference"),
                "difference + QP": ours(SEVEN, "difference", qp=True),
            }
        measured = best(
            {**{k: v[0] for k, v in rows.items()}, **{f"copy {k}": copy_of(v[1]) for k, v in rows.items()}}, rounds
        )
        for name in rows:
            ratio = measured[f"copy {name}"] / measured[name]
            print(
                f"| {name} | {np.dtype(dtype).name} | {measured[name]:.2f} | {measured[f'copy {name}']:.2f} | {ratio:.2f} |"
            )
        corrected, plain = measured["difference + QP"], measured["difference"]
        print(
            f"\nQP on {np.dtype(dtype).name}: {corrected / plain:.2f} times the difference kernel; the thesis took "
            f"{THESIS_SECONDS:.0f} s on another machine, {THESIS_SECONDS / corrected * 1e3:,.0f} times as long\n"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())

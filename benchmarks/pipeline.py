"""Whole runs: end to end against a plain loop, cached, and memory against the number of frames.

Uses the virtual rig at 1624 x 1236, so it needs no data. Times of commands are of whole processes unless a line says
otherwise; memory is the peak resident set of the process.
"""

import argparse
import json
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

ROOT = Path(__file__).resolve().parent.parent
SIZE = (1624, 1236)
STILL = """\
stages:
  capture:  {uses: capture}
  register: {uses: register, from: capture}
  split:    {uses: split,    from: register}
  stack:    {uses: stack,    from: split}
  align:    {uses: align,    from: stack}
  normals:  {uses: normals,  from: align}
"""
"""What the plain loop does: no alignment."""


def command(store: Path, *words: str | Path) -> list[str]:
    """The command line of `lightstage`."""
    return [sys.executable, "-m", "lightstage.cli.main", "--store", str(store), *map(str, words)]


def timed(words: list[str]) -> tuple[float, float, str]:
    """Wall seconds, peak MB and standard output of a process."""
    code = (
        "import resource, subprocess, sys\n"
        "done = subprocess.run(sys.argv[1:], capture_output=True, text=True)\n"
        "sys.stderr.write(done.stderr)\n"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)\n"
        "print(done.stdout)\n"
        "sys.exit(done.returncode)"
    )
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", code, *words], cwd=ROOT, capture_output=True, text=True, check=False
    )
    seconds = time.perf_counter() - began
    if done.returncode:
        raise SystemExit(f"{' '.join(words)}\n{done.stderr}")
    memory, _, out = done.stdout.partition("\n")
    return seconds, int(memory) / 1024, out


def performance(folder: Path, source: Path, frames: int) -> Path:
    """A capture of many frames, each picture with noise of its own, made from one static capture in one band."""
    folder.mkdir()
    shutil.copytree(source / "calibration", folder / "calibration")
    description = yaml.safe_load((source / "capture.yaml").read_text())
    order = ["X", "Y", "Z", "C", "Xc", "Yc", "Zc", "C"]
    lights = [order[i % len(order)] for i in range(frames)]
    description |= {"session": folder.name, "frame_rate_hz": 60.0, "frames": [{"illumination": n} for n in lights]}
    (folder / "capture.yaml").write_text(yaml.safe_dump(description))
    place = {
        frame["illumination"]: i
        for i, frame in enumerate(yaml.safe_load((source / "capture.yaml").read_text())["frames"])
    }
    band = description["bands_nm"][0]

    def write(job: tuple[int, int]) -> None:
        i, camera = job
        name = lights[i]
        picture = cv2.imread(
            str(source / f"{place[name]:04d}_{name}_{band}nm_CAM{camera}.png"), cv2.IMREAD_UNCHANGED
        )
        noise = np.random.default_rng(job).integers(0, 2, picture.shape, dtype=np.uint16)
        path = folder / f"{i:04d}_{name}_{band}nm_CAM{camera}.png"
        cv2.imwrite(str(path), np.minimum(picture + noise, 1023), [cv2.IMWRITE_PNG_COMPRESSION, 1])

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(write, [(i, camera) for i in range(frames) for camera in (0, 1)]))
    return folder


def plain_loop(raw: Path, items: dict[str, Any], facts: dict[str, Any], target: Path, threads: int) -> float:
    """The same kernels in a loop over frames, the same arrays written with zarr: no Dask, no keys, no digests, no
    flush to the disk. Returns seconds."""
    import zarr
    from zarr.codecs import BloscCodec

    from lightstage.kernels.normals.methods import normals
    from lightstage.kernels.pictures.components import split
    from lightstage.kernels.pictures.picture_sets import choose, chosen_sets, windows
    from lightstage.kernels.pictures.radiance import stack
    from lightstage.kernels.pictures.registration import prepare, register
    from lightstage.stages.register import STAGE

    cv2.setNumThreads(1)
    zarr.config.set({"async.concurrency": 1, "threading.max_workers": threads})
    pictures = zarr.open_group(raw, mode="r")["raw"]
    frames, _, cameras, height, width = pictures.shape
    params = STAGE.params()
    assert STAGE.context is not None
    ready = prepare(**STAGE.context({}, facts, items, params), **params.model_dump())
    group = zarr.create_group(target)

    def array(name: str, shape: tuple[int, ...], chunk: tuple[int, ...], dtype: str, fill: Any) -> Any:
        codec = BloscCodec(cname="lz4", clevel=1, shuffle="bitshuffle")
        return group.create_array(name, shape=shape, chunks=chunk, dtype=dtype, fill_value=fill, compressors=codec)

    image = (height, width)
    outs = {
        name: array(name, (frames, 1, cameras, *image), (1, 1, 1, *image), "float32", np.nan)
        for name in ("register", "split", "stack")
    }
    valid = array("valid", (frames, 1, *image), (1, 1, *image), "bool", False)
    choice = choose([*"XYZ", "Xc", "Yc", "Zc", "C"])
    sets = chosen_sets(windows(facts["illumination"]), method="auto", base="auto", correct="none", whole="")
    normal = array("normal", (len(sets), 1, 3, *image), (1, 1, 3, *image), "int16", -32768)
    others = {n: array(n, (len(sets), 1, *image), (1, 1, *image), "float32", np.nan) for n in ("albedo", "norm")}
    found = array("found", (len(sets), 1, *image), (1, 1, *image), "bool", False)

    def frame(i: int) -> None:
        done = register(pictures[i, 0], **ready)
        outs["register"][i, 0], valid[i, 0] = done["signal"], done["valid"]
        parts = split(done["signal"], polarisations=("parallel", "cross"))["signal"]
        outs["split"][i, 0] = parts
        outs["stack"][i, 0] = stack({i: parts}, counts_per_radiance=130.0)["radiance"]

    def tracking(k: int) -> None:
        (_, place), chosen = sets[k]
        radiance = {(0.0, name): outs["stack"][place[name], 0, 0] for name in chosen.pictures}
        made = normals(radiance, {}, choice=choice, lights=None, view=None)
        normal[k, 0], found[k, 0] = made["normal"], made["valid"]
        others["albedo"][k, 0], others["norm"][k, 0] = made["albedo"], made["norm"]

    frame(0)  # outside the clock, for this side: numba reads its cache, and the first frame is done once more below
    began = time.perf_counter()
    if threads == 1:
        for i in range(frames):
            frame(i)
        for k in range(len(sets)):
            tracking(k)
    else:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(frame, range(frames)))
            list(pool.map(tracking, range(len(sets))))
    return time.perf_counter() - began


def compare_with_plain_loop(work: Path, folder: Path, rounds: int) -> None:
    """End to end, ours against the loop, in turn."""
    from lightstage.store.importer import import_capture
    from lightstage.store.items import get_item
    from lightstage.store.root import Store
    from lightstage.store.sessions import read_session

    name = folder.name
    base = work / "base"
    import_capture(folder, Store(base))
    store = Store(base)
    session = read_session(name, store)
    facts = {**session.facts, "shape": list(session.shape)}
    items: dict[str, Any] = {}
    for kind, digest in session.items.items():
        item = get_item(kind, digest, store)
        items[kind] = dict(item.values)
        if item.pictures:
            items[kind]["pictures"] = {c: _Loaded(p.load(store)) for c, p in item.pictures.items()}
    count = session.sizes["frame"] * session.sizes["polarisation"]
    still = work / "still.yaml"
    still.write_text(STILL)
    seconds: dict[str, list[float]] = {
        "ours, run": [],
        "ours, whole process": [],
        "loop, 1 thread": [],
        "loop, 2 threads": [],
    }
    for i in range(rounds):
        mine = work / f"ours{i}"
        shutil.copytree(base, mine, symlinks=True)
        wall, _, out = timed(command(mine, "run", "--session", name, "--pipeline", still, "--json"))
        seconds["ours, whole process"].append(wall)
        seconds["ours, run"].append(json.loads(out)["seconds"])
        shutil.rmtree(mine)
        for threads in (1, 2):
            target = work / f"loop{threads}.zarr"
            label = f"loop, {threads} thread{'s' if threads > 1 else ''}"
            seconds[label].append(plain_loop(base / "sessions" / name / "raw.zarr", items, facts, target, threads))
            shutil.rmtree(target)
    print(
        f"\n## End to end: {count} pictures of {SIZE[0]} x {SIZE[1]}, every result stored ({rounds} rounds, median)\n"
    )
    print("| | s | pictures/s | of the 2-thread loop's time |\n|---|---|---|---|")
    reference = float(np.median(seconds["loop, 2 threads"]))
    for label, values in seconds.items():
        middle = float(np.median(values))
        print(f"| {label} | {middle:.2f} | {count / middle:.1f} | {middle / reference:.2f} |")


class _Loaded:
    def __init__(self, pixels: Any) -> None:
        self._pixels = pixels

    def load(self) -> Any:
        """The pixels."""
        return self._pixels


def cached(work: Path, rounds: int) -> None:
    """A run that has nothing to do."""
    store = work / "cached"
    timed(command(store, "demo"))
    first, _, _ = timed(command(store, "run", "--session", "demo"))
    again = [timed(command(store, "run", "--session", "demo"))[0] for _ in range(rounds)]
    changed, _, out = timed(command(store, "run", "--session", "demo", "--set", "normals.method=ratio", "--json"))
    done = {name: node["computed"] for name, node in json.loads(out)["nodes"].items()}
    print("\n## Cached: 7 frames, 6 bands, 2 cameras at 406 x 309, whole process with its start\n")
    print("| | s |\n|---|---|")
    print(f"| first run | {first:.2f} |\n| again, median of {rounds} | {np.median(again):.3f} |")
    print(f"| normals.method changed ({done}) | {changed:.2f} |")


def memory(work: Path, source: Path, counts: list[int]) -> None:
    """Peak memory against the number of frames."""
    print(f"\n## Memory: frames of {SIZE[0]} x {SIZE[1]}, two cameras\n")
    print("| frames | peak of import, MB | peak of run, MB | s | pictures/s |\n|---|---|---|---|---|")
    for count in counts:
        folder = performance(work / f"p{count}", source, count)
        store = work / f"store{count}"
        _, imported, _ = timed(command(store, "import", folder))
        seconds, peak, _ = timed(command(store, "run", "--session", folder.name))
        print(f"| {count} | {imported:.0f} | {peak:.0f} | {seconds:.1f} | {2 * count / seconds:.1f} |", flush=True)
        shutil.rmtree(store)
        shutil.rmtree(folder)


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--frames", type=int, nargs="*", default=[10, 100])
    options = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_NOFILE, (4096, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        cached(work, options.rounds)
        timed(
            command(work / "rig", "demo", "--size", f"{SIZE[0]}x{SIZE[1]}", "--bands", "576", "--session", "full")
        )
        (source,) = (work / "rig" / "captures").iterdir()
        compare_with_plain_loop(work, performance(work / "many", source, 24), options.rounds)
        memory(work, source, options.frames)
    return 0


if __name__ == "__main__":
    sys.exit(main())

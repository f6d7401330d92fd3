"""What a run costs against the number of its pictures: processor time, memory, inodes and bytes for each of them.

The pictures are small (64 x 48, one camera, one band), so that what is measured is the engine and the store rather than
the numerics: the virtual rig's moving head in the minimal sequence, which comes round after nine pictures, again and
again with noise of its own. The default pipeline runs in a process of its own, in a store of its own. Processor time
is user and system together, so that a busy machine spoils little; a first run that is not counted fills numba's cache.

    python -m benchmarks.growth [--frames 7 70 350 700 1400 2000] [--rounds 3] [--profile FOLDER]

With --profile, py-spy (which has to be installed for it) samples every run, and the functions of `store/` and `dag/`
are listed with their shares of the samples. A thread that waits for the disk is sampled too; and processor time is
then py-spy's as well.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import yaml

ROOT = Path(__file__).resolve().parent.parent
PICTURES = (7, 70, 350, 700, 1400, 2000)
CYCLE = 9
"""Pictures after which the minimal sequence with mixed sets begins anew."""
FROM = 70
"""The straight line is laid through runs of so many pictures and more: below, the start is all that there is."""
SAMPLES_A_SECOND = 100
_FUNCTION = re.compile(r"^([\w<>.]+) \((?:[^()]*/)?((?:store|dag)/\w+\.py)")
SHOWN = 0.02
"""Share of the samples from which on a function is listed."""


@dataclass(frozen=True)
class Cost:
    """What a process took."""

    processor_s: float
    wall_s: float
    peak_mb: float


@dataclass(frozen=True)
class Held:
    """What a store holds."""

    inodes: int
    """Files and folders; a hard link is no inode of its own."""
    entries: int
    """Names in folders, hard links too."""
    size: int
    """Bytes of all files, each once."""


def process(words: Sequence[str | Path], folder: Path = ROOT) -> Cost:
    """Run a program to its end, in a folder."""
    began = time.perf_counter()
    child = subprocess.Popen([*map(str, words)], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert child.stderr is not None
    said = child.stderr.read()
    _, status, used = os.wait4(child.pid, 0)
    if status:
        raise SystemExit(f"{' '.join(map(str, words))}\n{said.decode()}")
    return Cost(used.ru_utime + used.ru_stime, time.perf_counter() - began, used.ru_maxrss / 1024)


def held(folder: Path) -> Held:
    """Look through a store."""
    sizes: dict[int, int] = {}
    entries = 0
    for path in folder.rglob("*"):
        state = path.lstat()
        sizes[state.st_ino] = 0 if path.is_dir() else state.st_size
        entries += 1
    return Held(len(sizes), entries, sum(sizes.values()))


def lightstage(store: Path, *words: str | Path) -> list[str | Path]:
    """A command."""
    return [sys.executable, "-m", "lightstage.cli.main", "--store", store, *words]


def rendered(work: Path) -> Path:
    """One round of the performance and a little more, as the virtual rig captures it."""
    store = work / "rig"
    options = ("--sequence", "minimal", "--tracking", "3", "--size", "64x48", "--bands", "0")
    process(lightstage(store, "demo", *options))
    process(lightstage(store, "run", "--session", "demo-minimal"))
    (folder,) = (store / "captures").iterdir()
    return folder


def performance(folder: Path, source: Path, pictures: int) -> Path:
    """So many pictures: the rendered ones in turn, each with noise of its own, so that nothing is reused."""
    folder.mkdir()
    shutil.copytree(source / "calibration", folder / "calibration")
    plain = yaml.safe_load((source / "capture.yaml").read_text())
    rate = plain["frame_rate_hz"]
    lights = [plain["frames"][i % CYCLE]["illumination"] for i in range(pictures)]
    files = sorted(source.glob("*.png"))[:CYCLE]
    decoded = [cv2.imread(str(file), cv2.IMREAD_UNCHANGED) for file in files]
    white = 2 ** plain["bits"] - 1
    plain |= {
        "session": folder.name,
        "files": "{frame:04d}.png",
        "frames": [{"illumination": name, "time_s": round(i / rate, 6)} for i, name in enumerate(lights)],
    }
    (folder / "capture.yaml").write_text(yaml.safe_dump(plain))
    for i in range(pictures):
        noise = np.random.default_rng(i).integers(0, 2, decoded[0].shape, dtype=np.uint16)
        picture = np.minimum(decoded[i % CYCLE] + noise, white)
        cv2.imwrite(str(folder / f"{i:04d}.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return folder


def shares(stacks: Path) -> list[tuple[float, float, str]]:
    """Functions of the engine and the store: share of the samples within them, in them or what they call, and name."""
    within: Counter[str] = Counter()
    below: Counter[str] = Counter()
    total = 0
    for line in stacks.read_text().splitlines():
        stack, _, number = line.rpartition(" ")
        total += int(number)
        frames = [_FUNCTION.search(frame) for frame in stack.split(";")]
        names = [f"{found[2]} {found[1]}" if found else "" for found in frames]
        within[names[-1]] += int(number)
        for name in set(names) - {""}:
            below[name] += int(number)
    return [(within[name] / total, count / total, name) for name, count in below.most_common()]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, nargs="+", default=PICTURES, metavar="N", help="pictures of each run")
    parser.add_argument("--rounds", type=int, default=1, metavar="N", help="of which the cheapest counts")
    parser.add_argument("--profile", type=Path, metavar="FOLDER", help="keep py-spy's samples of each run there")
    options = parser.parse_args()
    rows: list[tuple[int, Cost]] = []
    with tempfile.TemporaryDirectory() as room:
        work = Path(room)
        source = rendered(work)
        print(
            "| pictures | import, CPU s | run, CPU s | wall, s | CPU ms a picture | peak, MB | inodes a picture | "
            "names a picture | kB a picture |\n|---|---|---|---|---|---|---|---|---|"
        )
        for pictures in options.frames:
            folder, store = performance(work / f"long{pictures}", source, pictures), work / "store"
            command = lightstage(store, "run", "--session", folder.name)
            stacks = None
            if options.profile:
                options.profile.mkdir(parents=True, exist_ok=True)
                stacks = options.profile / f"{pictures}.txt"
                rate = str(SAMPLES_A_SECOND)
                command = [
                    "py-spy",
                    "record",
                    "--format",
                    "raw",
                    "--rate",
                    rate,
                    "--output",
                    stacks,
                    "--",
                    *command,
                ]
            imports, runs = [], []
            for _ in range(options.rounds):
                shutil.rmtree(store, ignore_errors=True)
                imports.append(process(lightstage(store, "import", folder)))
                runs.append(process(command))
            brought, cost = (min(costs, key=lambda cost: cost.processor_s) for costs in (imports, runs))
            room_taken = held(store)
            rows.append((pictures, cost))
            print(
                f"| {pictures} | {brought.processor_s:.1f} | {cost.processor_s:.1f} | {cost.wall_s:.1f} | "
                f"{1e3 * cost.processor_s / pictures:.1f} | {cost.peak_mb:.0f} | {room_taken.inodes / pictures:.1f} | "
                f"{room_taken.entries / pictures:.1f} | {room_taken.size / pictures / 1e3:.1f} |",
                flush=True,
            )
            if stacks:
                shown = [share for share in shares(stacks) if share[1] >= SHOWN]
                print(
                    "\n".join(f"    {own:.1%} within, {all_:.1%} with calls: {name}" for own, all_, name in shown)
                )
            shutil.rmtree(store)
            shutil.rmtree(folder)
    _say_fit([(pictures, cost) for pictures, cost in rows if pictures >= FROM])


def _say_fit(rows: Sequence[tuple[int, Cost]]) -> None:
    if len(rows) < 2:
        return
    count, seconds = np.array([[n, cost.processor_s] for n, cost in rows]).T
    # what is uncertain is a share of the whole
    slope, start = np.polyfit(count, seconds, 1, w=1 / seconds)
    print(f"CPU = {start:.1f} s + {1e3 * slope:.2f} ms x pictures")
    for n, s in zip(count, seconds, strict=True):
        line = start + slope * n
        print(f"  {n:.0f}: {1e3 * s / n:.1f} ms a picture, {s / line - 1:+.0%} from the line")
    for (n, s), (m, r) in zip(
        zip(count[1:], seconds[1:], strict=True), zip(count, seconds, strict=False), strict=False
    ):
        print(f"  from {m:.0f} to {n:.0f}: {1e3 * (s - r) / (n - m):.1f} ms for each picture more")
    memory, base = np.polyfit(count, [cost.peak_mb for _, cost in rows], 1)
    print(f"peak memory = {base:.0f} MB + {1e3 * memory:.0f} kB x pictures")


if __name__ == "__main__":
    main()

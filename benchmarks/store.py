"""What the store's care costs: a fully cached run against `import numpy`, and `verify` against reading the disk.

Each figure is the least of several rounds in turn, so that a busy machine spoils neither side alone. Before `verify` and
before plain reading the files are put out of the system's cache, as far as it lets itself be told.

    python -m benchmarks.store [--rounds 7] [--frames 40]
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import yaml

ROOT = Path(__file__).resolve().parent.parent
SIZE = (1236, 1624)
BLOCK = 1 << 20


def process(words: Sequence[str | Path]) -> tuple[float, float]:
    """Wall and processor seconds of a process."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began = time.perf_counter()
    subprocess.run([sys.executable, *map(str, words)], cwd=ROOT, stdout=subprocess.DEVNULL, check=True)
    wall = time.perf_counter() - began
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def capture(folder: Path, frames: int) -> Path:
    """A capture whose pictures do not compress: noise of ten bits."""
    folder.mkdir()
    names = [("C", "X", "Y", "Z", "Xc", "Yc", "Zc")[i % 7] for i in range(frames)]
    description = {
        "format": "lightstage-capture/1",
        "session": folder.name,
        "bits": 10,
        "cameras": {"unpolarised": "CAM"},
        "bands_nm": [0],
        "files": "{frame:04d}.png",
        "frames": [{"illumination": name} for name in names],
    }
    (folder / "capture.yaml").write_text(yaml.safe_dump(description))
    generator = np.random.default_rng(0)
    for i in range(frames):
        picture = generator.integers(0, 1024, SIZE, np.uint16)
        cv2.imwrite(str(folder / f"{i:04d}.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 0])
    return folder


def forget(files: Sequence[Path]) -> None:
    """Put files out of the system's cache."""
    os.sync()
    for file in files:
        handle = os.open(file, os.O_RDONLY)
        os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_DONTNEED)
        os.close(handle)


def read_all(files: Sequence[Path]) -> float:
    """Seconds that plain reading takes, each file once."""
    began = time.perf_counter()
    for file in files:
        with open(file, "rb", buffering=0) as opened:
            while opened.read(BLOCK):
                pass
    return time.perf_counter() - began


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--frames", type=int, default=40)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as room:
        work = Path(room)
        pipeline = work / "pipeline.yaml"
        pipeline.write_text(
            "stages:\n  capture: {uses: capture}\n  register: {uses: register, from: capture}\n"
            "  split: {uses: split, from: register}\n"
        )
        start: tuple[str | Path, ...] = ("-m", "lightstage.cli.main", "--store", work / "store")
        process((*start, "import", capture(work / "noise", options.frames)))
        run = (*start, "run", "--session", "noise", "--pipeline", pipeline)
        process(run)
        numpy, cached, plain, verified = [], [], [], []
        files = sorted({p.stat().st_ino: p for p in (work / "store").rglob("*") if p.is_file()}.values())
        size = sum(file.stat().st_size for file in files)
        from lightstage.store.root import Store
        from lightstage.store.verify import verify

        for _ in range(options.rounds):
            numpy.append(process(("-c", "import numpy")))
            cached.append(process(run))
        for _ in range(max(3, options.rounds // 2)):
            forget(files)
            plain.append(read_all(files))
            forget(files)
            began = time.perf_counter()
            assert not verify(Store(work / "store")).damaged
            verified.append(time.perf_counter() - began)
        for i, what in enumerate(("wall", "processor")):
            ours, theirs = min(c[i] for c in cached), min(n[i] for n in numpy)
            print(
                f"cached run: {ours * 1e3:.0f} ms {what}, {ours / theirs:.2f} x `import numpy` ({theirs * 1e3:.0f} ms)"
            )
        print(
            f"verify: {size / 1e6:.0f} MB in {min(verified):.2f} s, {size / min(verified) / 1e6:.0f} MB/s, "
            f"{min(plain) / min(verified):.2f} x plain reading ({size / min(plain) / 1e6:.0f} MB/s)"
        )


if __name__ == "__main__":
    main()

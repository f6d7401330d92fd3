"""Content digests of every array of every node, so that a change that should move no number can show it.

`python -m benchmarks.contents > FILE` before the change and again after it; `diff` the two. It works in a store of
its own, on the virtual rig's head and on the rendered captures where they are. A digest is of decoded values,
dtype and shape, so that codecs, chunk names and the code that wrote them do not matter. About five minutes.
"""

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import xxhash
import zarr

RENDERED = Path(__file__).resolve().parents[2] / "shared" / "data" / "rendered"
STILL, MOVING = ("static_A",), ("dynamic_A_slow_minimal",)
CALIBRATIONS = {"mirrorball": ("lights",), "board_q1": ("camera", "homography")}
"""Captures of calibration targets, and the items that are measured from them."""
ALWAYS = ("normals", "upsample")
ASKED = ("relief", "reflectance", "shape", "stimulus", "chromophores", "specular", "gloss")


def lightstage(store: Path, *words: str) -> None:
    """Run the command on a store."""
    command = (str(Path(sys.executable).parent / "lightstage"), "--store", str(store), *words)
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def compute(store: Path) -> None:
    """Fill a store with every node of every capture."""
    lightstage(store, "demo")
    lightstage(store, "run", "--session", "demo", *ALWAYS, *ASKED)
    if not RENDERED.is_dir():
        print(f"{RENDERED} is absent: the virtual rig's head alone", file=sys.stderr)
        return
    for folder in STILL + MOVING:
        lightstage(store, "import", str(RENDERED / folder), "--session", folder)
        nodes = ALWAYS + (ASKED if folder in STILL else ("relief", "reflectance", "shape"))
        lightstage(store, "run", "--session", folder, *nodes)
    for folder, items in CALIBRATIONS.items():
        for item in items:
            lightstage(store, "calibrate", item, "--from", str(RENDERED / folder), "--session", f"{folder}-{item}")


def contents(store: Path) -> Iterator[str]:
    """A line per array: session, node, array, shape, dtype, digest."""
    for current in sorted((store / "results").glob("*/*/current")):
        node = current.parent
        group = zarr.open_group(node / current.read_text().strip(), mode="r")
        for name, array in sorted(group.arrays()):
            values = np.ascontiguousarray(array[...])
            plain = values.tobytes() if values.dtype.hasobject is False else repr(values.tolist()).encode()
            digest = xxhash.xxh3_128_hexdigest(plain)
            shape = "x".join(map(str, values.shape))
            yield f"{node.parent.name} {node.name} {name} {shape} {values.dtype} {digest}"


def main() -> None:
    """Print the digests."""
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder) / "store"
        compute(store)
        lines = list(contents(store))
        print("\n".join(lines))


if __name__ == "__main__":
    main()

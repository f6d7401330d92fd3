"""`python -m tests.whole_pipeline STORE SESSION OUT`: every node of pipeline.yaml, and what came out, as one .npz.

A process of its own, because a processor is settled when the libraries are loaded. Arrays are named NODE/ARRAY; the
normals that a node's kernel rounds for storage in Python are there before it too, as NODE/unrounded normal.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray
import yaml
from numpy.typing import NDArray

from cli.main import main
from stages import rig_normals, upsample
from tests.processors import REPOSITORY

PIPELINE = REPOSITORY / "pipeline.yaml"


def nodes() -> list[str]:
    """All nodes of pipeline.yaml but the source, in order."""
    stages = yaml.safe_load(PIPELINE.read_text(encoding="utf-8"))["stages"]
    return [name for name, node in stages.items() if "from" in node]


def _computed(store: Path, session: str) -> Iterator[tuple[str, NDArray[Any]]]:
    unrounded: list[NDArray[Any]] = []
    rounded = rig_normals.quantised

    def quantised(normal: NDArray[Any]) -> NDArray[np.int16]:
        unrounded.append(np.array(normal))
        return rounded(normal)

    rig_normals.quantised = upsample.quantised = quantised
    for node in nodes():
        words = ["run", node, "--session", session, "--pipeline", str(PIPELINE)]
        if main(["--store", str(store), *words]):
            raise SystemExit(1)
        if unrounded:
            yield f"{node}/unrounded normal", np.stack(unrounded)
            unrounded.clear()
        folder = store / "results" / session / node
        found = folder / (folder / "current").read_text(encoding="utf-8").strip()
        opened = xarray.open_zarr(found, chunks=None, mask_and_scale=False)
        yield from ((f"{node}/{name}", opened[name].values) for name in opened.data_vars)


if __name__ == "__main__":
    out = Path(sys.argv[3])
    np.savez(out, **dict(_computed(Path(sys.argv[1]), sys.argv[2])))

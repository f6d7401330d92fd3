"""`python -m tests.whole_pipeline STORE OUT SESSION...`: nodes of pipeline.yaml, and what came out, as one .npz.

A process of its own, because a processor is settled when the libraries are loaded. Every node of a still capture;
of a performance those that run unasked, since the others take its pictures as any. Arrays are named
SESSION/NODE/ARRAY; the normals that a node's kernel rounds for storage in Python are there before it too, as
SESSION/NODE/unrounded normal.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray
import yaml
from numpy.typing import NDArray

from lightstage.cli.main import main
from lightstage.kernels.normals import quantised
from tests.processors import REPOSITORY, performs

PIPELINE = REPOSITORY / "pipeline.yaml"


def nodes(session: str) -> list[str]:
    """Nodes of pipeline.yaml but the source, in order: all, or of a performance those that run unasked."""
    stages = yaml.safe_load(PIPELINE.read_text(encoding="utf-8"))["stages"]
    asked = not performs(session)
    return [name for name, node in stages.items() if "from" in node and (asked or node.get("when") != "asked")]


def _computed(store: Path, session: str) -> Iterator[tuple[str, NDArray[Any]]]:
    # by what they are stored as: blocks run in threads, in any order
    unrounded: dict[bytes, NDArray[Any]] = {}
    rounded = quantised.encode

    def encode(normal: NDArray[Any], valid: NDArray[np.bool_] | None = None) -> NDArray[np.int16]:
        stored = rounded(normal, valid)
        unrounded[stored.tobytes()] = np.array(np.moveaxis(normal, 0, 2))
        return stored

    quantised.encode = encode
    for node in nodes(session):
        words = ["run", node, "--session", session, "--pipeline", str(PIPELINE)]
        if main(["--store", str(store), *words]):
            raise SystemExit(1)
        folder = store / "results" / session / node
        found = folder / (folder / "current").read_text(encoding="utf-8").strip()
        opened = xarray.open_zarr(found, chunks=None, mask_and_scale=False)
        if unrounded:
            stored = opened["normal"].values
            blocks = stored.reshape(-1, *stored.shape[-3:])
            yield f"{session}/{node}/unrounded normal", np.stack([unrounded[block.tobytes()] for block in blocks])
            unrounded.clear()
        yield from ((f"{session}/{node}/{name}", opened[name].values) for name in opened.data_vars)


if __name__ == "__main__":
    store, out, *sessions = sys.argv[1:]
    np.savez(out, **{name: array for session in sessions for name, array in _computed(Path(store), session)})

"""capture: brings in a session.

The source of every pipeline. It computes nothing: its blocks are the session's pictures, by content.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from lightstage.dag.stage import Arrangement, Grid, Output, Params, Stage


class CaptureParams(Params):
    """Nothing to choose."""


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: CaptureParams) -> Arrangement:
    height, width = facts["shape"]
    frames, bands = len(facts["illumination"]), len(facts["bands_nm"])
    times = [float("nan") if t is None else float(t) for t in facts["time_s"]]
    sizes = {
        "frame": frames,
        "band": bands,
        "polarisation": len(facts["polarisation"]),
        "y": height,
        "x": width,
    }
    labels: dict[str, tuple[tuple[str, ...], Sequence[Any]]] = {
        "illumination": (("frame",), list(facts["illumination"])),
        "time_s": (("frame",), times),
        "band": (("band",), [float(b) for b in facts["bands_nm"]]),
        "polarisation": (("polarisation",), list(facts["polarisation"])),
    }
    return Arrangement(Grid(sizes, labels, {"units": "counts"}))


STAGE = Stage(
    name="capture",
    version=1,
    summary="brings in a session",
    params=CaptureParams,
    outputs={"raw": Output(("frame", "band", "polarisation", "y", "x"), "uint16")},
    blocks=("frame", "band"),
    arrange=_arrange,
    units={"band": "nm", "time_s": "s"},
    places={
        "frame": lambda i, labels: f"frame {i} ({labels['illumination']})",
        "band": lambda _, labels: f"{labels['band']:g} nm" if labels["band"] else "",
    },
)

"""summed: the sum over all frames of a band."""

from collections.abc import Mapping, Sequence
from typing import Any

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Output, Params, Stage


class SummedParams(Params):
    """Nothing to choose."""


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: SummedParams) -> Arrangement:
    (above,) = grids
    frames, bands = above.sizes["frame"], above.sizes["band"]
    groups = tuple(Group({"value": {i: {"frame": i, "band": b} for i in range(frames)}}) for b in range(bands))
    names = ("band", "polarisation")
    sizes = {name: above.sizes[name] for name in (*names, "y", "x")}
    return Arrangement(Grid(sizes, {name: above.labels[name] for name in names}), groups)


STAGE = Stage(
    name="summed",
    version=1,
    summary="the sum over frames",
    params=SummedParams,
    inputs={"value": Input("value", ("frame", "band", "polarisation", "y", "x"), "group")},
    outputs={"total": Output(("band", "polarisation", "y", "x"), "float32", ("polarisation", "y", "x"))},
    blocks=("band",),
    arrange=_arrange,
    kernel="tests.store.tiny.kernels:summed",
)

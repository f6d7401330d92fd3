"""scaled: counts x gain / exposure, picture by picture."""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import Field

from lightstage.dag.stage import Arrangement, Grid, Input, Items, Needs, Output, Params, Stage


class ScaledParams(Params):
    """What counts are multiplied with."""

    gain: float = Field(1.0, description="factor")


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: ScaledParams) -> Arrangement:
    return Arrangement(Grid(grids[0].sizes, grids[0].labels))


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: ScaledParams
) -> dict[str, Any]:
    return {"exposure": items["bands"]["bands"][0]["exposure"] if "bands" in items else 1.0}


DIMS = ("frame", "band", "polarisation", "y", "x")
STAGE = Stage(
    name="scaled",
    version=1,
    summary="counts by exposure",
    params=ScaledParams,
    inputs={"raw": Input("raw", DIMS)},
    outputs={"value": Output(DIMS, "float32", ("polarisation", "y", "x"))},
    blocks=("frame", "band"),
    calibration={"bands": Needs(why="exposures")},
    arrange=_arrange,
    context=_context,
    prepared=("exposure",),
    kernel="tests.store.tiny.kernels:scaled",
)

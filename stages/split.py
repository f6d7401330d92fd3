"""split: diffuse and specular components from the two polarisations.

    I_parallel = I_D / 2 + I_S        I_cross = I_D / 2
    I_D = 2 I_cross                   I_S = I_parallel - I_cross

Specular values below zero are noise and are kept: clipping them would bias every average. Their fraction is
in the result's attributes. With one camera there is no split: `cross` alone gives the diffuse component;
`parallel` or unpolarised light alone gives `total`, which is named as what it is.

Must have run before: register. Source: Ma et al. (2007) section 3; Dutta (2010) 3.2.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from lightstage.dag.stage import Arrangement, Grid, Input, Items, Output, Params, Stage


class SplitParams(Params):
    """Nothing to choose."""


def components(polarisations: Sequence[str]) -> tuple[str, ...]:
    """What can be made from these polarisations."""
    if "cross" not in polarisations:
        return ("total",)
    return ("diffuse", "specular") if "parallel" in polarisations else ("diffuse",)


_CANNOT = {
    "cross": "specular: needs the parallel camera",
    "parallel": "diffuse and specular: need the cross camera; total = diffuse / 2 + specular",
    "unpolarised": "diffuse and specular: need both polarisations; total = diffuse + specular",
}


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: SplitParams
) -> dict[str, Any]:
    return {"polarisations": list(facts["polarisation"])}


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: SplitParams) -> Arrangement:
    (registered,) = grids
    polarisations = facts["polarisation"]
    names = components(polarisations)
    sizes = {"component" if k == "polarisation" else k: v for k, v in registered.sizes.items()}
    sizes["component"] = len(names)
    labels = {k: v for k, v in registered.labels.items() if k != "polarisation"}
    labels["component"] = (("component",), list(names))
    attrs = {"units": "counts"}
    if len(polarisations) == 1:
        attrs["cannot_be_made"] = _CANNOT[polarisations[0]]
    return Arrangement(Grid(sizes, labels, attrs))


STAGE = Stage(
    name="split",
    version=1,
    summary="diffuse and specular components",
    params=SplitParams,
    remarks=("cannot_be_made",),
    inputs={"signal": Input("signal", ("frame", "band", "polarisation", "y", "x"))},
    outputs={"signal": Output(("frame", "band", "component", "y", "x"), "float32", attrs={"units": "counts"})},
    blocks=("frame", "band"),
    arrange=_arrange,
    context=_context,
    prepared=("polarisations",),
    kernel="lightstage.kernels.pictures.components:split",
)

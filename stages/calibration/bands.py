"""bands: counts per unit of reflectance under every filter, from a white or grey target.

Exposure, transmission and source are one product here, and their product is all that the bands item is used for.
Where the same pictures show a ColorChecker, its patches tell how well the scale holds (published reflectances:
`hw/color_checker.py`).

Must have run before: capture. Source: those of `kernels/targets/band_scale.py`.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import Field

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Needs, Output, Params, Stage, StageError
from lightstage.hw import color_checker
from lightstage.stages.calibration.session import need_target, reference, reference_camera, stored_picture


class BandsParams(Params):
    """Parameters of `bands`."""

    reflectance: float = Field(0.0, ge=0, le=1, description="of the target in all bands; 0: as the capture says")


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: BandsParams) -> Arrangement:
    (raw,) = grids
    target = need_target(facts, "white", "measuring the bands")
    centres = list(raw.along("band"))
    given = params.reflectance or target.get("reflectance")
    if not given:
        raise StageError(
            "the white target's reflectance is not known; write target: {kind: white, reflectance: 0.99} (or one a "
            "band), or --set bands.reflectance=0.99"
        )
    values = [float(given)] * len(centres) if isinstance(given, int | float) else [float(v) for v in given]
    if len(values) != len(centres):
        raise StageError(f"the target names {len(values)} reflectances for {len(centres)} bands")
    camera = reference(raw)
    pictures = {nm: {"frame": 0, "band": b, "polarisation": camera} for b, nm in enumerate(centres)}
    sizes = {
        "all": 1,
        "band": len(centres),
        "patch": len(color_checker.NAMES),
        "y": raw.sizes["y"],
        "x": raw.sizes["x"],
    }
    labels = {"band": (("band",), centres), "patch": (("patch",), list(color_checker.NAMES))}
    return Arrangement(Grid(sizes, labels), (Group({"raw": pictures}, {"reflectances": values}),))


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: BandsParams
) -> dict[str, Any]:
    camera = reference_camera(facts)
    flat = stored_picture(items, "flat", camera)
    if flat is not None:
        flat["dark_included"] = items["flat"]["dark_included"]
    return {
        "target_reflectance": labels["reflectances"],
        "white_level": facts["white_level"],
        "dark": stored_picture(items, "dark", camera),
        "flat": flat,
    }


STAGE = Stage(
    name="bands",
    version=1,
    summary="counts per unit of reflectance under every filter",
    params=BandsParams,
    inputs={"raw": Input("raw", ("frame", "band", "polarisation", "y", "x"), "group")},
    calibration={
        "dark": Needs(why="the dark stays in the counts"),
        "flat": Needs(why="vignetting stays in the counts"),
    },
    outputs={
        "scale": Output(("all", "band"), "float64", ("band",), {"units": "counts"}),
        "scale_se": Output(("all", "band"), "float64", ("band",), {"units": "counts"}),
        "unevenness": Output(("all", "band"), "float64", ("band",), {"units": "1"}),
        "patches": Output(("all", "patch", "band"), "float64", ("patch", "band"), {"units": "reflectance"}),
        "target": Output(("all", "y", "x"), "bool"),
    },
    blocks=("all",),
    arrange=_arrange,
    context=_context,
    prepare="lightstage.kernels.targets.bands:prepare",
    prepared=("target_reflectance", "white_level", "dark_picture", "flat_picture"),
    kernel="lightstage.kernels.targets.bands:bands",
    item="lightstage.kernels.targets.bands:item",
    verdict="lightstage.kernels.targets.bands:verdict",
)

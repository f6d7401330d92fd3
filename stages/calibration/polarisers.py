"""polarisers: how each light's polariser is turned, from a ball at three polariser angles or more.

Frames carry `polariser_deg`; every light (L00 ...) is seen at each angle.

Must have run before: outline, highlights. Limits: a metal ball turns polarisation itself at grazing incidence, so a
dielectric one (black plastic) should be used. Sources: Dutta (2010) 3.2.1, and those of
`kernels/targets/polariser_fit.py`.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import Field

from lightstage.dag.stage import (
    Arrangement,
    Grid,
    Group,
    Input,
    Items,
    Name,
    Needs,
    Output,
    Params,
    Stage,
    StageError,
)
from lightstage.hw.illuminations import light_name, light_number
from lightstage.stages.calibration.session import (
    exposures_s,
    light_numbers,
    need_target,
    parts,
    reference,
    reference_camera,
    single_lights,
    stored_picture,
)


class PolarisersParams(Params):
    """Parameters of `polarisers`."""

    aperture_px: float = Field(2.5, gt=0, description="radius of the aperture around a highlight")
    electrons_per_count: float = Field(10.0, gt=0, description="of the sensor, for the weights")
    read_noise_counts: float = Field(1.0, ge=0, description="of the sensor, for the weights")


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: PolarisersParams) -> Arrangement:
    raw, _, outline = grids
    need_target(facts, "mirror_ball", "measuring the polarisers")
    names = list(raw.along("illumination"))
    angles = facts.get("polariser_deg", [None] * len(names))
    frames = [i for i in single_lights(raw) if angles[i] is not None]
    if not frames:
        raise StageError(
            "measuring the polarisers needs frames with polariser_deg: each light (L00 ...) at three angles or more"
        )
    if outline.sizes["part"] > 1 or any(parts(facts, len(names))[i] for i in frames):
        raise StageError("measuring the polarisers needs the ball at one place; measure each place by itself")
    pictures: dict[tuple[int, float], int] = {}
    for i in frames:
        name = light_number(names[i]), float(angles[i])
        if name in pictures:
            raise StageError(
                f"{names[i]} has two pictures at {name[1]:g} degrees (frames {pictures[name]} and {i}); keep one"
            )
        pictures[name] = i
    camera = reference(raw)
    highlight: dict[Name, dict[str, int]] = {name: {"frame": i} for name, i in pictures.items()}
    reads: dict[str, dict[Name, dict[str, int]]] = {
        "raw": {name: {"frame": i, "band": 0, "polarisation": camera} for name, i in pictures.items()},
        "at_px": highlight,
        "peak": highlight,
        "ring": {0: {"part": 0}},
    }
    times = exposures_s(facts, len(names))
    numbers = light_numbers([names[i] for i in frames])
    distinct = sorted({angle for _, angle in pictures})
    sizes = {"all": 1, "light": len(numbers), "angle": len(distinct)}
    labels: dict[str, Any] = {
        "light": (("light",), [light_name(number) for number in numbers]),
        "angle": (("angle",), distinct),
    }
    return Arrangement(Grid(sizes, labels), (Group(reads, {"exposure": [times[i] or 1.0 for i in frames]}),))


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: PolarisersParams
) -> dict[str, Any]:
    return {
        "exposure": labels["exposure"],
        "white_level": facts["white_level"],
        "material": facts["target"].get("material", "metal"),
        "dark": stored_picture(items, "dark", reference_camera(facts)),
    }


STAGE = Stage(
    name="polarisers",
    version=1,
    summary="how each light's polariser is turned",
    params=PolarisersParams,
    inputs={
        "raw": Input("raw", ("frame", "band", "polarisation", "y", "x"), "group", 0),
        "at_px": Input("at_px", ("frame", "spot", "xy"), "group", 1),
        "peak": Input("peak", ("frame", "spot"), "group", 1),
        "ring": Input("ring", ("part", "point", "xy"), "group", 2),
    },
    calibration={"dark": Needs(why="the dark is taken from around each highlight")},
    outputs={
        **{
            name: Output(("all", "light"), "float64", ("light",), {"units": "degrees"})
            for name in ("theta0_deg", "least_deg", "theta0_se_deg", "incidence_deg")
        },
        **{name: Output(("all", "light"), "float64", ("light",)) for name in ("residual", "residual_se")},
        "grazing": Output(("all", "light"), "bool", ("light",)),
        "intensity": Output(("all", "light", "angle"), "float64", ("light", "angle"), {"units": "counts"}),
    },
    blocks=("all",),
    arrange=_arrange,
    context=_context,
    prepare="lightstage.kernels.targets.polarisers:prepare",
    prepared=("exposure", "material", "sensor", "aperture"),
    kernel="lightstage.kernels.targets.polarisers:polarisers",
    item="lightstage.kernels.targets.polarisers:item",
    verdict="lightstage.kernels.targets.polarisers:verdict",
)

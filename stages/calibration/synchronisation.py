"""synchronisation: which lights lit each frame of a test sequence, leaks and frames out of order.

The capture shows a mirror ball: one picture per light (L00 ...), one without light (O), and the sequence under test
(T0 to T3 by turns, each a quarter of the lights).

Must have run before: highlights. Limits: patterns that repeat every four steps cannot tell a shift by four from
none. Source: Dutta (2010) 3.1.3, and those of `kernels/targets/sync_check.py`.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import Field

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Name, Output, Params, Stage, StageError
from lightstage.hw.illuminations import DARK, is_test, light_name, light_number
from lightstage.kernels.targets.labels import TEST_PATTERNS
from lightstage.stages.calibration.session import (
    frames_of,
    light_numbers,
    need_target,
    reference,
    single_lights,
)


class SynchronisationParams(Params):
    """Parameters of `synchronisation`."""

    aperture_px: float = Field(2.5, gt=0, description="radius of the aperture around a highlight")
    electrons_per_count: float = Field(10.0, gt=0, description="of the sensor, for the standard errors")
    read_noise_counts: float = Field(1.0, ge=0, description="of the sensor, for the standard errors")


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: SynchronisationParams) -> Arrangement:
    raw, _ = grids
    need_target(facts, "mirror_ball", "checking the synchronisation")
    camera = reference(raw)
    names = list(raw.along("illumination"))
    single, unlit = single_lights(raw), frames_of(raw, DARK)
    tests = [i for i, name in enumerate(names) if is_test(name)]
    if not single or not unlit or len(tests) < 2:
        raise StageError(
            "checking the synchronisation needs one picture per light (L00 ...), one without light (O) and the "
            f"sequence T0 T1 T2 T3 ...; this capture has {len(single)}, {len(unlit)} and {len(tests)} of them"
        )
    numbers = [light_number(names[i]) for i in single]
    if numbers != light_numbers(names):
        raise StageError("each light needs one picture, in the order of their numbers (L00, L01, ...)")

    def at(i: int) -> dict[str, int]:
        return {"frame": i, "band": 0, "polarisation": camera}

    reads: dict[str, dict[Name, dict[str, int]]] = {
        "one_light": {number: at(i) for number, i in zip(numbers, single, strict=True)},
        "unlit": {unlit[0]: at(unlit[0])},
        "test": {(i, names[i]): at(i) for i in tests},
        "at_px": {number: {"frame": i} for number, i in zip(numbers, single, strict=True)},
    }
    sizes = {"all": 1, "frame": len(tests), "light": len(single)}
    labels: dict[str, Any] = {
        "frame": (("frame",), tests),
        "light": (("light",), [light_name(number) for number in numbers]),
    }
    return Arrangement(Grid(sizes, labels), (Group(reads),))


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: SynchronisationParams
) -> dict[str, Any]:
    return {"white_level": facts["white_level"]}


STAGE = Stage(
    name="synchronisation",
    version=1,
    summary="which lights lit each frame of a test",
    params=SynchronisationParams,
    inputs={
        **dict.fromkeys(
            ("one_light", "unlit", "test"), Input("raw", ("frame", "band", "polarisation", "y", "x"), "group", 0)
        ),
        "at_px": Input("at_px", ("frame", "spot", "xy"), "group", 1),
    },
    outputs={
        **{
            name: Output(("all", "frame"), "int64", ("frame",), {"meanings": " ".join(TEST_PATTERNS)})
            for name in ("found", "declared")
        },
        "step": Output(("all", "frame"), "int64", ("frame",)),
        "wrong": Output(("all", "frame"), "bool", ("frame",)),
        **{
            f"{name}_percent": Output(("all", "frame"), "float64", ("frame",), {"units": "percent"})
            for name in ("leak_before", "leak_after", "leak_se", "unexplained")
        },
        "drive": Output(("all", "frame", "light"), "float64", ("frame", "light")),
    },
    blocks=("all",),
    arrange=_arrange,
    context=_context,
    prepare="lightstage.kernels.targets.synchronisation:prepare",
    prepared=("white_level", "aperture"),
    kernel="lightstage.kernels.targets.synchronisation:synchronisation",
    verdict="lightstage.kernels.targets.synchronisation:verdict",
)

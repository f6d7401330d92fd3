"""synchronisation: which lights lit each frame of a test sequence, leaks and frames out of order.

The capture shows a mirror ball: one picture per light (L00 ...), one without light (O), and the sequence under test
(T0 to T3 by turns, each a quarter of the lights). The kernel is in `sync_check.py`.

Must have run before: highlights. Limits: patterns that repeat every four steps cannot tell a shift by four from
none. Source: Dutta (2010) 3.1.3, and those of the kernels.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lightstage.dag.stage import (
    Arrangement,
    Finding,
    Grid,
    Group,
    Input,
    Items,
    Output,
    Params,
    Result,
    Stage,
    StageError,
)
from lightstage.kernels.targets.photometry import highlight_sums, variance
from lightstage.kernels.targets.sync_check import align, check
from lightstage.stages.calibration.session import frames_of, light_numbers, need_target, reference

PATTERNS = ("T0", "T1", "T2", "T3", "O")


class SynchronisationParams(Params):
    """Parameters of `synchronisation`."""

    aperture_px: float = Field(2.5, gt=0, description="radius of the aperture around a highlight")
    electrons_per_count: float = Field(10.0, gt=0, description="of the sensor, for the standard errors")
    read_noise_counts: float = Field(1.0, ge=0, description="of the sensor, for the standard errors")


def synchronisation(
    raw: Sequence[NDArray[np.uint16]],
    at_px: Sequence[NDArray[np.float64]],
    *,
    declared: Sequence[str],
    lights: Sequence[int],
    white_level: int,
    aperture_px: float = 2.5,
    electrons_per_count: float = 10.0,
    read_noise_counts: float = 1.0,
) -> Mapping[str, Any]:
    """Judge a test sequence.

    Args:
        raw: (y, x) counts: the one-light pictures, the picture without light, the sequence.
        at_px: (spot, xy) of the one-light pictures.
        declared: what the sequence should show, a name of PATTERNS each.
        lights: numbers of the one-light pictures.
        white_level: the count at which the sensor saturates.

    Returns:
        by frame of the sequence; see the declaration.
    """
    count = len(lights)
    positions = np.stack([np.asarray(spot)[0, ::-1] for spot in at_px])
    ground = np.asarray(raw[count], np.float64)
    knobs: dict[str, Any] = {"dark": ground, "white": white_level, "radius_px": aperture_px}
    one_light, _ = highlight_sums(np.stack([np.asarray(raw[i]) for i in range(count)]), positions, **knobs)
    sums, full = highlight_sums(
        np.stack([np.asarray(raw[i]) for i in range(count + 1, len(raw))]), positions, **knobs
    )
    sums = np.where(full, np.nan, sums)
    spread = variance(
        sums, radius_px=aperture_px, electrons_per_count=electrons_per_count, read_noise_counts=read_noise_counts
    )
    numbers = np.asarray(lights)
    patterns = {f"T{k}": (numbers % 4 == k).astype(float) for k in range(4)} | {"O": np.zeros(count)}
    found = check(sums, one_light, declared, patterns, variance=spread)
    return {
        "found": np.array([PATTERNS.index(name) for name in found.found]),
        "declared": np.array([PATTERNS.index(name) for name in declared]),
        "step": found.step,
        "wrong": found.wrong,
        "leak_before_percent": found.leak_before_percent,
        "leak_after_percent": found.leak_after_percent,
        "leak_se_percent": found.leak_se_percent,
        "unexplained_percent": found.unexplained_percent,
        "drive": found.drive,
    }


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: SynchronisationParams) -> Arrangement:
    raw, _ = grids
    need_target(facts, "mirror_ball", "checking the synchronisation")
    camera = reference(raw)
    names = list(raw.along("illumination"))
    single, unlit = frames_of(raw, "L"), frames_of(raw, "O")
    tests = [i for i, name in enumerate(names) if name in PATTERNS[:4]]
    if not single or not unlit or len(tests) < 2:
        raise StageError(
            "checking the synchronisation needs one picture per light (L00 ...), one without light (O) and the "
            f"sequence T0 T1 T2 T3 ...; this capture has {len(single)}, {len(unlit)} and {len(tests)} of them"
        )
    numbers = [int(names[i][1:]) for i in single]
    if numbers != light_numbers(names):
        raise StageError("each light needs one picture, in the order of their numbers (L00, L01, ...)")
    pieces = [{"frame": i, "band": 0, "polarisation": camera} for i in (*single, unlit[0], *tests)]
    reads = {"raw": pieces, "at_px": [{"frame": i} for i in single]}
    sizes = {"all": 1, "frame": len(tests), "light": len(single)}
    labels: dict[str, Any] = {
        "frame": (("frame",), tests),
        "light": (("light",), [f"L{n:02d}" for n in numbers]),
    }
    told = {"declared": [names[i] for i in tests], "lights": numbers}
    return Arrangement(Grid(sizes, labels), (Group(reads, told),))


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: SynchronisationParams
) -> dict[str, Any]:
    return {"declared": labels["declared"], "lights": labels["lights"], "white_level": facts["white_level"]}


def _verdict(result: Result) -> list[Finding]:
    found = [PATTERNS[k] for k in result.arrays["found"]]
    declared = [PATTERNS[k] for k in result.arrays["declared"]]
    _, events = align(found, declared)
    findings = [Finding("bad", event.says) for event in events]
    if not findings:
        findings = [Finding("good", f"all {len(found)} frames show what was meant, in order")]
    for side, name in (("before", "the illumination before"), ("after", "the illumination after")):
        leak = result.arrays[f"leak_{side}_percent"]
        if np.isfinite(leak).any():
            error = float(np.nanmedian(result.arrays["leak_se_percent"]))
            sentence = (
                f"{float(np.nanmedian(leak)):.2f} % of the light is of {name} (median; worst "
                f"{float(np.nanmax(leak)):.2f} %, each +- {error:.2f})"
            )
            findings.append(Finding("good", sentence))
    return findings


STAGE = Stage(
    name="synchronisation",
    version=1,
    summary="which lights lit each frame of a test",
    params=SynchronisationParams,
    inputs={
        "raw": Input("raw", ("frame", "band", "polarisation", "y", "x"), "group", 0),
        "at_px": Input("at_px", ("frame", "spot", "xy"), "group", 1),
    },
    outputs={
        **{
            name: Output(("all", "frame"), "int64", ("frame",), {"meanings": " ".join(PATTERNS)})
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
    prepared=("declared", "lights", "white_level"),
    kernel=synchronisation,
    verdict=_verdict,
)

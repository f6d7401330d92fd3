"""polarisers: how each light's polariser is turned, from a ball at three polariser angles or more.

Frames carry `polariser_deg`; every light (L00 ...) is seen at each angle. The kernel is in `polariser_fit.py`.

Must have run before: outline, highlights. Limits: a metal ball turns polarisation itself at grazing incidence, so a
dielectric one (black plastic) should be used. Sources: Dutta (2010) 3.2.1, and those of the kernel.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

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
    Needs,
    Output,
    Params,
    Result,
    Stage,
    StageError,
)
from lightstage.kernels.targets.photometry import highlight_sums, variance
from lightstage.kernels.targets.polariser_fit import GRAZING_DEG, fit_polarisers
from lightstage.stages.calibration.session import frames_of, light_numbers, need_target, parts, reference


class PolarisersParams(Params):
    """Parameters of `polarisers`."""

    aperture_px: float = Field(2.5, gt=0, description="radius of the aperture around a highlight")
    electrons_per_count: float = Field(10.0, gt=0, description="of the sensor, for the weights")
    read_noise_counts: float = Field(1.0, ge=0, description="of the sensor, for the weights")


def polarisers(
    raw: Sequence[NDArray[np.uint16]],
    at_px: Sequence[NDArray[np.float64]],
    peak: Sequence[NDArray[np.float64]],
    ring: Sequence[NDArray[np.float64]],
    *,
    row: Sequence[int],
    angle_deg: Sequence[float],
    exposure: Sequence[float],
    white_level: int,
    material: Literal["metal", "dielectric"],
    dark_picture: NDArray[np.float64] | None,
    aperture_px: float = 2.5,
    electrons_per_count: float = 10.0,
    read_noise_counts: float = 1.0,
) -> Mapping[str, Any]:
    """Fit every light.

    Args:
        raw: (y, x) counts, one a light and angle.
        at_px, peak: of the same pictures.
        ring: one, (point, xy): the ball's outline.
        row: of the light, per picture.
        angle_deg: of the polariser, per picture.
        exposure: relative, per picture: sums are divided by it.
        white_level: the count at which the sensor saturates.
        material: of the ball.
        dark_picture: (y, x), counts.

    Returns:
        by light; see the declaration.
    """
    count = 1 + max(row)
    angles = sorted(set(angle_deg))
    rows = np.asarray(row)
    positions = np.full((count, 2), np.nan)
    for k in range(count):
        mine = np.flatnonzero(rows == k)
        best = max(mine.tolist(), key=lambda i: -1.0 if np.isnan(peak[i][0]) else float(peak[i][0]))
        positions[k] = np.asarray(at_px[best])[0, ::-1]  # the brightest angle places it best
    dark = np.zeros(raw[0].shape) if dark_picture is None else dark_picture
    # relative to the light's own mean, so that counts stay counts and their noise is known
    times = np.asarray(exposure, float)
    usual = np.array([times[rows == k].mean() for k in range(count)])
    sums = np.full((count, len(angles)), np.nan)
    full = np.zeros(sums.shape, np.bool_)
    for i, (k, angle) in enumerate(zip(row, angle_deg, strict=True)):
        if np.isnan(positions[k]).any():
            continue
        value, saturated = highlight_sums(
            np.asarray(raw[i])[None], positions[k : k + 1], dark=dark, white=white_level, radius_px=aperture_px
        )
        column = angles.index(angle)
        sums[k, column] = value[0, 0] * usual[k] / times[i]
        full[k, column] = saturated[0, 0]
    outline = np.asarray(ring[0])
    centre, radius = outline.mean(axis=0), float(np.sqrt(np.prod(np.ptp(outline, axis=0)))) / 2
    away = np.linalg.norm(positions[:, ::-1] - centre, axis=1) / radius
    incidence = np.degrees(np.arcsin(np.clip(away, 0, 1)))
    floor = float(
        variance(
            np.zeros(1), radius_px=aperture_px, electrons_per_count=electrons_per_count,
            read_noise_counts=read_noise_counts,
        )[0]
    )  # fmt: skip
    fit = fit_polarisers(
        sums, np.asarray(angles, float), saturated=full, incidence_deg=incidence, ball=material,
        electrons_per_count=electrons_per_count, floor_counts2=floor,
    )  # fmt: skip
    return {
        "theta0_deg": fit.theta0_deg,
        "least_deg": fit.least_deg,
        "residual": fit.residual,
        "theta0_se_deg": fit.theta0_se_deg,
        "residual_se": fit.residual_se,
        "grazing": fit.grazing,
        "intensity": np.where(full, np.nan, sums),
        "incidence_deg": incidence,
    }


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: PolarisersParams) -> Arrangement:
    raw, _, outline = grids
    need_target(facts, "mirror_ball", "measuring the polarisers")
    names = list(raw.along("illumination"))
    angles = facts.get("polariser_deg", [None] * len(names))
    frames = [i for i in frames_of(raw, "L") if angles[i] is not None]
    if not frames:
        raise StageError(
            "measuring the polarisers needs frames with polariser_deg: each light (L00 ...) at three angles or more"
        )
    if outline.sizes["part"] > 1 or any(parts(facts, len(names))[i] for i in frames):
        raise StageError("measuring the polarisers needs the ball at one place; measure each place by itself")
    numbers = light_numbers([names[i] for i in frames])
    times = facts.get("exposure_s", [None] * len(names))
    camera = reference(raw)
    reads = {
        "raw": [{"frame": i, "band": 0, "polarisation": camera} for i in frames],
        "at_px": [{"frame": i} for i in frames],
        "peak": [{"frame": i} for i in frames],
        "ring": [{"part": 0}],
    }
    told: dict[str, Any] = {
        "row": [numbers.index(int(names[i][1:])) for i in frames],
        "angle_deg": [float(angles[i]) for i in frames],
        "exposure": [float(times[i] or 1.0) for i in frames],
    }
    distinct = sorted(set(told["angle_deg"]))
    sizes = {"all": 1, "light": len(numbers), "angle": len(distinct)}
    labels: dict[str, Any] = {
        "light": (("light",), [f"L{n:02d}" for n in numbers]),
        "angle": (("angle",), distinct),
    }
    return Arrangement(Grid(sizes, labels), (Group(reads, told),))


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: PolarisersParams
) -> dict[str, Any]:
    camera = facts["cameras"].get("cross") or next(iter(facts["cameras"].values()))
    known = "dark" in items and camera in items["dark"]["pictures"]
    return {
        "row": labels["row"],
        "angle_deg": labels["angle_deg"],
        "exposure": labels["exposure"],
        "white_level": facts["white_level"],
        "material": facts["target"].get("material", "metal"),
        "dark": items["dark"]["pictures"][camera] if known else None,
        "dark_scale": items["dark"]["scale"] if known else 1.0,
    }


def _prepare(*, dark: Any, dark_scale: float, **rest: Any) -> Mapping[str, Any]:
    picture = None if dark is None else np.asarray(dark.load(), np.float64) / dark_scale
    return {**rest, "dark_picture": picture}


def _item(result: Result) -> Mapping[str, Any]:
    """The polarisers item: lights with a fit."""
    rows = [
        {"id": name, "angle_deg": round(float(least) % 180, 3), "residual": round(max(float(rest), 0.0), 5)}
        for name, least, rest in zip(
            result.labels["light"], result.arrays["least_deg"], result.arrays["residual"], strict=True
        )
        if np.isfinite(least)
    ]
    return {"item": "polarisers", "lights": rows}


def _verdict(result: Result) -> list[Finding]:
    names = list(result.labels["light"])
    residual, error = result.arrays["residual"], result.arrays["theta0_se_deg"]
    seen = np.isfinite(residual)
    worst = int(np.nanargmax(residual))
    sentence = (
        f"{int(seen.sum())} of {len(names)} lights: at the right angle {float(np.nanmedian(residual)):.2%} of the "
        f"highlight remains (median; most at {names[worst]}, {float(residual[worst]):.2%}); angles are known to "
        f"{float(np.nanmedian(error)):.2f} degrees (median)"
    )
    findings = [Finding("good", sentence)]
    vague = [name for name, e in zip(names, error, strict=True) if e > 0.5]
    if vague:
        sentence = f"{', '.join(vague)}: too weak to place the polariser within 0.5 degrees; expose longer"
        findings.append(Finding("doubtful", sentence))
    grazing = [name for name, g in zip(names, result.arrays["grazing"], strict=True) if g]
    if grazing:
        sentence = (
            f"{', '.join(grazing)} strike the metal ball at more than {GRAZING_DEG:g} degrees: their residual is "
            "partly the metal's and their angle not that of skin; use a plastic ball"
        )
        findings.append(Finding("doubtful", sentence))
    return findings


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
    prepare=_prepare,
    prepared=("row", "angle_deg", "exposure", "white_level", "material", "dark_picture"),
    kernel=polarisers,
    item=_item,
    verdict=_verdict,
)

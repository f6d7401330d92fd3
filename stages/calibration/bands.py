"""bands: counts per unit of reflectance under every filter, from a white or grey target.

The kernels are in `band_scale.py`. Exposure, transmission and source are one product here, and their product is all
that the bands item is used for. Where the same pictures show a ColorChecker, its patches tell how well the scale
holds (published reflectances: `hw/color_checker.py`).

Must have run before: capture. Source: those of the kernels.
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
    Needs,
    Output,
    Params,
    Result,
    Stage,
    StageError,
)
from lightstage.hw import color_checker
from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.band_scale import (
    band_scale,
    checker_reflectance,
    find_checker,
    find_target,
    response_of,
)
from lightstage.stages.calibration.session import need_target, reference

_UNEVEN = 0.05
"""Part by which a target may be lit unevenly before its mean is in doubt."""
_NEAR_NM = 8.0
"""A band this near to one of the table's is compared with it."""


class BandsParams(Params):
    """Parameters of `bands`."""

    reflectance: float = Field(0.0, ge=0, le=1, description="of the target in all bands; 0: as the capture says")


def bands(
    raw: Sequence[NDArray[np.uint16]],
    *,
    band_nm: Sequence[float],
    target_reflectance: Sequence[float],
    white_level: int,
    dark_picture: NDArray[np.float64] | None,
    flat_picture: NDArray[np.float64] | None,
) -> Mapping[str, Any]:
    """Scale of every band.

    Args:
        raw: (y, x) counts, one a band.
        band_nm: their centres.
        target_reflectance: of the target, one a band.
        white_level: the count at which the sensor saturates.
        dark_picture, flat_picture: (y, x) counts, dark included; None when not known.

    Returns:
        `scale`, `scale_se`, `unevenness` (band); `patches` (patch, band), NaN without a ColorChecker.

    Raises:
        StageError: no target, or it is saturated or dark.
    """
    shape = raw[0].shape
    dark = np.zeros(shape) if dark_picture is None else dark_picture
    response = np.ones(shape) if flat_picture is None else response_of(flat_picture, dark)
    pictures = np.stack([np.asarray(picture) for picture in raw])
    target = find_target(((pictures - dark) / response).mean(axis=0))
    found = band_scale(
        pictures, np.asarray(target_reflectance, float), target, dark=dark, response=response, white=white_level
    )
    patches = np.full((24, len(raw)), np.nan)
    visible = [i for i, nm in enumerate(band_nm) if 400 < nm < 720]
    if len(visible) >= 3:
        corrected = ((pictures - dark) / response) / found.scale[:, None, None]
        order = sorted(visible, key=lambda i: band_nm[i])
        try:
            outlines = find_checker(corrected, red=order[-1], green=order[len(order) // 2], blue=order[0])
            patches = checker_reflectance(corrected, outlines)
        except KernelError:
            pass  # most captures show none
    return {
        "scale": found.scale,
        "scale_se": found.scale_se,
        "unevenness": found.unevenness,
        "patches": patches,
        "target": target,
    }


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
    pieces = [{"frame": 0, "band": b, "polarisation": camera} for b in range(len(centres))]
    sizes = {"all": 1, "band": len(centres), "patch": 24, "y": raw.sizes["y"], "x": raw.sizes["x"]}
    labels = {"band": (("band",), centres), "patch": (("patch",), list(color_checker.NAMES))}
    told = {"centres": centres, "reflectances": values}
    return Arrangement(Grid(sizes, labels), (Group({"raw": pieces}, told),))


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: BandsParams
) -> dict[str, Any]:
    camera = facts["cameras"].get("cross") or next(iter(facts["cameras"].values()))
    context: dict[str, Any] = {
        "band_nm": labels["centres"],
        "target_reflectance": labels["reflectances"],
        "white_level": facts["white_level"],
    }
    for kind in ("dark", "flat"):
        known = kind in items and camera in items[kind]["pictures"]
        context[kind] = items[kind]["pictures"][camera] if known else None
        context[f"{kind}_scale"] = items[kind]["scale"] if known else 1.0
    context["dark_included"] = bool("flat" in items and items["flat"]["dark_included"])
    return context


def _prepare(
    *, band_nm: Any, target_reflectance: Any, white_level: int, dark: Any, dark_scale: float, flat: Any,
    flat_scale: float, dark_included: bool,
) -> Mapping[str, Any]:  # fmt: skip
    ground = None if dark is None else np.asarray(dark.load(), np.float64) / dark_scale
    even = None if flat is None else np.asarray(flat.load(), np.float64) / flat_scale
    if even is not None and not dark_included and ground is not None:
        even = even + ground
    return {
        "band_nm": band_nm,
        "target_reflectance": target_reflectance,
        "white_level": white_level,
        "dark_picture": ground,
        "flat_picture": even,
    }


def _item(result: Result) -> Mapping[str, Any]:
    """The bands item."""
    widths = {}
    if "bands" in result.items:
        widths = {b["centre_nm"]: b["width_nm"] for b in result.items["bands"]["bands"]}
    return {
        "item": "bands",
        "bands": [
            {
                "centre_nm": float(nm),
                "width_nm": widths.get(nm),
                "exposure": float(scale),
                "transmission": 1.0,
                "source": 1.0,
            }
            for nm, scale in zip(result.labels["band"], result.arrays["scale"], strict=True)
        ],
    }


def _verdict(result: Result) -> list[Finding]:
    findings = []
    for i, nm in enumerate(result.labels["band"]):
        scale, error = float(result.arrays["scale"][i]), float(result.arrays["scale_se"][i])
        uneven = float(result.arrays["unevenness"][i])
        measured = f"{nm:g} nm: {scale:.2f} +- {error:.2f} counts per unit reflectance, uneven by {uneven:.1%}"
        if uneven > _UNEVEN:
            findings.append(Finding("doubtful", f"{measured}: light it more evenly"))
        else:
            findings.append(Finding("good", measured))
    patches = result.arrays["patches"]
    if np.isfinite(patches).any():
        table = np.asarray(color_checker.BANDS_NM, float)
        errors = []
        for i, nm in enumerate(result.labels["band"]):
            k = int(np.argmin(np.abs(table - nm)))
            if abs(table[k] - nm) <= _NEAR_NM:
                errors.append(patches[:, i] - color_checker.REFLECTANCE[:, k])
        if errors:
            off = np.stack(errors, axis=1)
            worst = int(np.nanargmax(np.abs(off).max(axis=1)))
            sentence = (
                f"ColorChecker: off by {float(np.sqrt(np.nanmean(off**2))):.4f} in reflectance (root mean square), "
                f"most at {color_checker.NAMES[worst]} ({float(np.abs(off[worst]).max()):.3f})"
            )
            findings.append(Finding("good", sentence))
    if "dark" not in result.items:
        findings.append(Finding("doubtful", "no dark item is bound: the counts hold the dark"))
    return findings


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
    prepare=_prepare,
    prepared=("band_nm", "target_reflectance", "white_level", "dark_picture", "flat_picture"),
    kernel=bands,
    item=_item,
    verdict=_verdict,
)

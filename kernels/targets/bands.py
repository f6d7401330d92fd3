"""Counts per unit of reflectance, from a white or grey target: the kernel of `stages/calibration/bands.py`.

The estimate is in `band_scale.py`, the ColorChecker's published reflectances in `hw/color_checker.py`.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.hw import color_checker
from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.band_scale import (
    band_scale,
    checker_reflectance,
    find_checker,
    find_target,
    response_of,
)
from lightstage.kernels.targets.item_pictures import counts_of
from lightstage.kernels.targets.verdicts import Verdict

Array = NDArray[np.float64]
_UNEVEN = 0.05
"""Part by which a target may be lit unevenly before its mean is in doubt."""
_NEAR_NM = 8.0
"""A band this near to one of the table's is compared with it."""
_VISIBLE_NM = (400, 720)
"""Bands between these can stand for red, green and blue."""


def bands(
    raw: Mapping[float, NDArray[np.uint16]],
    *,
    target_reflectance: Sequence[float],
    white_level: int,
    dark_picture: Array | None,
    flat_picture: Array | None,
) -> Mapping[str, Any]:
    """Scale of every band.

    Args:
        raw: (y, x) counts by band, nm.
        target_reflectance: of the target, one a band.
        white_level: the count at which the sensor saturates.
        dark_picture, flat_picture: (y, x) counts, dark included; None when not known.

    Returns:
        `scale`, `scale_se`, `unevenness` (band); `patches` (patch, band), NaN without a ColorChecker; `target`
        (y, x), where it is.

    Raises:
        KernelError: no target, or it is saturated or dark.
    """
    pictures = np.stack([np.asarray(picture) for picture in raw.values()])
    shape = pictures.shape[1:]
    dark = np.zeros(shape) if dark_picture is None else dark_picture
    response = np.ones(shape) if flat_picture is None else response_of(flat_picture, dark)
    even = (pictures - dark) / response
    target = find_target(even.mean(axis=0))
    fit = band_scale(
        pictures, np.asarray(target_reflectance, float), target, dark=dark, response=response, white=white_level
    )
    return {
        "scale": fit.scale,
        "scale_se": fit.scale_se,
        "unevenness": fit.unevenness,
        "patches": _patches(even / fit.scale[:, None, None], list(raw)),
        "target": target,
    }


def _patches(reflectance: Array, band_nm: Sequence[float]) -> Array:
    """Reflectance (patch, band) of a ColorChecker in pictures (band, y, x); NaN without one."""
    none = np.full((len(color_checker.NAMES), len(band_nm)), np.nan)
    low, high = _VISIBLE_NM
    visible = sorted((i for i, nm in enumerate(band_nm) if low < nm < high), key=lambda i: band_nm[i])
    if len(visible) < 3:
        return none
    try:
        outlines = find_checker(reflectance, red=visible[-1], green=visible[len(visible) // 2], blue=visible[0])
        return checker_reflectance(reflectance, outlines)
    except KernelError:
        return none  # most captures show none


def prepare(
    *,
    target_reflectance: Sequence[float],
    white_level: int,
    dark: Mapping[str, Any] | None,
    flat: Mapping[str, Any] | None,
) -> Mapping[str, Any]:
    """The context in numbers."""
    ground, even = counts_of(dark), counts_of(flat)
    if flat is not None and even is not None and ground is not None and not flat["dark_included"]:
        even = even + ground
    return {
        "target_reflectance": target_reflectance,
        "white_level": white_level,
        "dark_picture": ground,
        "flat_picture": even,
    }


def item(
    *, arrays: Mapping[str, Any], labels: Mapping[str, Any], items: Mapping[str, Mapping[str, Any]]
) -> Mapping[str, Any]:
    """The bands item; widths are those of the one that is bound."""
    widths = {}
    if "bands" in items:
        widths = {band["centre_nm"]: band["width_nm"] for band in items["bands"]["bands"]}
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
            for nm, scale in zip(labels["band"], arrays["scale"], strict=True)
        ],
    }


def verdict(
    *, arrays: Mapping[str, Any], labels: Mapping[str, Any], items: Mapping[str, Mapping[str, Any]]
) -> Verdict:
    """The scale of every band, how evenly the target was lit, and how well a ColorChecker is met."""
    findings: Verdict = []
    for i, nm in enumerate(labels["band"]):
        scale, error = float(arrays["scale"][i]), float(arrays["scale_se"][i])
        uneven = float(arrays["unevenness"][i])
        measured = f"{nm:g} nm: {scale:.2f} +- {error:.2f} counts per unit reflectance, uneven by {uneven:.1%}"
        if uneven > _UNEVEN:
            findings.append(("doubtful", f"{measured}: light it more evenly"))
        else:
            findings.append(("good", measured))
    findings += _checker(arrays["patches"], labels["band"])
    if "dark" not in items:
        findings.append(("doubtful", "no dark item is bound: the counts hold the dark"))
    return findings


def _checker(patches: Array, band_nm: Sequence[float]) -> Verdict:
    """How far a ColorChecker's patches (patch, band) are from what is published."""
    if not np.isfinite(patches).any():
        return []
    table, published = np.asarray(color_checker.BANDS_NM, float), np.array(color_checker.REFLECTANCE)
    errors = []
    for i, nm in enumerate(band_nm):
        k = int(np.argmin(np.abs(table - nm)))
        if abs(table[k] - nm) <= _NEAR_NM:
            errors.append(patches[:, i] - published[:, k])
    if not errors:
        return []
    off = np.stack(errors, axis=1)
    worst = int(np.nanargmax(np.abs(off).max(axis=1)))
    sentence = (
        f"ColorChecker: off by {float(np.sqrt(np.nanmean(off**2))):.4f} in reflectance (root mean square), "
        f"most at {color_checker.NAMES[worst]} ({float(np.abs(off[worst]).max()):.3f})"
    )
    return [("good", sentence)]

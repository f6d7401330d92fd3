"""Melanin and haemoglobin from reflectance: the models and the fit are in `stages/chromophores.py`.

Sources: Dawson et al. (1980), doi:10.1088/0031-9155/25/4/008, and Takiwaki et al. (1994) for optical density of
skin as a sum over pigments; Stamatas and Kollias (2004), doi:10.1117/1.1647545, for baseline and oxygenation;
Lawson and Hanson (1974) for least squares that are not negative.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.appearance import absorption, skin_layers
from lightstage.kernels.appearance.pigment_maps import MAPS, OXYGEN_BANDS, OXYGEN_MAPS

Image = NDArray[np.float32]
Array = NDArray[np.float64]
_AT_ONCE = 1 << 15
"""Pixels: they bound the memory, and a pixel's result does not depend on them."""
_DARKEST = 2.0
"""Standard errors: where a band has less its logarithm is noise, and the band is left out there."""


def chromophores(
    reflectance: Image,
    standard_error: Image,
    *,
    passing: Array,
    model: str,
    saturation: float,
    model_error: float,
    vessel_radius_um: float,
    oxygenation_error: float,
) -> Mapping[str, Any]:
    """Fit every pixel of one tracking frame.

    Args:
        reflectance: (band, y, x), NaN where not valid. standard_error: of it, by noise, same shape.
        passing: (band, nm), pass bands over `absorption.NM`.
        model, saturation, model_error, vessel_radius_um, oxygenation_error: see ChromophoresParams.

    Returns:
        `melanin`, `haemoglobin`, `baseline`, `residual`, `melanin_standard_error`, `haemoglobin_standard_error`,
        and with `beer_lambert` and five or more bands `oxygenation`, `oxygenation_standard_error`: (y, x)
        float32. NaN where fewer than three bands are valid. Standard errors are by the noise of the pictures, as
        if nothing were held at zero; that of oxygenation has model_error in it. `stats` holds the condition
        number of the unknowns' spectra, each scaled to length 1, and the median residual; `warnings` says so
        where the subject's median spectrum is not that of skin.
    """
    bands, height, width = reflectance.shape
    spectra = _spectra(passing, saturation)
    logs = None
    if model == "kubelka_munk":
        logs = -np.log(
            skin_layers.dermis(
                skin_layers.VOLUMES, passing, saturation=saturation, vessel_radius_um=vessel_radius_um
            )
        )
    oxygen = logs is None and bands >= OXYGEN_BANDS
    names = [*MAPS, *(OXYGEN_MAPS if oxygen else ())]
    maps = {name: np.full(height * width, np.nan, np.float32) for name in names}
    # in float64: the residual is a small difference of logarithms
    value, noise = (np.asarray(a, np.float64).reshape(bands, -1) for a in (reflectance, standard_error))
    with np.errstate(invalid="ignore"):
        usable = np.isfinite(value) & np.isfinite(noise) & (value > np.maximum(_DARKEST * noise, 0))
    places = np.flatnonzero(usable.sum(axis=0) >= 3)
    for start in range(0, len(places), _AT_ONCE):
        pixels = places[start : start + _AT_ONCE]
        seen = usable[:, pixels].T
        rho = np.where(seen, value[:, pixels].T, 1.0)
        variance = np.where(seen, (noise[:, pixels].T / rho) ** 2, 0.0)
        weight = np.where(seen, 1 / (variance + model_error**2), 0.0)
        if logs is None:
            solved, design = _beer_lambert(-np.log(rho), weight, spectra)
            fit = solved @ spectra.T
        else:
            solved, design, fit = _kubelka_munk(-np.log(rho), weight, spectra[:, 0], logs)
        error = _noise_errors(design, weight, variance)
        off = np.where(seen, -np.log(rho) - fit, 0.0)
        maps["residual"][pixels] = np.sqrt((off**2).sum(axis=1) / seen.sum(axis=1))
        for i, name in enumerate(("melanin", "haemoglobin", "baseline")):
            maps[name][pixels] = solved[:, i]
        for i, name in enumerate(("melanin_standard_error", "haemoglobin_standard_error")):
            maps[name][pixels] = error[:, i]
        if oxygen:
            enough = seen.sum(axis=1) >= OXYGEN_BANDS
            share, share_error = _oxygenation(-np.log(rho), weight, passing)
            maps["oxygenation_standard_error"][pixels[enough]] = share_error[enough]
            certain = enough & (share_error <= oxygenation_error)
            maps["oxygenation"][pixels[certain]] = share[certain]
    whole = places[usable[:, places].all(axis=0)]
    return {
        **{name: maps[name].reshape(height, width) for name in names},
        "stats": _stats(maps, spectra, oxygen),
        "warnings": _doubts(value[:, whole], passing, saturation, vessel_radius_um),
    }


def prepare(*, bands: Sequence[Mapping[str, Any]], pass_band: absorption.PassBand) -> Mapping[str, Any]:
    """The pass bands of entries of a bands item."""
    return {"passing": absorption.pass_bands(bands, pass_band)}


def predicted(
    melanin: Array,
    haemoglobin: Array,
    baseline: Array,
    *,
    passing: Array,
    model: str,
    saturation: float,
    vessel_radius_um: float,
) -> Array:
    """Reflectance (point, band) by the model, of maps as `chromophores` gives them, (point,) each."""
    if model == "beer_lambert":
        depths = np.stack([melanin, haemoglobin, baseline], axis=1)
        return np.asarray(np.exp(-depths @ _spectra(passing, saturation).T))
    below = skin_layers.dermis(haemoglobin, passing, saturation=saturation, vessel_radius_um=vessel_radius_um)
    above = melanin[:, None] * _spectra(passing, saturation)[:, 0] + baseline[:, None]
    return np.asarray(below * np.exp(-above))


def _spectra(passing: Array, saturation: float) -> Array:
    """(band, unknown): eps of melanin and of haemoglobin, and the baseline's 1."""
    blood = absorption.haemoglobin(saturation)
    columns = (passing @ absorption.melanin(), passing @ blood / absorption.reference(blood))
    return np.stack([*columns, np.ones(len(passing))], axis=1)


def _beer_lambert(depth: Array, weight: Array, spectra: Array) -> tuple[Array, Array]:
    """Non-negative least squares, the last unknown free: (pixel, unknown), and the design (band, unknown).

    Every set of unknowns held at zero is solved; the best of those that come out non-negative is the minimum,
    because the problem is convex and its minimum is the free one of its own set.
    """
    count = spectra.shape[1]
    best = np.full(len(depth), np.inf)
    amounts = np.zeros((len(depth), count))
    for size in range(count):
        for kept in combinations(range(count - 1), size):
            columns = [*kept, count - 1]
            part = spectra[:, columns]
            solved = _solve(part, weight, depth)
            cost = (weight * (depth - solved @ part.T) ** 2).sum(axis=1)
            better = (solved[:, :-1] >= 0).all(axis=1) & (cost < best)
            best[better] = cost[better]
            amounts[better] = 0
            amounts[np.ix_(better, columns)] = solved[better]
    return amounts, spectra


def _kubelka_munk(depth: Array, weight: Array, melanin: Array, logs: Array) -> tuple[Array, Array, Array]:
    """M, v, baseline (pixel, 3); the design (pixel, band, 3) there; the fit (pixel, band).

    With p = depth - logs_j and w = weight / sum weight, the mean and the slope of p over melanin's spectrum are
    sums of products of w, depth and logs_j, so the cost at every j is a few matrix products.
    """
    share = weight / weight.sum(axis=1, keepdims=True)
    middle = share @ melanin
    spread = share @ melanin**2 - middle**2
    centred = share * (melanin - middle[:, None])
    mean = (share * depth).sum(axis=1)[:, None] - share @ logs.T
    slope = ((centred * depth).sum(axis=1)[:, None] - centred @ logs.T) / spread[:, None]
    square = (share * depth**2).sum(axis=1)[:, None] - 2 * (share * depth) @ logs.T + share @ (logs**2).T
    cost = square - mean**2 - np.maximum(slope, 0) ** 2 * spread[:, None]
    best = cost.argmin(axis=1)
    inner = np.clip(best, 1, len(logs) - 2)
    rows = np.arange(len(depth))
    before, at, after = (cost[rows, inner + step] for step in (-1, 0, 1))
    bend = before - 2 * at + after
    with np.errstate(invalid="ignore", divide="ignore"):
        shift = np.where(bend > 0, 0.5 * (before - after) / bend, 0.0)
    place = np.where(best == inner, inner + np.clip(shift, -1, 1), best)
    lower = np.minimum(place.astype(int), len(logs) - 2)
    part = (place - lower)[:, None]
    below = (1 - part) * logs[lower] + part * logs[lower + 1]
    volumes = skin_layers.VOLUMES
    step = volumes[lower + 1] - volumes[lower]
    rest = depth - below
    amounts = np.empty((len(depth), 3))
    amounts[:, 0] = np.maximum((centred * rest).sum(axis=1) / spread, 0)
    amounts[:, 1] = volumes[lower] + part[:, 0] * step
    amounts[:, 2] = (share * rest).sum(axis=1) - amounts[:, 0] * middle
    design = np.ones((*depth.shape, 3))
    design[..., 0] = melanin
    design[..., 1] = (logs[lower + 1] - logs[lower]) / step[:, None]
    return amounts, design, amounts[:, :1] * melanin + below + amounts[:, 2:]


def _normal(design: Array, weight: Array) -> Array:
    """A' W A of every pixel; `design` is (band, unknown), or (pixel, band, unknown)."""
    if design.ndim == 2:
        products = design[:, :, None] * design[:, None, :]
        return np.asarray(np.tensordot(weight, products, 1))
    return np.asarray(np.swapaxes(design, 1, 2) @ (weight[..., None] * design))


def _solve(design: Array, weight: Array, depth: Array) -> Array:
    right = (weight * depth) @ design
    return np.asarray(np.linalg.solve(_normal(design, weight), right[..., None])[..., 0])


def _noise_errors(design: Array, weight: Array, variance: Array) -> Array:
    """Standard errors (pixel, unknown) by the pictures' noise: N^-1 A' W V W A N^-1, N = A' W A."""
    inverse = np.linalg.inv(_normal(design, weight))
    spread = inverse @ _normal(design, weight * weight * variance) @ inverse
    return np.asarray(np.sqrt(np.diagonal(spread, axis1=1, axis2=2)))


def _oxygenation(depth: Array, weight: Array, passing: Array) -> tuple[Array, Array]:
    """oxy / (oxy + deoxy) of every pixel and its standard error, with weights that are not held at zero."""
    scale = absorption.reference(absorption.haemoglobin(0.75))
    bound, free = (passing @ absorption.haemoglobin(s) / scale for s in (1.0, 0.0))
    design = np.stack([passing @ absorption.melanin(), bound, free, np.ones(len(passing))], axis=1)
    known = (weight > 0).sum(axis=1) >= OXYGEN_BANDS
    weight = np.where(known[:, None], weight, 1.0)
    both = _beer_lambert(depth, weight, design)[0][:, 1:3]
    inverse = np.linalg.inv(_normal(design, weight))[:, 1:3, 1:3]
    total = both.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = both[:, 0] / total
        turn = np.stack([both[:, 1], -both[:, 0]], axis=1) / total[:, None] ** 2
        error = np.sqrt(np.einsum("pi,pij,pj->p", turn, inverse, turn))
    error = np.where(total > 0, error, np.nan)
    return np.asarray(share), np.asarray(error)


def _stats(maps: Mapping[str, Image], spectra: Array, oxygen: bool) -> dict[str, float]:
    known = np.isfinite(maps["residual"])
    stats = {
        "condition_number": float(np.linalg.cond(spectra / np.linalg.norm(spectra, axis=0))),
        "median_residual": float(np.median(maps["residual"][known])) if known.any() else float("nan"),
    }
    if oxygen and known.any():
        resolved = np.isfinite(maps["oxygenation"][known])
        stats["oxygenation_known_fraction"] = float(resolved.mean())
    return stats


def _doubts(spectra: Array, passing: Array, saturation: float, vessel_radius_um: float) -> list[str]:
    if not spectra.size:
        return ["no pixel is valid in all bands, so whether the subject is skin was not looked at"]
    likeness = skin_layers.likeness(
        np.median(spectra, axis=1).astype(np.float64),
        passing,
        saturation=saturation,
        vessel_radius_um=vessel_radius_um,
    )
    return [] if likeness.doubt is None else [likeness.doubt]

"""stack: frames to illuminations, and counts to radiance, so that bands compare.

    radiance = signal / (exposure x transmission x source x intensity)

A static capture becomes (illumination, band, component, y, x); an illumination that was captured several
times is averaged. A performance (one with a frame rate) keeps its frames. Without a `bands` item the scale is
1 and the result says that it is in counts.

Must have run before: split. Source: Dutta (2010) 3.3.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Needs, Output, Params, Stage, StageError

KEPT_BITS = 16
"""Of the mantissa's 23: a relative step of 1.5e-5, as fine at 256 counts as the counts that it is made of (Kloewer
et al. 2021, doi:10.1038/s43588-021-00156-2). Random digits cost half as much again to store."""
_HALF_BIT = np.uint32(1 << (22 - KEPT_BITS))
_MASK = np.uint32(0xFFFFFFFF ^ ((1 << (23 - KEPT_BITS)) - 1))


class StackParams(Params):
    """Nothing to choose."""


def stack(signal: Sequence[NDArray[np.float32]], *, counts_per_radiance: float) -> Mapping[str, Any]:
    """Average the pictures of one illumination and band, and scale them to radiance.

    Args:
        signal: pictures (component, y, x), counts; NaN where not valid.
        counts_per_radiance: exposure x transmission x source x intensity.

    Returns:
        `radiance` (component, y, x) float32. A point that is not valid in one of the pictures is the mean of
        the others; NaN where none is valid.
    """
    scale = np.float32(1 / counts_per_radiance)
    if len(signal) == 1:
        return {"radiance": _rounded(signal[0] * scale)}
    total = np.zeros(signal[0].shape, np.float32)
    count = np.zeros(signal[0].shape, np.float32)
    for picture in signal:
        seen = picture == picture
        np.add(total, picture, out=total, where=seen)
        count += seen
    with np.errstate(invalid="ignore", divide="ignore"):
        return {"radiance": _rounded((total / count * scale).astype(np.float32))}


@njit(nogil=True, cache=True)
def _rounded(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Round to KEPT_BITS of the mantissa, halves up; NaN stays NaN."""
    out = np.empty_like(values)
    source, target = values.reshape(-1), out.reshape(-1)
    bits, rounded = source.view(np.uint32), target.view(np.uint32)
    for i in range(source.size):
        if source[i] == source[i]:
            rounded[i] = (bits[i] + _HALF_BIT) & _MASK
        else:
            target[i] = np.float32(np.nan)
    return out


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: StackParams
) -> dict[str, Any]:
    scale = 1.0
    band = labels["band"]
    if "bands" in items:
        entries = {entry["centre_nm"]: entry for entry in items["bands"]["bands"]}
        if band not in entries:
            have = ", ".join(f"{centre:g}" for centre in entries)
            raise StageError(f"the bands item has no band at {band:g} nm (it has {have})")
        entry = entries[band]
        scale = entry["exposure"] * entry["transmission"] * entry["source"]
    intensity = facts["intensities"].get(labels["illumination"])
    if intensity is not None:
        scale *= intensity[facts["bands_nm"].index(band)]
    return {"counts_per_radiance": scale}


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: StackParams) -> Arrangement:
    (parts,) = grids
    illumination = list(parts.along("illumination"))
    if facts["frame_rate_hz"] is not None:
        dim, frames = "frame", [[i] for i in range(len(illumination))]
    else:
        dim = "illumination"
        frames = [
            [i for i, name in enumerate(illumination) if name == kind] for kind in dict.fromkeys(illumination)
        ]
    bands = list(parts.along("band"))
    sizes = {dim: len(frames), **{k: v for k, v in parts.sizes.items() if k != "frame"}}
    labels: dict[str, tuple[tuple[str, ...], Sequence[Any]]] = {
        "illumination": ((dim,), [illumination[members[0]] for members in frames]),
        "frame": ((dim,), [members[0] for members in frames]),
        "band": (("band",), bands),
        "component": parts.labels["component"],
    }
    if dim == "frame":
        labels["time_s"] = parts.labels["time_s"]
    groups = tuple(
        Group(
            {"signal": [{"frame": i, "band": b} for i in members]},
            {"illumination": illumination[members[0]], "band": band},
        )
        for members in frames
        for b, band in enumerate(bands)
    )
    attrs = {k: v for k, v in parts.attrs.items() if k == "cannot_be_made"}
    return Arrangement(Grid(sizes, labels, attrs), groups, {"illumination|frame": dim})


STAGE = Stage(
    name="stack",
    version=1,
    summary="frames to illuminations, counts to radiance",
    params=StackParams,
    remarks=("cannot_be_made",),
    inputs={"signal": Input("signal", ("frame", "band", "component", "y", "x"), "group")},
    calibration={"bands": Needs(why="radiance is in counts, and bands do not compare")},
    outputs={
        "radiance": Output(
            ("illumination|frame", "band", "component", "y", "x"),
            "float32",
            attrs={"units": "radiance", "mantissa_bits": KEPT_BITS},
        )
    },
    blocks=("illumination|frame", "band"),
    arrange=_arrange,
    context=_context,
    prepared=("counts_per_radiance",),
    kernel=stack,
)

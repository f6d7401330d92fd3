"""stack: frames to illuminations, and counts to radiance, so that bands compare.

    radiance = signal / (exposure x transmission x source x intensity)

A static capture becomes (illumination, band, component, y, x); an illumination that was captured several times is
averaged, weighted by its exposures: under shot noise the inverse of a picture's variance is its exposure.
Exposures that frames name count in units of the one that most have, which the `bands` item holds for. A
performance (one with a frame rate) keeps its frames. Without a `bands` item the scale is 1 and the result says
that it is in counts.

Must have run before: split. Source: Dutta (2010) 3.3.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Needs, Output, Params, Stage, StageError
from lightstage.hw.illuminations import relative_exposures
from lightstage.kernels.encodings import RADIANCE_BITS


class StackParams(Params):
    """Nothing to choose."""


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
    return {"counts_per_radiance": scale, "exposure": _exposures(facts, labels["members"])}


def _exposures(facts: Mapping[str, Any], members: Sequence[int]) -> list[float] | None:
    """Of each picture, in units of the exposure that most have; None where frames name none, or all the same."""
    named = facts.get("exposure_s")
    if named is None:
        return None
    silent = [i for i, exposure_s in enumerate(named) if exposure_s is None]
    if silent:
        raise StageError(
            f"frame {silent[0]} names no exposure_s, and others do; name it for all frames, or for none"
        )
    shares = relative_exposures(named)
    return [shares[i] for i in members] if set(shares) != {1.0} else None


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
            {"signal": {i: {"frame": i, "band": b} for i in members}},
            {"illumination": illumination[members[0]], "band": band, "members": members},
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
            attrs={"units": "radiance", "mantissa_bits": RADIANCE_BITS},
        )
    },
    blocks=("illumination|frame", "band"),
    arrange=_arrange,
    context=_context,
    prepared=("counts_per_radiance", "exposure"),
    kernel="lightstage.kernels.pictures.radiance:stack",
)

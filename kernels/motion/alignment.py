"""The pictures of a tracking frame's set, brought to the tracking frame: the equations are in `stages/align.py`.

Sources: Wilson et al. (2010), ACM TOG 29(2); Dutta (2010) chapters 4 and 5.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lightstage.hw.illuminations import CONSTANT
from lightstage.kernels.motion import joint_flow, picture_flow
from lightstage.kernels.motion.band_ways import BandWays, find_band_ways, still_bands
from lightstage.kernels.motion.engines import Engine, find_ways
from lightstage.kernels.motion.flow_warp import seen, warp
from lightstage.kernels.motion.misfits import (
    leave_out_contradicted,
    leave_out_foreign,
    leave_out_misplaced,
    same_scene,
)
from lightstage.kernels.motion.shots import DOUBTED, LOST, UNKNOWN, Image, Member, Shot, Shots
from lightstage.kernels.pictures.noise import noise_model
from lightstage.kernels.pictures.picture_sets import pairs


def align(
    radiance: Mapping[tuple[int, float], Image],
    *,
    shots: Mapping[str, Any],
    engine: str,
    bands: str,
    reference_band: int,
    flow: picture_flow.Method,
    iterations: int,
    middle: str,
) -> Mapping[str, Any]:
    """Align the set of one tracking frame.

    Args:
        radiance: pictures (component, y, x) by frame and band (nm), NaN where not valid: those of the set, and of
            the tracking frames beside it.
        shots: which they are, as plain data: see `Shots.of`.
        engine, flow, iterations, middle: how flows are found: see `AlignParams` and `engines.Engine`.
        bands: none, or what the bands are brought together by.
        reference_band: number of the band that the others are brought to.

    Returns:
        `flow` (member, xy, y, x), pixels: aligned(x) = member(x + flow(x)); `aligned` (member, band, component, y,
        x), NaN where not known; `confidence` (member, y, x), 0 to 1; `residual` (y, x), the mean over the set's
        pairs of |r_a + r_a' - c| after alignment, over bands, in radiance of the first component. `stats` has
        its mean before and after alignment, relative to c. `warnings` name pictures that do not belong to the set.
        With `bands`, `band_flow` (band, xy, y, x) and `band_confidence` (band, y, x) of the flows g_b, on the grid
        of the reference band, `stats` has what each was found from, and `warnings` name bands that show nothing to
        be aligned by, which stay as they are. Of shots that are `apart` flow, aligned and confidence alone,
        without the dimension member.
    """
    known = Shots.of(shots)
    if known.apart:
        return _unmoved(radiance)
    taken = {place: _taken(radiance, shot, known) for place, shot in known.filled.items()}
    beside = [_taken(radiance, shot, known) for shot in known.around]
    across = still_bands(len(known.bands_nm))
    if bands != "none":
        # the tracking frame last: of several pictures under constant light it is the one
        order = sorted(taken, key=lambda place: place == known.tracking)
        across = find_band_ways(
            {known.filled[place].illumination: taken[place] for place in order},
            known,
            bands=bands,
            reference=reference_band,
            still=engine == "none" and not known.moving,
        )
    pictures = _one_band(
        [across.moved(picture, components=1) for picture in [*taken.values(), *beside]],
        [shot.illumination for shot in known.filled.values()],
    )
    members = {
        place: Member.unmoved(place, shot, taken[place], picture)
        for (place, shot), picture in zip(known.filled.items(), pictures, strict=False)
    }
    constant = members.pop(known.tracking)
    others = list(members.values())
    warnings = list(across.warnings)
    if engine != "none":
        steady = list(zip(known.around, pictures[len(taken) :], strict=True))
        warnings += _find_motion(constant, others, steady, Engine(engine, flow, iterations, middle))
    elif known.moving:
        for member in others:
            member.confidence *= UNKNOWN
    outputs = _brought(constant, others, known, across, moved=engine != "none")
    outputs["residual"], stats = _residual(constant, others, outputs["aligned"])
    return {**outputs, **across.results, "stats": {**stats, **across.stats}, "warnings": warnings}


def _unmoved(radiance: Mapping[tuple[int, float], Image]) -> Mapping[str, Any]:
    """One picture of a still subject, as a block of its own: (component, y, x) of each band."""
    picture = np.stack(list(radiance.values()))
    confidence = np.isfinite(picture).any(axis=(0, 1)).astype(np.float32)
    return {"flow": np.zeros((2, *picture.shape[2:]), np.float32), "aligned": picture, "confidence": confidence}


def _taken(radiance: Mapping[tuple[int, float], Image], shot: Shot, shots: Shots) -> list[Image]:
    """A picture, band by band."""
    return [radiance[shot.frame, band] for band in shots.bands_nm]


def _one_band(pictures: Sequence[Sequence[Image]], illuminations: Sequence[str]) -> list[Image]:
    """The first component of each picture, the mean over its bands by their signal to noise.

    Args:
        pictures: of each picture its bands; those of the set first. illuminations: of those.
    """
    first = [[band[0] for band in picture] for picture in pictures]
    if len(first[0]) == 1:
        return [picture[0] for picture in first]
    weights = np.zeros(len(first[0]), np.float32)
    for b in range(len(weights)):
        by_name = {name: picture[b] for name, picture in zip(illuminations, first, strict=False)}
        lit = by_name.get(CONSTANT, first[0][b])
        if np.isfinite(lit).any():
            alpha, beta = noise_model(by_name)
            level = max(float(np.nanmedian(lit)), 0.0)
            weights[b] = level / (alpha + beta * level + 1e-30)
    if not weights.any():
        return [picture[0] for picture in first]
    weights /= weights.sum()
    used = np.flatnonzero(weights)
    return [np.asarray(np.tensordot(weights[used], np.stack([p[b] for b in used]), 1), np.float32) for p in first]


def _find_motion(
    constant: Member, members: Sequence[Member], beside: Sequence[tuple[Shot, Image]], engine: Engine
) -> list[str]:
    """Give each member its flow and its confidence; sentences on those that do not belong to the set.

    Args:
        constant: the tracking frame. members: the others of its set.
        beside: the tracking frames before and after it that are no members.
    """
    warnings = leave_out_misplaced(constant, members)
    steady = [(shot, picture) for shot, picture in beside if same_scene(picture, constant.picture)]
    kept = [member for member in members if not member.left_out]
    for member, way in zip(kept, find_ways(constant.picture, kept, steady, engine), strict=True):
        member.flow = way.flow
        member.confidence = np.maximum(np.float32(1) / (np.float32(1) + way.doubt_px * way.doubt_px), DOUBTED)
    moved = {member.place: warp(member.picture, member.flow) for member in kept}
    for leave_out in (leave_out_foreign, leave_out_contradicted):
        warnings += leave_out(constant, moved, kept)
        kept = [member for member in kept if not member.left_out]
    for member in kept:
        member.confidence *= seen(member.flow)
    for member in (constant, *members):
        if member.left_out:
            member.confidence = np.zeros_like(member.confidence)
            member.flow = np.full_like(member.flow, np.nan)
    return warnings


def _brought(
    constant: Member, members: Sequence[Member], shots: Shots, across: BandWays, *, moved: bool
) -> dict[str, Image]:
    """All pictures of the set along their flows, in their places; NaN in those that are not filled."""
    shape = constant.picture.shape
    count, bands, components = len(shots.members), len(shots.bands_nm), len(shots.components)
    flow = np.full((count, 2, *shape), np.nan, np.float32)
    aligned = np.full((count, bands, components, *shape), np.nan, np.float32)
    confidence = np.zeros((count, *shape), np.float32)
    for member in (constant, *members):
        flow[member.place] = member.flow
        picture = aligned[member.place]
        picture[:] = across.moved(member.bands, member.flow if moved and member is not constant else None)
        if moved:
            picture[..., member.confidence <= LOST] = np.nan
        visible = np.isfinite(picture).any(axis=(0, 1))
        confidence[member.place] = np.where(visible, member.confidence, np.float32(0))
    return {"flow": flow, "aligned": aligned, "confidence": confidence}


def _residual(constant: Member, members: Sequence[Member], aligned: Image) -> tuple[Image, dict[str, float]]:
    """Mean |r_a + r_a' - c| (y, x) over pairs and bands, and its mean relative to c, before and after alignment."""
    shape = aligned.shape[-2:]
    couples = [(members[i], members[j]) for i, j in pairs([member.illumination for member in members])]
    if not couples or not constant.is_constant:
        return np.full(shape, np.nan, np.float32), {}
    after = np.zeros(shape, np.float32)
    before = np.zeros(shape, np.float32)
    level = np.zeros(shape, np.float32)
    for b in range(aligned.shape[1]):
        level += aligned[constant.place, b, 0] * len(couples)
        for gradient, complement in couples:
            before += np.abs(gradient.bands[b][0] + complement.bands[b][0] - constant.bands[b][0])
            pair = aligned[gradient.place, b, 0] + aligned[complement.place, b, 0]
            after += np.abs(pair - aligned[constant.place, b, 0])
    subject = joint_flow.subject_of(aligned[constant.place, 0, 0]) & np.isfinite(before) & np.isfinite(after)
    stats = {}
    if subject.any():
        whole = float(level[subject].mean())
        stats = {
            "residual_before": float(before[subject].mean()) / whole,
            "residual_after": float(after[subject].mean()) / whole,
        }
    return after / np.float32(len(couples) * aligned.shape[1]), stats

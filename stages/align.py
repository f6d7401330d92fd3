"""align: the pictures of a tracking frame's set, brought to the tracking frame.

A face cannot hold still. For each tracking frame c (constant light) this finds the flow u_i of every picture p_i
of its set, on the tracking frame's grid, so that p_i(x + u_i(x)) shows what c(x) shows; for a gradient and its
complement that is

    r_a(x + u) + r_a'(x + v) = c(x) .

Engines:

    motion       one motion for all pictures of the window and the tracking frames before and after it
                 (`joint_flow.follow`); the default for performances
    joint        both flows of a pair in one solve (`joint_flow.joint`)
    alternating  Wilson's: one flow, then the other, in turn (`picture_flow.alternating`); the thesis' reference
    direct       each picture to c, after both are divided by their local mean (`picture_flow.direct`)
    none         flows of zero: the pictures as they are; the default for static captures

Under `joint` and `alternating` a picture without its complement in the set (the middle frames of the minimal
sequence) takes the part of a pair's flow that its time gives, `middle: half` (the thesis), or a short solve of its
own that starts there, `middle: refine`.

Bands: filters are changed between the bands of a still capture, and the subject moves a little meanwhile. With
`bands` not none, one flow per band, g_b, brings each band to the middle one (`band_alignment.py`):

    aligned_b(x) = p_b(x + u(x) + g_b(x + u(x))) ,

for all components, resampled once. It is the same for all pictures of a band.

Confidence is 1 / (1 + d^2) with d the predicted error of the flow in pixels, so below a half the flow is likely
wrong by more than a pixel; and less where the pictures contradict each other. It is 0 where a point is hidden, out
of the picture, or the picture does not belong to the set at all (black, repeated, mislabelled, another scene): such
a picture is named, and is NaN in `aligned`. Residuals are no measure of quality: flows that are wrong can have a
smaller one than the true flow.

Must have run before: stack. Limits: motion within a window is taken as smooth in time (a cubic).

Sources: Wilson et al. (2010), ACM TOG 29(2); Dutta (2010) chapters 4 and 5; and `joint_flow.py`.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Output, Params, Stage, StageError
from lightstage.kernels.motion import band_alignment, joint_flow, picture_flow
from lightstage.kernels.motion.flow_warp import invert, warp
from lightstage.kernels.pictures import blurs
from lightstage.kernels.pictures.band_fusion import noise_model
from lightstage.kernels.pictures.picture_sets import Window, chosen_sets, pairs, picture_times, windows

Image = NDArray[np.float32]
Bands = Literal["none", "auto", "specular", "relief", "gradient"]
Engine = Literal["auto", "motion", "joint", "alternating", "direct", "none"]
LOST = 0.02
"""Confidence below which an aligned picture is NaN."""
_DOUBTED = 0.05
"""The least confidence that doubt alone leaves: a flow that may be wrong is not a point that is hidden."""
_MISFIT = 0.15
"""Relative violation of the complement constraint, over a few pixels, that halves confidence. A head that turns by
some degrees within a window stays below it; a hand, or another picture, does not."""
_LEAST_PX = 12
"""For `motion`; the others take twice that, because their flows have a pyramid."""
_UNKNOWN = 0.25
"""Confidence of pictures of a moving subject that were not aligned."""
_TEXTURED = 0.5
"""Correlation of fine texture with the tracking frame from which it says something."""
_BLACK = 0.04
"""Of the tracking frame's mean: a gradient picture has a sixth of it at least, from where a face looks."""
_CONSTANT = 0.93
"""Of the tracking frame: a gradient picture has five sixths at most."""


class AlignParams(Params):
    """Parameters of `align`."""

    engine: Engine = Field("auto", description="auto: motion for a performance, none for a static capture")
    flow: Literal["dis", "tvl1", "farneback"] = Field("dis", description="the flow that engine: alternating uses")
    iterations: int = Field(4, ge=1, le=100, description="of engine: alternating")
    middle: Literal["half", "refine"] = Field(
        "refine",
        description="pictures without a complement, under joint and alternating: a part of a pair's flow, or a "
        "short solve of their own from there",
    )
    bands: Bands = Field(
        "none",
        description="what brings every band to the middle one: the specular component, relief (gradients over "
        "their sums), gradient (edges of the diffuse component), or auto: all of them that the capture has, each "
        "by its noise; none: the subject held still while filters were changed",
    )


def align(
    radiance: Sequence[Image],
    *,
    names: Sequence[str],
    frames: Sequence[int],
    times: Sequence[float],
    around: Sequence[float],
    band_nm: Sequence[float],
    components: Sequence[str],
    engine: str,
    bands: str,
    apart: bool,
    moving: bool,
    flow: picture_flow.Method,
    iterations: int,
    middle: str,
) -> Mapping[str, Any]:
    """Align the set of one tracking frame.

    Args:
        radiance: pictures (component, y, x), NaN where not valid: for each member its bands, then for each tracking
            frame around (before, after) its bands.
        names: illumination of each member; "" for a place that this set does not fill. frames: their indices.
        times: of the members, the tracking frame at 0. around: of the tracking frames around.
        band_nm: the bands, nm. components: what lies along the first axis of a picture.
        engine, flow, iterations, middle, bands: see AlignParams.
        moving: whether the subject may have moved between the pictures.
        apart: the block is one picture that is not moved; its results lack the dimension member.

    Returns:
        `flow` (member, xy, y, x), pixels: aligned(x) = member(x + flow(x)); `aligned` (member, band, component, y,
        x), NaN where not known; `confidence` (member, y, x), 0 to 1; `residual` (y, x), the mean over the set's
        pairs of |r_a + r_a' - c| after alignment, over bands, in radiance of the first component. `stats` has
        its mean before and after alignment, relative to c. `warnings` name pictures that do not belong to the set.
        With `bands`, `band_flow` (band, xy, y, x) and `band_confidence` (band, y, x) of the flows g_b, on the grid
        of the middle band, `stats` has what each was found from, and `warnings` name bands that show nothing to be
        aligned by, which stay as they are.
    """
    count, width = len(names), len(band_nm)
    own: list[list[Image]] = [
        [radiance[m * width + b] for b in range(width)] if names[m] else [] for m in range(count)
    ]
    others = [[radiance[(count + k) * width + b] for b in range(width)] for k in range(len(around))]
    if apart:
        return _unmoved(np.stack(own[0]))
    real = [m for m in range(count) if names[m]]
    here = next((m for m in real if names[m] == "C" and times[m] == 0), real[0])
    across = _across_bands(own, names, here, band_nm, components, bands, still=engine == "none" and not moving)
    pictures = _one_band(
        [across.moved(picture, components=1) for picture in [own[m] for m in real] + others],
        [names[m] for m in real],
    )
    member = dict(zip(real, pictures, strict=False))
    shape = member[here].shape
    flow_of = {m: np.zeros((2, *shape), np.float32) for m in real}
    confidence = {m: np.isfinite(member[m]).astype(np.float32) for m in real}
    warnings = list(across.warnings)
    if engine == "none" and moving:
        for m in real:
            confidence[m] *= np.float32(1 if m == here else _UNKNOWN)
    if engine != "none":
        called = {m: f"frame {frames[m]} ({names[m]})" for m in real}
        bad, said = _misplaced(member, called, names, here)
        warnings += said
        steady = [
            (time, picture)
            for time, picture in zip(around, pictures[len(real) :], strict=True)
            if _same_scene(picture, member[here])
        ]
        whole = {m: member[m] for m in real if m != here and m not in bad}
        found = _flows(
            member[here],
            whole,
            names,
            times,
            steady,
            engine=engine,
            flow=flow,
            iterations=iterations,
            middle=middle,
        )
        for m, (u, doubt) in found.items():
            flow_of[m] = u
            confidence[m] = np.maximum(np.float32(1) / (np.float32(1) + doubt * doubt), np.float32(_DOUBTED))
        moved = {m: warp(member[m], flow_of[m]) for m in found}
        for judge in (_foreign, _contradicted):
            more, said = judge(member[here], moved, confidence, names, called)
            bad |= more
            warnings += said
            moved = {m: picture for m, picture in moved.items() if m not in bad}
        for m in moved:
            confidence[m] *= _seen(flow_of[m])
        for m in bad:
            confidence[m][:] = 0
            flow_of[m] = np.full((2, *shape), np.nan, np.float32)
    aligned = np.full((count, width, len(components), *shape), np.nan, np.float32)
    out = {
        "flow": np.full((count, 2, *shape), np.nan, np.float32),
        "aligned": aligned,
        "confidence": np.zeros((count, *shape), np.float32),
    }
    for m in real:
        out["flow"][m] = flow_of[m]
        still = m == here or engine == "none"
        aligned[m] = across.moved(own[m], None if still else flow_of[m])
        for b in range(width):
            if engine != "none":
                aligned[m, b][:, confidence[m] <= LOST] = np.nan
        known = np.isfinite(aligned[m]).any(axis=(0, 1))
        out["confidence"][m] = np.where(known, confidence[m], np.float32(0))
    out["residual"], stats = _residual(own, aligned, names, here)
    return {**out, **across.results, "stats": {**stats, **across.stats}, "warnings": warnings}


class _Across(NamedTuple):
    """How the bands lie to each other."""

    flows: Sequence[Image | None]
    """(xy, y, x) of each band, None where it stays as it is."""
    results: Mapping[str, Image]
    stats: Mapping[str, float]
    warnings: Sequence[str]

    def moved(
        self, picture: Sequence[Image], flow: Image | None = None, components: int | None = None
    ) -> list[Image]:
        """One picture, band by band, brought to the middle band, and along a flow if there is one."""
        out = []
        for band, across in zip(picture, self.flows, strict=True):
            way = across if flow is None else flow if across is None else flow + warp(across, flow)
            out.append(band[:components] if way is None else warp(band[:components], way))
        return out


def _across_bands(
    own: Sequence[Sequence[Image]],
    names: Sequence[str],
    here: int,
    band_nm: Sequence[float],
    components: Sequence[str],
    bands: str,
    *,
    still: bool,
) -> _Across:
    """The flow of every band to the middle one."""
    count = len(band_nm)
    if bands == "none":
        return _Across([None] * count, {}, {}, [])
    # the tracking frame last: of several pictures under constant light it is the one
    order = sorted((m for m in range(len(names)) if names[m]), key=lambda m: m == here)
    light = [
        band_alignment.gathered({names[m]: own[m][b] for m in order}, components, still=still) for b in range(count)
    ]
    middle = _middle(count)
    kinds = [kind for kind in band_alignment.KINDS if bands in ("auto", kind)]
    shape = own[here][middle].shape[1:]
    flows: list[Image | None] = [None] * count
    flow = np.zeros((count, 2, *shape), np.float32)
    confidence = np.ones((count, *shape), np.float32)
    stats: dict[str, float] = {}
    warnings = []
    for b in range(count):
        if b == middle:
            continue
        found = band_alignment.band_flow(light[middle], light[b], kinds=kinds)
        if not found.parts:
            confidence[b] = _UNKNOWN
            warnings.append(
                f"{band_nm[b]:g} nm shows nothing by which it could be aligned to {band_nm[middle]:g} nm "
                f"(bands: {bands}; texture correlates by {found.alike:.2f}); it stays as it is"
            )
            continue
        flow[b] = flows[b] = found.flow
        confidence[b] = np.maximum(1 / (1 + found.doubt_px**2), _DOUBTED) * _seen(found.flow)
        stats |= {f"aligned_on_{kind}_{band_nm[b]:g}nm": part for kind, part in found.parts.items()}
    return _Across(flows, {"band_flow": flow, "band_confidence": confidence}, stats, warnings)


def _middle(bands: int) -> int:
    """Which band the others are brought to."""
    return bands // 2


def _unmoved(picture: Image) -> Mapping[str, Any]:
    """One picture (band, component, y, x) of a still subject, as a block of its own."""
    shape = picture.shape[2:]
    seen = np.isfinite(picture).any(axis=(0, 1)).astype(np.float32)
    return {"flow": np.zeros((2, *shape), np.float32), "aligned": picture, "confidence": seen}


def _one_band(pictures: Sequence[Sequence[Image]], names: Sequence[str]) -> list[Image]:
    """The first component of each picture, the mean over its bands by their signal to noise."""
    first = [[band[0] for band in picture] for picture in pictures]
    if len(first[0]) == 1:
        return [picture[0] for picture in first]
    weights = np.zeros(len(first[0]), np.float32)
    for b in range(len(weights)):
        by_name = {name: picture[b] for name, picture in zip(names, first, strict=False)}
        lit = by_name.get("C", first[0][b])
        if np.isfinite(lit).any():
            alpha, beta = noise_model(by_name)
            level = max(float(np.nanmedian(lit)), 0.0)
            weights[b] = level / (alpha + beta * level + 1e-30)
    if not weights.any():
        return [picture[0] for picture in first]
    weights /= weights.sum()
    used = np.flatnonzero(weights)
    return [np.asarray(np.tensordot(weights[used], np.stack([p[b] for b in used]), 1), np.float32) for p in first]


def _flows(
    constant: Image,
    member: Mapping[int, Image],
    names: Sequence[str],
    times: Sequence[float],
    steady: Sequence[tuple[float, Image]],
    *,
    engine: str,
    flow: picture_flow.Method,
    iterations: int,
    middle: str,
) -> dict[int, tuple[Image, Image]]:
    """Flow and doubt of each member."""
    order = list(member)
    if not order:
        return {}
    found: dict[int, tuple[Image, Image]] = {}
    together = [(order[i], order[j]) for i, j in pairs([names[m] for m in order])]
    if engine == "motion":
        follow = joint_flow.follow(
            constant,
            [*member.values(), *(picture for _, picture in steady)],
            times=[*(times[m] for m in order), *(time for time, _ in steady)],
            steady=[*(names[m] == "C" for m in order), *(True for _ in steady)],
            pairs=[(order.index(a), order.index(b)) for a, b in together],
        )
        return {m: (follow.flow[i], follow.doubt_px[i]) for i, m in enumerate(order)}
    if engine == "direct":
        for m in order:
            u = picture_flow.direct(constant, member[m])
            found[m] = u, joint_flow.extended(u[None], joint_flow.subject_of(constant))[0]
        return found
    for a, b in together:
        if engine == "joint":
            both = joint_flow.joint_flows(constant, [member[a], member[b]], times=[times[a], times[b]])
            found[a], found[b] = (both.flow[0], both.doubt_px[0]), (both.flow[1], both.doubt_px[1])
        else:
            made = picture_flow.alternating(constant, member[a], member[b], flow=flow, iterations=iterations)
            extended = joint_flow.extended(np.stack([made.u, made.v]), joint_flow.subject_of(constant))
            found[a], found[b] = (made.u, extended[0]), (made.v, extended[1])
    for m in order:
        if m in found:
            continue
        if names[m] == "C" or not together:
            # the same light; or the pair's other half was left out, and there is no flow to take a part of
            u = picture_flow.direct(constant, member[m])
            found[m] = u, joint_flow.extended(u[None], joint_flow.subject_of(constant))[0]
            continue
        # of the pair's two flows, the one on the same side in time
        base = max(
            (k for pair in together for k in pair),
            key=lambda k: (times[k] * times[m] > 0, -abs(times[k] - times[m])),
        )
        part = np.float32(times[m] / times[base])
        start = part * found[base][0]
        if middle == "refine":
            own = joint_flow.nudge(constant, member[m], start)
            found[m] = own.flow[0], own.doubt_px[0]
        else:
            found[m] = start, abs(part) * found[base][1]
    return found


def _misplaced(
    member: Mapping[int, Image], called: Mapping[int, str], names: Sequence[str], here: int
) -> tuple[set[int], list[str]]:
    """Members that cannot be what they are called, before any alignment."""
    constant = member[here]
    others = [m for m in member if m != here]
    if not np.isfinite(constant).any():
        return set(member), [f"{called[here]} holds no valid pixel (saturated?); its set is left out"]
    subject = joint_flow.subject_of(constant)
    if not subject.any():
        return set(others), [f"{called[here]} is black, so nothing can be aligned to it; its set is left out"]
    part = {m: _part(member[m], constant, subject) for m in others}
    known = [value for value in part.values() if np.isfinite(value)]
    if known and np.median(known) > 1 / _CONSTANT:
        return set(member), [
            f"{called[here]} is darker than the gradients around it: no constant light; its set is left out"
        ]
    bad, warnings = set(), []
    for m in others:
        reason = ""
        if not np.isfinite(part[m]):
            reason = f"holds no valid pixel where {called[here]} shows the subject (saturated?)"
        elif part[m] <= _BLACK:
            reason = f"is black beside {called[here]}"
        elif names[m] != "C" and part[m] > _CONSTANT:
            reason = f"is as bright as {called[here]}, so it shows constant light"
        elif names[m] == "C" and not _same_scene(member[m], constant):
            reason = f"shows another scene than {called[here]}"
        else:
            twin = next((o for o in member if o < m and np.array_equal(member[m], member[o], equal_nan=True)), None)
            if twin is not None:
                reason = f"repeats {called[twin]}: the same picture twice"
        if reason:
            bad.add(m)
            warnings.append(f"{called[m]} {reason}; it is left out (was a picture dropped or repeated?)")
    return bad, warnings


def _part(picture: Image, constant: Image, subject: NDArray[np.bool_]) -> float:
    """Brightness of a picture beside c's, where both are known; NaN where none is."""
    both = subject & np.isfinite(picture)
    return float(picture[both].mean() / constant[both].mean()) if both.any() else float("nan")


def _same_scene(picture: Image, constant: Image) -> bool:
    """Whether a tracking frame around shows the subject of this one, a little moved."""
    subject = joint_flow.subject_of(constant) & np.isfinite(picture)
    if not subject.any():
        return False
    a, b = (blurs.gaussian(np.nan_to_num(p), constant.shape[1] / 100) for p in (picture, constant))
    return bool(np.abs(a - b)[subject].mean() < 0.5 * b[subject].mean())


def _foreign(
    constant: Image,
    moved: Mapping[int, Image],
    confidence: dict[int, Image],
    names: Sequence[str],
    called: Mapping[int, str],
) -> tuple[set[int], list[str]]:
    """Take confidence from where a picture lacks the texture that others of the set share with c; name those that
    nowhere have it: a hand, another scene.

    Correlation of fine texture is 0.86 and more on the rendered heads, in dim gradients too. It is held against the
    best of the set, so that a subject without texture is not judged.
    """
    subject = joint_flow.subject_of(constant)
    bright = np.float32(np.nanmax(np.where(subject, constant, 0)) or 1.0)
    own = _texture(constant / bright, subject)
    energy = _local(own * own, 2.0)
    whole, local = {}, {}
    for m, picture in moved.items():
        theirs = _texture(picture / bright, subject & np.isfinite(picture))
        known = subject & np.isfinite(picture)
        size = float(np.sqrt(np.sum(own[known] ** 2) * np.sum(theirs[known] ** 2)))
        whole[m] = float(np.sum(own[known] * theirs[known])) / size if size > 0 else 0.0
        both = energy * _local(theirs * theirs, 2.0)
        local[m] = _local(own * theirs, 2.0) / np.sqrt(np.maximum(both, np.float32(1e-20)))
    best = max(whole.values(), default=0.0)
    if best < _TEXTURED:
        return set(), []
    bad = {m for m, value in whole.items() if value < best / 2}
    warnings = [
        f"{called[m]} does not show what the tracking frame and the others show (texture correlates by "
        f"{whole[m]:.2f}, the others' by up to {best:.2f}); it is left out (is something in the way, or does the "
        "scene change?)"
        for m in sorted(bad)
    ]
    good = [m for m in moved if m not in bad]
    sharpest = np.max([local[m] for m in good], axis=0)
    for m in good:
        lacks = (sharpest > _TEXTURED) & (local[m] < sharpest / 3)
        confidence[m] = np.where(lacks, np.minimum(confidence[m], np.float32(_DOUBTED)), confidence[m])
    return bad, warnings


def _texture(picture: Image, lit: NDArray[np.bool_]) -> Image:
    smooth = blurs.gaussian(np.where(np.isfinite(picture), picture, np.float32(0)), 0.8)
    return joint_flow.fine_texture(smooth, lit)


def _contradicted(
    constant: Image,
    moved: Mapping[int, Image],
    confidence: dict[int, Image],
    names: Sequence[str],
    called: Mapping[int, str],
) -> tuple[set[int], list[str]]:
    """Take confidence from where a pair does not add up to c; name the pairs that nowhere do."""
    bad: set[int] = set()
    warnings = []
    subject = joint_flow.subject_of(constant)
    order = list(moved)
    level = _local(np.where(subject, constant, np.float32(0)))
    for i, j in pairs([names[m] for m in order]):
        a, b = order[i], order[j]
        off = np.where(subject, moved[a] + moved[b] - constant, np.float32(0))
        misfit = np.abs(_local(np.nan_to_num(off))) / np.maximum(level, np.float32(1e-6))
        typical = float(np.median(misfit[subject])) if subject.any() else 0.0
        if typical > _MISFIT:
            bad |= {a, b}
            warnings.append(
                f"{called[a]} and {called[b]} are {100 * typical:.0f} % off their sum, the constant picture; they "
                "are left out (was a picture dropped, repeated or mislabelled, or does the scene change?)"
            )
            continue
        factor = np.float32(1) / (1 + (misfit / np.float32(_MISFIT)) ** 4)
        confidence[a] *= factor
        confidence[b] *= factor
    return bad, warnings


def _local(picture: Image, wide: float = 1.0) -> Image:
    """The mean over a few pixels: 3 px, times `wide`, at a width of 406."""
    return np.asarray(blurs.gaussian(picture, wide * 3.0 * max(1.0, picture.shape[1] / 406)))


def _seen(flow: Image) -> Image:
    """1 where a point is seen in the picture that the flow leads to, 0 where it is hidden or beyond the border."""
    inverse = invert(flow)
    back = warp(inverse.flow, flow, interpolation="linear") + flow
    # wrong by a pixel: another point is there
    return np.asarray(np.hypot(back[0], back[1]) < 1, np.float32)


def _residual(
    own: Sequence[Sequence[Any]], aligned: Image, names: Sequence[str], here: int
) -> tuple[Image, dict[str, float]]:
    """Mean |r_a + r_a' - c| (y, x) over pairs and bands, and its mean relative to c, before and after alignment."""
    shape = aligned.shape[-2:]
    together = pairs(list(names))
    if not together or names[here] != "C":
        return np.full(shape, np.nan, np.float32), {}
    after = np.zeros(shape, np.float32)
    before = np.zeros(shape, np.float32)
    level = np.zeros(shape, np.float32)
    for b in range(aligned.shape[1]):
        level += aligned[here, b, 0] * len(together)
        for i, j in together:
            before += np.abs(own[i][b][0] + own[j][b][0] - own[here][b][0])
            after += np.abs(aligned[i, b, 0] + aligned[j, b, 0] - aligned[here, b, 0])
    subject = joint_flow.subject_of(aligned[here, 0, 0]) & np.isfinite(before) & np.isfinite(after)
    stats = {}
    if subject.any():
        whole = float(level[subject].mean())
        stats = {
            "residual_before": float(before[subject].mean()) / whole,
            "residual_after": float(after[subject].mean()) / whole,
        }
    return after / np.float32(len(together) * aligned.shape[1]), stats


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: AlignParams) -> Arrangement:
    (stacked,) = grids
    performance = "frame" in stacked.sizes
    engine = params.engine if params.engine != "auto" else ("motion" if performance else "none")
    least = {"none": 1, "motion": _LEAST_PX}.get(engine, 2 * _LEAST_PX)
    if min(stacked.sizes["y"], stacked.sizes["x"]) < least:
        raise StageError(
            f"pictures of {stacked.sizes['x']} x {stacked.sizes['y']} are too small to be aligned; "
            f"engine: {engine} needs {least} pixels a side"
        )
    dim = "frame" if performance else "illumination"
    names, frames = list(stacked.along("illumination")), list(stacked.along("frame"))
    taken = picture_times(facts)
    when = [taken[frame] for frame in frames]
    sets = _sets(names, performance, engine)
    bands = _checked_bands(params.bands, stacked, sets, still=engine == "none" and not performance)
    band_nm = [float(band) for band in stacked.along("band")]
    together = all(pairs(list(window.at)) and "C" in window.at for window in sets)
    apart = engine == "none" and not performance and not together and bands == "none"
    places = [sorted(window.at.values()) for window in sets]
    if performance:
        places = _with_lacking(places, [window.frame for window in sets], names)
    most = max(len(at) for at in places)
    groups = []
    for window, at in zip(sets, places, strict=True):
        fill = [*at, *[-1] * (most - len(at))]
        near = [i for i in _beside(window.frame, names) if i not in at] if engine == "motion" else []
        now = when[window.frame]
        told: dict[str, Any] = {
            "names": [names[i] if i >= 0 else "" for i in fill],
            "frames": [frames[i] if i >= 0 else -1 for i in fill],
            # a microsecond is finer than any clock here, and equal windows then have equal keys
            "times": [round(when[i] - now, 6) if i >= 0 else 0.0 for i in fill],
            "around": [round(when[i] - now, 6) for i in near],
            "band_nm": band_nm,
            "components": list(stacked.along("component")),
            "engine": engine,
            "bands": bands,
            "apart": apart,
            "moving": performance,
        }
        for some in [[i] for i in fill] if apart else [fill]:
            # a place that is not filled reads the tracking frame, and is not looked at
            pieces = [
                {dim: i if i >= 0 else window.frame, "band": b} for i in (*some, *near) for b in range(len(band_nm))
            ]
            mine = {k: [told[k][fill.index(some[0])]] for k in ("names", "frames", "times")} if apart else {}
            groups.append(Group({"radiance": pieces}, {**told, **mine}))
    sizes = {
        "tracking": len(sets),
        "member": most,
        "xy": 2,
        **{k: v for k, v in stacked.sizes.items() if k != dim},
    }
    table = [[*at, *[-1] * (most - len(at))] for at in places]
    labels: dict[str, tuple[tuple[str, ...], Sequence[Any]]] = {
        "tracking": (("tracking",), [frames[window.frame] for window in sets]),
        "frame": (("tracking", "member"), [[frames[i] if i >= 0 else -1 for i in row] for row in table]),
        "illumination": (("tracking", "member"), [[names[i] if i >= 0 else "" for i in row] for row in table]),
        "xy": (("xy",), ["x", "y"]),
        "band": stacked.labels["band"],
        "component": stacked.labels["component"],
    }
    if performance:
        labels["time_s"] = (("tracking",), [stacked.along("time_s")[window.frame] for window in sets])
    attrs = {k: v for k, v in stacked.attrs.items() if k == "cannot_be_made"} | {"engine": engine}
    outputs = {"flow", "aligned", "confidence"} if apart else {"flow", "aligned", "confidence", "residual"}
    if bands != "none":
        attrs |= {"bands": bands, "bands_aligned_to_nm": band_nm[_middle(len(band_nm))]}
        outputs |= {"band_flow", "band_confidence"}
    return Arrangement(
        Grid(sizes, labels, attrs),
        tuple(groups),
        {"illumination|frame": dim},
        ("tracking", "member") if apart else None,
        frozenset(outputs),
    )


def _checked_bands(bands: Bands, stacked: Grid, sets: Sequence[Window], *, still: bool) -> str:
    """What brings the bands together; none where there is one band only."""
    components = list(stacked.along("component"))
    if stacked.sizes["band"] < 2:
        return "none"
    if bands == "specular" and "specular" not in components:
        raise StageError(
            f"bands: specular needs the specular component; this capture has {', '.join(components)}; bands: auto "
            "would work"
        )
    if bands == "relief" and not (still and all(pairs(list(window.at)) for window in sets)):
        raise StageError(
            "bands: relief needs a gradient and its complement (X Xc, Y Yc or Z Zc) of a still capture with "
            "engine: none; bands: auto would work"
        )
    if bands != "none" and min(stacked.sizes["y"], stacked.sizes["x"]) < 2 * _LEAST_PX:
        raise StageError(
            f"pictures of {stacked.sizes['x']} x {stacked.sizes['y']} are too small for their bands to be aligned; "
            f"{2 * _LEAST_PX} pixels a side are needed"
        )
    return bands


def _with_lacking(places: Sequence[list[int]], tracking: Sequence[int], names: Sequence[str]) -> list[list[int]]:
    """Each set, and the tracking frames next to it that lack a full set: `upsample` fills them from it."""
    return [
        sorted({*at, *(i for i in _beside(frame, names) if i not in tracking)})
        for at, frame in zip(places, tracking, strict=True)
    ]


def _beside(frame: int, names: Sequence[str]) -> list[int]:
    """The tracking frames before and after one."""
    constant = [i for i, name in enumerate(names) if name == "C"]
    if frame not in constant:
        return []
    k = constant.index(frame)
    return [*constant[max(k - 1, 0) : k], *constant[k + 1 : k + 2]]


def _sets(names: Sequence[str], performance: bool, engine: str) -> list[Window]:
    """The windows to align: of a performance those that hold a full set, of a static capture all of it."""
    if not performance:
        sets = [Window(names.index("C") if "C" in names else 0, {name: i for i, name in enumerate(names)})]
        if engine != "none" and "C" not in names:
            raise StageError(f"engine: {engine} aligns to a picture under constant light (C), and there is none")
    else:
        whole = f"{' '.join(names[:24])} ({len(names)} pictures)"
        if "C" not in names:
            raise StageError(f"a performance needs tracking frames under constant light (C); this one has {whole}")
        found = chosen_sets(windows(names), method="auto", base="auto", correct="none", whole=whole)
        sets = [window for window, _ in found]
    for window in sets:
        if engine in ("joint", "alternating") and not pairs(list(window.at)):
            have = " ".join(sorted(window.at, key=window.at.__getitem__))
            raise StageError(
                f"engine: {engine} needs a gradient and its complement (X Xc, Y Yc or Z Zc) around each tracking "
                f"frame; around frame {window.frame} there are {have}; engine: motion or direct would work"
            )
    return sets


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: AlignParams
) -> Mapping[str, Any]:
    return {name: labels[name] for name in _TOLD}


_TOLD = ("names", "frames", "times", "around", "band_nm", "components", "engine", "bands", "apart", "moving")

STAGE = Stage(
    name="align",
    version=1,
    summary="the pictures of each set, brought to their tracking frame",
    params=AlignParams,
    remarks=("engine", "cannot_be_made"),
    inputs={"radiance": Input("radiance", ("illumination|frame", "band", "component", "y", "x"), "group")},
    outputs={
        "flow": Output(
            ("tracking", "member", "xy", "y", "x"),
            "float32",
            whole=("xy", "y", "x"),
            attrs={"units": "pixel", "long_name": "aligned(x) = member(x + flow(x)), on the tracking frame's grid"},
        ),
        "aligned": Output(
            ("tracking", "member", "band", "component", "y", "x"), "float32", attrs={"units": "radiance"}
        ),
        "confidence": Output(
            ("tracking", "member", "y", "x"),
            "float32",
            attrs={"units": "1", "long_name": "below a half the flow is likely wrong by a pixel"},
        ),
        "residual": Output(
            ("tracking", "y", "x"),
            "float32",
            attrs={"units": "radiance", "long_name": "|gradient + complement - constant| after alignment"},
        ),
        "band_flow": Output(
            ("tracking", "band", "xy", "y", "x"),
            "float32",
            whole=("xy", "y", "x"),
            attrs={"units": "pixel", "long_name": "from the band that the others are aligned to, on its grid"},
        ),
        "band_confidence": Output(
            ("tracking", "band", "y", "x"),
            "float32",
            attrs={"units": "1", "long_name": "below a half the flow of a band is likely wrong by a pixel"},
        ),
    },
    blocks=("tracking",),
    arrange=_arrange,
    context=_context,
    prepared=_TOLD,
    kernel=align,
)

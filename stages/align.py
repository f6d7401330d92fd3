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

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

from pydantic import Field

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Name, Output, Params, Stage, StageError
from lightstage.kernels.pictures.picture_sets import Window, chosen_sets, pairs, picture_times, windows

Bands = Literal["none", "auto", "specular", "relief", "gradient"]
Engine = Literal["auto", "motion", "joint", "alternating", "direct", "none"]
_LEAST_PX = 12
"""For `motion`; the others take twice that, because their flows have a pyramid."""


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


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: AlignParams) -> Arrangement:
    (stacked,) = grids
    performance = "frame" in stacked.sizes
    dim = "frame" if performance else "illumination"
    names = list(stacked.along("illumination"))
    bands_nm = [float(band) for band in stacked.along("band")]
    engine = _engine(params.engine, stacked, performance)
    sets = _sets(names, performance, engine)
    bands = _checked_bands(params.bands, stacked, sets, still=engine == "none" and not performance)
    paired = all(pairs(list(window.at)) and "C" in window.at for window in sets)
    apart = engine == "none" and not performance and not paired and bands == "none"
    places = [sorted(window.at.values()) for window in sets]
    if performance:
        places = _with_lacking(places, [window.frame for window in sets], names)
    labels = {"engine": engine, "bands": bands, "reference_band": _reference(bands_nm)}
    session = {
        "bands_nm": bands_nm,
        "components": list(stacked.along("component")),
        "moving": performance,
        "apart": apart,
    }
    shot = _shots(stacked, facts)
    most = max(len(at) for at in places)
    groups = []
    for window, at in zip(sets, places, strict=True):
        around = [i for i in _beside(window.frame, names) if i not in at] if engine == "motion" else []
        for members in [[i] for i in at] if apart else [at]:
            shots = {
                "members": [shot(i, window.frame) for i in members] + [None] * (0 if apart else most - len(at)),
                "around": [shot(i, window.frame) for i in around],
            }
            pictures: dict[Name, dict[str, int]] = {
                (stacked.along("frame")[i], nm): {dim: i, "band": b}
                for i in (*members, *around)
                for b, nm in enumerate(bands_nm)
            }
            groups.append(Group({"radiance": pictures}, {"shots": shots | session, **labels}))
    attrs = {k: v for k, v in stacked.attrs.items() if k == "cannot_be_made"} | {"engine": engine}
    outputs = {"flow", "aligned", "confidence"} if apart else {"flow", "aligned", "confidence", "residual"}
    if bands != "none":
        attrs |= {"bands": bands, "bands_aligned_to_nm": bands_nm[_reference(bands_nm)]}
        outputs |= {"band_flow", "band_confidence"}
    return Arrangement(
        _grid(stacked, sets, places, attrs),
        tuple(groups),
        {"illumination|frame": dim},
        ("tracking", "member") if apart else None,
        frozenset(outputs),
    )


def _engine(asked: Engine, stacked: Grid, performance: bool) -> str:
    """The engine, which needs pictures of some size."""
    engine = asked if asked != "auto" else ("motion" if performance else "none")
    least = {"none": 1, "motion": _LEAST_PX}.get(engine, 2 * _LEAST_PX)
    if min(stacked.sizes["y"], stacked.sizes["x"]) < least:
        raise StageError(
            f"pictures of {stacked.sizes['x']} x {stacked.sizes['y']} are too small to be aligned; "
            f"engine: {engine} needs {least} pixels a side"
        )
    return engine


def _reference(bands_nm: Sequence[float]) -> int:
    """Number of the band that the others are brought to."""
    return len(bands_nm) // 2


def _shots(stacked: Grid, facts: Mapping[str, Any]) -> Callable[[int, int], list[Any]]:
    """Gives frame, illumination and time (s) after a tracking frame of a picture, from the places of both."""
    frames, names = stacked.along("frame"), stacked.along("illumination")
    times = picture_times(facts)

    def shot(place: int, tracking: int) -> list[Any]:
        # a microsecond is finer than any clock here
        return [frames[place], names[place], round(times[frames[place]] - times[frames[tracking]], 6)]

    return shot


def _grid(stacked: Grid, sets: Sequence[Window], places: Sequence[Sequence[int]], attrs: Mapping[str, Any]) -> Grid:
    """The sets as rows of members, filled up where one has fewer."""
    names, frames = stacked.along("illumination"), stacked.along("frame")
    most = max(len(at) for at in places)
    table = [[*at, *[-1] * (most - len(at))] for at in places]
    sizes = {"tracking": len(sets), "member": most, "xy": 2}
    sizes |= {name: size for name, size in stacked.sizes.items() if name not in ("illumination", "frame")}
    labels: dict[str, tuple[tuple[str, ...], Sequence[Any]]] = {
        "tracking": (("tracking",), [frames[window.frame] for window in sets]),
        "frame": (("tracking", "member"), [[frames[i] if i >= 0 else -1 for i in row] for row in table]),
        "illumination": (("tracking", "member"), [[names[i] if i >= 0 else "" for i in row] for row in table]),
        "xy": (("xy",), ["x", "y"]),
        "band": stacked.labels["band"],
        "component": stacked.labels["component"],
    }
    if "frame" in stacked.sizes:
        labels["time_s"] = (("tracking",), [stacked.along("time_s")[window.frame] for window in sets])
    return Grid(sizes, labels, attrs)


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
        complete = chosen_sets(windows(names), method="auto", base="auto", correct="none", whole=whole)
        sets = [window for window, _ in complete]
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
    return {name: labels[name] for name in _PREPARED}


_PREPARED = ("shots", "engine", "bands", "reference_band")

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
    prepared=_PREPARED,
    kernel="lightstage.kernels.motion.alignment:align",
)

"""upsample: normals at every picture of a performance, at that picture's own pose.

Normals exist at tracking frames. Each picture lies between two of them, and is a member of both their sets, so
`align` has its flow f_T from either. With g_T the inverse of f_T,

    n_i(y) ~ sum over T of w_T c_T n_T(y + g_T(y)) ,

w_T the nearness in time, c_T the confidence of the flow. Where one side does not see a point, the other fills it;
a picture at an end has one side only; a tracking frame has its own normals, or, if it lacks a full set, its
neighbour's.

`weights: printed` and `inverse: negated` are what the thesis prints, for comparison: in the minimal sequence its
weights favour the farther tracking frame (5.2.1), in Wilson's the nearer (5.1.1); W(n, -f) is not the inverse warp.

Must have run before: normals and align. Limits: a warp moves normals and does not turn them; with a side before and
one after, the mean follows the subject's rotation as far as it is linear in time.

Source: Wilson et al. (2010), ACM TOG 29(2); Dutta (2010) 5.1.1 and 5.2.1.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from pydantic import Field

from lightstage.dag.stage import Arrangement, Grid, Group, Input, Items, Name, Output, Params, Stage, StageError
from lightstage.kernels.encodings import NORMAL_ATTRS
from lightstage.kernels.pictures.picture_sets import picture_times


class UpsampleParams(Params):
    """Parameters of `upsample`."""

    weights: Literal["nearness", "equal", "printed"] = Field(
        "nearness", description="of the two tracking frames around; printed: as in the thesis, for comparison"
    )
    inverse: Literal["proper", "negated"] = Field("proper", description="negated: W(n, -f), for comparison")
    interpolation: Literal["linear", "cubic", "spline"] = Field("cubic", description="of the normals, as vectors")


def _arrange(grids: Sequence[Grid], facts: Mapping[str, Any], params: UpsampleParams) -> Arrangement:
    normals, aligned = grids
    if "member" not in aligned.sizes:
        raise StageError("upsample reads normals and align, in this order: from: [normals, align]")
    tracking = list(normals.along("tracking"))
    performance = facts["frame_rate_hz"] is not None
    when = picture_times(facts)
    # per picture: (time away, tracking frame in normals, in align, member)
    sides: dict[int, list[tuple[float, int, int, int]]] = {}
    for a, (frame, members) in enumerate(zip(aligned.along("tracking"), aligned.along("frame"), strict=True)):
        if frame not in tracking:
            continue
        for m, picture in enumerate(members):
            if picture >= 0 and (performance or picture == frame):
                away = when[frame] - when[picture]
                sides.setdefault(picture, []).append((away, tracking.index(frame), a, m))
    frames = sorted(sides)
    groups = []
    for picture in frames:
        own = [side for side in sides[picture] if side[0] == 0]
        before = sorted((s for s in sides[picture] if s[0] < 0), reverse=True)[:1]
        after = sorted(s for s in sides[picture] if s[0] > 0)[:1]
        chosen = own or before + after
        tracked: dict[Name, dict[str, int]] = {away: {"tracking": n} for away, n, _, _ in chosen}
        flows: dict[Name, dict[str, int]] = {away: {"tracking": a, "member": m} for away, _, a, m in chosen}
        groups.append(
            Group(
                {"normal": tracked, "albedo": tracked, "flow": flows, "confidence": flows},
                {"between": _between([tracking[side[1]] for side in chosen])},
            )
        )
    sizes = {"frame": len(frames), "xyz": 3, "y": normals.sizes["y"], "x": normals.sizes["x"]}
    labels: dict[str, tuple[tuple[str, ...], Sequence[Any]]] = {
        "frame": (("frame",), frames),
        "illumination": (("frame",), [facts["illumination"][i] for i in frames]),
        "xyz": (("xyz",), list("xyz")),
    }
    if performance:
        labels["time_s"] = (("frame",), [facts["time_s"][i] for i in frames])
    attrs = {k: normals.attrs[k] for k in ("method", "correct", "component", "frame") if k in normals.attrs}
    return Arrangement(Grid(sizes, labels, attrs), tuple(groups))


def _between(flanking: Sequence[int]) -> int | None:
    """How many pictures lie between two tracking frames."""
    return abs(flanking[1] - flanking[0]) - 1 if len(flanking) == 2 else None


def _context(
    labels: Mapping[str, Any], facts: Mapping[str, Any], items: Items, params: UpsampleParams
) -> Mapping[str, Any]:
    # the other weights do not depend on it, and what is in the context is in the key
    printed = params.weights == "printed"
    return {"between": labels["between"] if printed else None}


STAGE = Stage(
    name="upsample",
    version=1,
    summary="normals at every picture",
    params=UpsampleParams,
    remarks=("method",),
    inputs={
        "normal": Input("normal", ("tracking", "band", "xyz", "y", "x"), "group"),
        "albedo": Input("albedo", ("tracking", "band", "y", "x"), "group"),
        "flow": Input("flow", ("tracking", "member", "xy", "y", "x"), "group", source=1),
        "confidence": Input("confidence", ("tracking", "member", "y", "x"), "group", source=1),
    },
    outputs={
        "normal": Output(
            ("frame", "xyz", "y", "x"),
            "int16",
            whole=("xyz", "y", "x"),
            attrs=NORMAL_ATTRS,
        ),
        "confidence": Output(("frame", "y", "x"), "float32", attrs={"units": "1"}),
    },
    blocks=("frame",),
    arrange=_arrange,
    context=_context,
    prepared=("between",),
    kernel="lightstage.kernels.motion.upsampling:upsample",
)

"""The ways to find the flows of a tracking frame's set: `stages/align.py` says what each does."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from lightstage.kernels.motion import joint_flow, picture_flow
from lightstage.kernels.motion.shots import Image, Member, Shot
from lightstage.kernels.pictures.picture_sets import pairs


class Engine(NamedTuple):
    """How flows are found."""

    name: str
    """motion, joint, alternating, direct or none."""
    flow: picture_flow.Method
    """Of alternating."""
    iterations: int
    """Of alternating."""
    middle: str
    """half or refine: pictures without a complement, under joint and alternating."""


class Way(NamedTuple):
    """From a tracking frame to a picture."""

    flow: Image
    """(xy, y, x), pixels, on the tracking frame's grid."""
    doubt_px: Image
    """(y, x): predicted error."""


def find_ways(
    constant: Image, members: Sequence[Member], steady: Sequence[tuple[Shot, Image]], engine: Engine
) -> list[Way]:
    """The way to each member.

    Args:
        constant: the tracking frame, (y, x).
        members: of its set, those that belong to it.
        steady: tracking frames beside it that show the same subject; for `motion`.
        engine: any but none.
    """
    if not members:
        return []
    if engine.name == "motion":
        return _by_motion(constant, members, steady)
    if engine.name == "direct":
        return [_direct(constant, member.picture) for member in members]
    return _by_pairs(constant, members, engine)


def _by_motion(constant: Image, members: Sequence[Member], steady: Sequence[tuple[Shot, Image]]) -> list[Way]:
    flows = joint_flow.follow(
        constant,
        [*(member.picture for member in members), *(picture for _, picture in steady)],
        times=[*(member.shot.time_s for member in members), *(shot.time_s for shot, _ in steady)],
        steady=[*(member.is_constant for member in members), *(True for _ in steady)],
        pairs=pairs([member.illumination for member in members]),
    )
    return [Way(flows.flow[i], flows.doubt_px[i]) for i in range(len(members))]


def _direct(constant: Image, picture: Image) -> Way:
    flow = picture_flow.direct(constant, picture)
    return Way(flow, joint_flow.extended(flow[None], joint_flow.subject_of(constant))[0])


def _by_pairs(constant: Image, members: Sequence[Member], engine: Engine) -> list[Way]:
    """A gradient and its complement together; what has none takes its way from them."""
    ways: dict[int, Way] = {}
    for a, b in pairs([member.illumination for member in members]):
        ways[a], ways[b] = _pair(constant, members[a], members[b], engine)
    paired = dict(ways)
    for i, member in enumerate(members):
        if i in paired:
            continue
        if member.is_constant or not paired:
            # the same light; or the pair's other half was left out, and there is no flow to take a part of
            ways[i] = _direct(constant, member.picture)
        else:
            ways[i] = _between(constant, member, members, paired, refine=engine.middle == "refine")
    return [ways[i] for i in range(len(members))]


def _pair(constant: Image, gradient: Member, complement: Member, engine: Engine) -> tuple[Way, Way]:
    if engine.name == "joint":
        times = [gradient.shot.time_s, complement.shot.time_s]
        both = joint_flow.joint_flows(constant, [gradient.picture, complement.picture], times=times)
        return Way(both.flow[0], both.doubt_px[0]), Way(both.flow[1], both.doubt_px[1])
    turns = picture_flow.alternating(
        constant, gradient.picture, complement.picture, flow=engine.flow, iterations=engine.iterations
    )
    doubt = joint_flow.extended(np.stack([turns.u, turns.v]), joint_flow.subject_of(constant))
    return Way(turns.u, doubt[0]), Way(turns.v, doubt[1])


def _between(
    constant: Image, member: Member, members: Sequence[Member], paired: Mapping[int, Way], *, refine: bool
) -> Way:
    """The part of a pair's flow that the picture's time gives, or a short solve that starts there."""
    time = member.shot.time_s
    times = {i: members[i].shot.time_s for i in paired}
    # of the pair's two flows, the one on the same side in time
    nearest = max(times, key=lambda i: (times[i] * time > 0, -abs(times[i] - time)))
    part = np.float32(time / times[nearest])
    start = part * paired[nearest].flow
    if not refine:
        return Way(start, abs(part) * paired[nearest].doubt_px)
    own = joint_flow.nudge(constant, member.picture, start)
    return Way(own.flow[0], own.doubt_px[0])

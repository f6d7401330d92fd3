"""Every engine finds a shift that is known; what has no complement takes its part of a pair's flow."""

from typing import Any

import numpy as np
import pytest

from lightstage.kernels.motion.engines import Engine, find_ways
from lightstage.kernels.motion.shots import Member, Shot
from tests.scenes import Performer

ACTOR = Performer(speed_px=1.0, bend_px=0.0)
TRACKING = 2
SET = {0: "X", 1: "Y", 4: "Xc"}
"""Of a minimal sequence: Y has no complement."""


def member(frame: int, name: str) -> Member:
    picture = ACTOR.picture(frame, name).astype(np.float32)
    return Member.unmoved(frame, Shot(frame, name, float(frame - TRACKING)), [picture[None]], picture)


def ways(engine: str, middle: str = "refine") -> Any:
    constant = ACTOR.picture(TRACKING, "C").astype(np.float32)
    steady = [(Shot(5, "C", 3.0), ACTOR.picture(5, "C").astype(np.float32))]
    members = [member(frame, name) for frame, name in SET.items()]
    return find_ways(constant, members, steady, Engine(engine, "dis", 4, middle))


@pytest.mark.parametrize(
    ("engine", "pixels"), [("motion", 0.1), ("joint", 0.15), ("alternating", 0.5), ("direct", 0.2)]
)
def test_a_known_motion(engine: str, pixels: float) -> None:
    inner = ACTOR.surface(TRACKING)[2]
    for frame, way in zip(SET, ways(engine), strict=True):
        off = np.hypot(*(way.flow - ACTOR.flow(TRACKING, frame)))[inner]
        assert off.mean() < pixels, frame  # motion is 1 px a picture; `alternating` is the reference, and the worst


def test_half_is_the_part_that_the_time_gives() -> None:
    gradient, middle, _ = ways("joint", middle="half")
    # Y at -1 lies half way to X at -2
    np.testing.assert_allclose(middle.flow, gradient.flow / 2)
    np.testing.assert_allclose(middle.doubt_px, gradient.doubt_px / 2)


def test_of_no_pictures_there_are_no_ways() -> None:
    constant = ACTOR.picture(TRACKING, "C").astype(np.float32)
    assert find_ways(constant, [], [], Engine("motion", "dis", 4, "refine")) == []

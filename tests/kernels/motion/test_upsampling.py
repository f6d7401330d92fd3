"""Normals at every picture: by hand on shifted pictures, weights, hidden sides, read-only inputs."""

from typing import Any

import numpy as np
import pytest

from lightstage.kernels.motion.upsampling import upsample
from tests.scenes import Performer, angle_deg, decoded

SHAPE = (20, 24)


def tilted(degrees: float) -> Any:
    """(1, xyz, y, x) of normals tilted from z towards x."""
    a = np.radians(degrees)
    return np.broadcast_to(np.array([np.sin(a), 0, np.cos(a)], np.float32)[:, None, None], (3, *SHAPE))[None]


def still(x: float = 0) -> Any:
    flow = np.zeros((2, *SHAPE), np.float32)
    flow[0] = x
    return flow


def call(normal: Any, flow: Any, away: Any, confidence: Any = None, **options: Any) -> Any:
    settings = {"weights": "nearness", "inverse": "proper", "interpolation": "cubic"} | options
    sure = confidence or [np.ones(n.shape[-2:], np.float32) for n in normal]
    lit = [np.ones((len(n), *n.shape[-2:]), np.float32) for n in normal]
    return upsample(*(dict(zip(away, pieces, strict=True)) for pieces in (normal, lit, flow, sure)), **settings)


@pytest.mark.parametrize(
    ("weights", "away", "wanted"),
    [
        ("nearness", [-1, 2], 2),
        ("equal", [-1, 2], 3),
        # Dutta (2010) 5.2.1: frame 5 between 3 and 6 takes 3 twice, here from the other side
        ("printed", [-1, 2], 4),
        # 5.1.1, Wilson's: frame 5 between 4 and 8 takes 4 three times
        ("nearness", [-1, 3], 1.5),
        ("printed", [-1, 3], 1.5),
    ],
)
def test_weights_by_hand(weights: str, away: list[int], wanted: float) -> None:
    """Between tracking frames of 0 and 6 degrees."""
    between = away[1] - away[0] - 1
    out = call([tilted(0), tilted(6)], [still(), still()], away, weights=weights, between=between)
    n = decoded(out["normal"])
    # int16 steps are 0.002 degrees, and a chord's third is not quite an arc's
    assert np.degrees(np.arctan2(n[0], n[2])) == pytest.approx(np.full(SHAPE, wanted), abs=0.01)


def test_a_tracking_frame_keeps_its_own() -> None:
    out = call([tilted(7)], [still()], [0])
    np.testing.assert_array_equal(out["normal"], np.round(tilted(7)[0] * 32767))


def test_a_hidden_side_is_filled_by_the_other() -> None:
    hidden = np.ones(SHAPE, np.float32)
    hidden[:, :10] = 0
    out = call([tilted(0), tilted(6)], [still(), still()], [-1, 1], [hidden, np.ones(SHAPE, np.float32)])
    n = decoded(out["normal"])
    degrees = np.degrees(np.arctan2(n[0], n[2]))
    np.testing.assert_allclose(degrees[:, :7], 6, atol=0.01)  # three px for the cubic
    np.testing.assert_allclose(degrees[:, 14:], 3, atol=0.01)


def test_what_moved_right_is_further_right() -> None:
    normal = tilted(0).copy()
    normal[0, :, :, 10:] = tilted(20)[0, :, :, 10:]
    n = decoded(call([normal], [still(4)], [1])["normal"])
    turned = np.degrees(np.arctan2(n[0], n[2]))
    np.testing.assert_allclose(turned[:, 5:11], 0, atol=0.01)
    np.testing.assert_allclose(turned[:, 17:], 20, atol=0.01)
    assert np.isnan(n[:, :, :3]).all()  # nobody saw what came in


def test_true_flows_of_a_moving_face() -> None:
    actor = Performer(speed_px=2.5, bend_px=0.4)
    sides = [actor.surface(t)[1][None].astype(np.float32) for t in (0, 3)]
    flows = [actor.flow(t, 1).astype(np.float32) for t in (0, 3)]
    _, truth, inner = actor.surface(1)
    errors = {}
    for inverse in ("proper", "negated"):
        n = decoded(call(sides, flows, [-1, 2], inverse=inverse)["normal"])
        errors[inverse] = float(np.nanmean(angle_deg(n, truth)[inner]))
    # ripples of 27 px under Keys' cubic, and int16 steps
    assert errors["proper"] < 0.02
    assert errors["negated"] > 2 * errors["proper"]


def test_a_band_without_a_value_has_no_vote_and_inputs_stay() -> None:
    normal = np.concatenate([tilted(5), np.full_like(tilted(5), np.nan)])
    flow = still()
    normal.flags.writeable = flow.flags.writeable = False
    n = decoded(call([normal], [flow], [0])["normal"])
    assert np.degrees(np.arctan2(n[0], n[2])) == pytest.approx(np.full(SHAPE, 5), abs=0.01)

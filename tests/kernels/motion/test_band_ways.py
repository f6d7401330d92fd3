"""Pictures moved to the reference band, and along a flow, at once."""

from typing import Any

import numpy as np

from lightstage.kernels.motion.band_ways import BandWays, find_band_ways, still_bands
from lightstage.kernels.motion.shots import Shots


def shift(x: float) -> Any:
    flow = np.zeros((2, 12, 16), np.float32)
    flow[0] = x
    return flow


def ramp() -> Any:
    """(component, y, x): its value is x."""
    return np.broadcast_to(np.arange(16, dtype=np.float32), (2, 12, 16)).copy()


def test_bands_that_are_still_are_passed_on() -> None:
    picture = [ramp(), ramp()]
    moved = still_bands(2).moved(picture)
    assert all(np.shares_memory(a, b) for a, b in zip(picture, moved, strict=True))
    assert still_bands(2).moved(picture, components=1)[0].shape == (1, 12, 16)


def test_both_ways_add_up() -> None:
    ways = BandWays([None, shift(2)], {}, {}, [])
    reference, other = ways.moved([ramp(), ramp()], shift(3))
    inner = np.s_[:, 3:9, 2:8]
    np.testing.assert_allclose(reference[inner], ramp()[inner] + 3, atol=1e-5)
    np.testing.assert_allclose(other[inner], ramp()[inner] + 5, atol=1e-5)


def test_a_band_that_shows_nothing_stays_and_is_named() -> None:
    lit = np.zeros((1, 32, 32), np.float32)
    lit[0, 8:24, 8:24] = 1
    plain = {"members": [], "around": [], "components": ["total"], "moving": False, "apart": False}
    shots = Shots.of({**plain, "bands_nm": [434.0, 576.0]})
    ways = find_band_ways({"C": [0 * lit, lit]}, shots, bands="auto", reference=1, still=True)
    assert ways.flows == [None, None]
    (sentence,) = ways.warnings
    assert sentence.startswith("434 nm shows nothing by which it could be aligned to 576 nm")
    assert ways.results["band_confidence"][0].max() == 0.25
    assert ways.results["band_confidence"][1].min() == 1

"""The kernel on pictures written here: what is passed on, what is left empty, what is lost."""

from typing import Any

import numpy as np
import pytest

from lightstage.kernels.motion.alignment import align

BANDS = [434.0, 576.0]
SETTINGS = {"bands": "none", "reference_band": 1, "flow": "dis", "iterations": 4, "middle": "refine"}


def pictures(*frames: int) -> dict[tuple[int, float], Any]:
    """(component, y, x) by frame and band, read-only."""
    generator = np.random.default_rng(0)
    out = {}
    for frame in frames:
        for band in BANDS:
            out[frame, band] = generator.uniform(0.2, 1, (2, 16, 20)).astype(np.float32)
            out[frame, band].flags.writeable = False
    return out


def shots(*members: Any, **more: Any) -> dict[str, Any]:
    known = {"bands_nm": BANDS, "components": ["diffuse", "specular"], "moving": False, "apart": False}
    return {"members": list(members), "around": [], **known, **more}


def test_a_still_set_is_passed_on_and_an_empty_place_stays_empty() -> None:
    radiance = pictures(0, 1, 2)
    told = shots([0, "X", -2.0], [1, "Xc", -1.0], [2, "C", 0.0], None)
    out = align(radiance, shots=told, engine="none", **SETTINGS)
    for frame in range(3):
        for b, band in enumerate(BANDS):
            np.testing.assert_array_equal(out["aligned"][frame, b], radiance[frame, band])
    assert not out["flow"][:3].any()
    assert (out["confidence"][:3] == 1).all()
    assert np.isnan(out["aligned"][3]).all()
    assert np.isnan(out["flow"][3]).all()
    assert not out["confidence"][3].any()
    off = [np.abs(radiance[0, b][0] + radiance[1, b][0] - radiance[2, b][0]) for b in BANDS]
    np.testing.assert_allclose(out["residual"], np.mean(off, axis=0), rtol=1e-5)
    assert out["stats"]["residual_after"] == out["stats"]["residual_before"]


def test_what_may_have_moved_and_was_not_aligned_is_doubted() -> None:
    told = shots([0, "X", -1.0], [1, "C", 0.0], moving=True)
    out = align(pictures(0, 1), shots=told, engine="none", **SETTINGS)
    assert (out["confidence"][0] == 0.25).all()
    assert (out["confidence"][1] == 1).all()


def test_a_picture_apart_has_no_member_dimension() -> None:
    radiance = pictures(3)
    out = align(radiance, shots=shots([3, "L03", 0.0], apart=True), engine="none", **SETTINGS)
    np.testing.assert_array_equal(out["aligned"], np.stack(list(radiance.values())))
    assert out["flow"].shape == (2, 16, 20)
    assert out["confidence"].min() == 1


@pytest.mark.parametrize("engine", ["motion", "direct"])
def test_a_black_picture_is_named_and_lost(engine: str) -> None:
    radiance = pictures(0, 1)
    radiance |= {(0, band): np.zeros((2, 16, 20), np.float32) for band in BANDS}
    out = align(radiance, shots=shots([0, "X", -1.0], [1, "C", 0.0], moving=True), engine=engine, **SETTINGS)
    (sentence,) = out["warnings"]
    assert sentence.startswith("frame 0 (X) is black beside frame 1 (C)")
    assert np.isnan(out["aligned"][0]).all()
    assert np.isnan(out["flow"][0]).all()
    assert not out["confidence"][0].any()
    np.testing.assert_array_equal(out["aligned"][1, 0], radiance[1, BANDS[0]])

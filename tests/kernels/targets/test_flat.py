"""The flat of a sensor whose answer is written down."""

import numpy as np
import pytest

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.flat import flat, verdict
from lightstage.kernels.targets.labels import FLAT_NUMBERS

SHAPE = (24, 32)
DARK = 16.0


def frame(light: float, seed: int = 0) -> np.ndarray:
    """Counts of even light with the noise of a sensor of 4 electrons a count."""
    noise = np.random.default_rng(seed).normal(0, np.sqrt(1 + light / 4), SHAPE)
    return np.clip(np.round(DARK + light + noise), 0, 1023).astype(np.uint16)


def numbers(measured: dict) -> dict:
    return dict(zip(FLAT_NUMBERS, measured["numbers"], strict=True))


def test_the_brightest_exposure_below_saturation_is_the_flat() -> None:
    lit = {(time, i): frame(1000 * time, i) for i, time in enumerate((0.2, 0.4, 0.6, 2.0))}
    measured = flat(lit, {}, white_level=1023, dark_picture=np.full(SHAPE, DARK))
    assert np.median(measured["mean"]) == pytest.approx(DARK + 600, abs=2)
    told = numbers(measured)
    assert told["frames"] == 1
    assert told["dark_known"] == 1
    assert told["linearity_percent"] < 0.5  # the noise of a median over 768 pixels
    assert told["offset"] == pytest.approx(DARK, abs=3)


def test_gain_needs_repeated_frames_of_both_kinds() -> None:
    lit = {(0.0, i): frame(600, i) for i in range(8)}
    unlit = {8 + i: frame(0, 100 + i) for i in range(8)}
    told = numbers(flat(lit, unlit, white_level=1023, dark_picture=None))
    # 768 pixels of 8 frames: a variance is good to 2 %
    assert told["electrons_per_count"] == pytest.approx(4, rel=0.1)
    assert np.isnan(told["linearity_percent"])  # the capture says no exposure
    assert np.isnan(numbers(flat(lit, {}, white_level=1023, dark_picture=None))["electrons_per_count"])


def test_a_dead_pixel_is_named_and_filled_in() -> None:
    counts = frame(600)
    counts[10, 20] = DARK
    counts.flags.writeable = False
    measured = flat({(0.0, 0): counts}, {}, white_level=1023, dark_picture=np.full(SHAPE, DARK))
    assert np.argwhere(measured["dead"]).tolist() == [[10, 20]]
    assert measured["mean"][10, 20] == pytest.approx(DARK + 600, rel=0.1)


def test_saturated_frames_are_refused() -> None:
    with pytest.raises(KernelError, match="saturated"):
        flat({(0.0, 0): frame(1000)}, {}, white_level=1023, dark_picture=None)


def test_without_a_dark_the_verdict_is_in_doubt() -> None:
    one = flat({(0.0, 0): frame(600)}, {}, white_level=1023, dark_picture=None)
    arrays = {name: np.stack([np.asarray(values)]) for name, values in one.items()}
    about = {"labels": {"polarisation": ["cross"]}, "facts": {"cameras": {"cross": "CAM1"}}}
    ((severity, sentence),) = verdict(arrays=arrays, **about)
    assert severity == "doubtful"
    assert "bind a dark item" in sentence

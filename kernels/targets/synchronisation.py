"""Which lights lit each frame of a test sequence: the kernel of `stages/calibration/synchronisation.py`.

Highlights are summed by `photometry.py`; what they say of the sequence is in `sync_check.py`.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.targets.ball_conic import Floats
from lightstage.kernels.targets.labels import TEST_PATTERNS
from lightstage.kernels.targets.photometry import Aperture, highlight_sums, variance
from lightstage.kernels.targets.sync_check import align, check
from lightstage.kernels.targets.verdicts import Verdict

Counts = NDArray[np.uint16]


def synchronisation(
    one_light: Mapping[int, Counts],
    unlit: Mapping[int, Counts],
    test: Mapping[tuple[int, str], Counts],
    at_px: Mapping[int, Floats],
    *,
    white_level: int,
    aperture: Aperture,
) -> Mapping[str, Any]:
    """Judge a test sequence.

    Args:
        one_light: (y, x) counts by the light that is on.
        unlit: one, by frame.
        test: the sequence, by frame and what it should show, one of TEST_PATTERNS.
        at_px: (spot, xy) of the one-light pictures.
        white_level: the count at which the sensor saturates.
        aperture: around a highlight.

    Returns:
        by frame of the sequence; see the declaration.
    """
    positions = np.stack([np.asarray(spot)[0, ::-1] for spot in at_px.values()])
    (ground,) = (np.asarray(picture, np.float64) for picture in unlit.values())
    around: dict[str, Any] = {"dark": ground, "white": white_level, "radius_px": aperture.radius_px}
    single, _ = highlight_sums(_stacked(one_light), positions, **around)
    sums, full = highlight_sums(_stacked(test), positions, **around)
    sums = np.where(full, np.nan, sums)
    declared = [name for _, name in test]
    numbers = np.array(list(one_light))
    *modulo, dark = TEST_PATTERNS
    patterns = {name: (numbers % len(modulo) == k).astype(float) for k, name in enumerate(modulo)}
    patterns[dark] = np.zeros(numbers.size)
    judged = check(sums, single, declared, patterns, variance=variance(sums, **aperture._asdict()))
    return {
        "found": np.array([TEST_PATTERNS.index(name) for name in judged.shown]),
        "declared": np.array([TEST_PATTERNS.index(name) for name in declared]),
        "step": judged.step,
        "wrong": judged.wrong,
        "leak_before_percent": judged.leak_before_percent,
        "leak_after_percent": judged.leak_after_percent,
        "leak_se_percent": judged.leak_se_percent,
        "unexplained_percent": judged.unexplained_percent,
        "drive": judged.drive,
    }


def _stacked(pictures: Mapping[Any, Counts]) -> Counts:
    return np.stack([np.asarray(picture) for picture in pictures.values()])


def prepare(
    *, white_level: int, aperture_px: float, electrons_per_count: float, read_noise_counts: float
) -> Mapping[str, Any]:
    """The context, and the parameters as one."""
    return {
        "white_level": white_level,
        "aperture": Aperture(aperture_px, electrons_per_count, read_noise_counts),
    }


def verdict(*, arrays: Mapping[str, Any]) -> Verdict:
    """What is out of order, and how much light leaks from one frame into the next."""
    shown = [TEST_PATTERNS[k] for k in arrays["found"]]
    declared = [TEST_PATTERNS[k] for k in arrays["declared"]]
    _, events = align(shown, declared)
    findings: Verdict = [("bad", event.says) for event in events]
    if not findings:
        findings = [("good", f"all {len(shown)} frames show what was meant, in order")]
    for side, name in (("before", "the illumination before"), ("after", "the illumination after")):
        leak = arrays[f"leak_{side}_percent"]
        if np.isfinite(leak).any():
            error = float(np.nanmedian(arrays["leak_se_percent"]))
            sentence = (
                f"{float(np.nanmedian(leak)):.2f} % of the light is of {name} (median; worst "
                f"{float(np.nanmax(leak)):.2f} %, each +- {error:.2f})"
            )
            findings.append(("good", sentence))
    return findings

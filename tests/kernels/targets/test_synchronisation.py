"""A test sequence whose lights are known."""

import numpy as np
import pytest

from lightstage.kernels.targets.labels import TEST_PATTERNS
from lightstage.kernels.targets.photometry import Aperture
from lightstage.kernels.targets.synchronisation import prepare, synchronisation, verdict
from tests.kernels.targets.spots import picture

PLACES = {n: (25.3 + 14 * (n % 8), 30.6 + 25 * (n // 8)) for n in range(16)}
ORDER = ("T0", "T1", "T2", "T3", "T0", "T1", "T2", "T3")


def lit(drive: dict[int, float]) -> np.ndarray:
    return picture([PLACES[n] for n in drive], [500 * share for share in drive.values()])


def pattern(name: str) -> dict[int, float]:
    return {n: 1.0 for n in PLACES if n % 4 == int(name[1:])}


def judged(pictures: list[dict[int, float]]) -> dict:
    return dict(
        synchronisation(
            {n: lit({n: 1.0}) for n in PLACES},
            {16: lit({})},
            {(17 + i, name): lit(drive) for i, (name, drive) in enumerate(zip(ORDER, pictures, strict=True))},
            {n: np.array([place, [np.nan, np.nan]]) for n, place in PLACES.items()},
            white_level=1023,
            aperture=Aperture(2.5, 10.0, 1.0),
        )
    )


def test_a_sound_sequence_is_in_order() -> None:
    arrays = judged([pattern(name) for name in ORDER])
    assert [TEST_PATTERNS[k] for k in arrays["found"]] == list(ORDER)
    assert not arrays["wrong"].any()
    assert verdict(arrays=arrays)[0] == ("good", "all 8 frames show what was meant, in order")
    # a light is on or off: counts are whole
    np.testing.assert_allclose(arrays["drive"][0], [float(n % 4 == 0) for n in PLACES], atol=0.02)


def test_neighbours_that_were_swapped_are_named() -> None:
    order = [*ORDER[:2], ORDER[3], ORDER[2], *ORDER[4:]]
    severity, sentence = verdict(arrays=judged([pattern(name) for name in order]))[0]
    assert severity == "bad"
    assert "2 and 3 are swapped" in sentence


def test_light_of_the_frame_before_is_measured() -> None:
    leaking = [
        {**dict.fromkeys(pattern(name), 0.95), **(dict.fromkeys(pattern(ORDER[i - 1]), 0.05) if i else {})}
        for i, name in enumerate(ORDER)
    ]
    arrays = judged(leaking)
    # 25 counts of 500, each rounded
    np.testing.assert_allclose(arrays["leak_before_percent"][1:], 5, atol=0.5)


def test_parameters_become_one() -> None:
    numbers = prepare(white_level=1023, aperture_px=3.0, electrons_per_count=8.0, read_noise_counts=0.5)
    assert numbers["aperture"] == Aperture(3.0, 8.0, 0.5)
    assert numbers["white_level"] == pytest.approx(1023)

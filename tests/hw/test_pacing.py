"""Rates by hand, and brightness against closed forms and a sampled Fourier transform."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.hw.errors import RigError
from lightstage.hw.geodesic import light_positions
from lightstage.hw.pacing import Flicker, Timing, flicker, starts_s, tracking_rate_hz
from lightstage.hw.sequence import cycle, multispectral, static


def seen(sequence: tuple[str, ...], timing: Timing, **options: object) -> dict[str, Flicker]:
    return {one.view: one for one in flicker(sequence, timing, **options)}  # type: ignore[arg-type]


def test_rates_by_hand() -> None:
    timing = Timing(exposure_ms=10, setup_ms=23, readout_ms=7)
    assert timing.period_s == pytest.approx(0.040)
    assert timing.frame_rate_hz == pytest.approx(25)
    assert tracking_rate_hz(cycle("wilson"), timing) == pytest.approx(6.25)
    assert tracking_rate_hz(cycle("minimal"), timing) == pytest.approx(25 / 3)
    assert Timing(exposure_ms=10, setup_ms=23, readout_ms=7, overlap=True).period_s == pytest.approx(0.033)
    assert starts_s(("X", "Z", "C"), timing) == pytest.approx((0, 0.04, 0.08))


def test_the_wheel_turns_between_bands_only() -> None:
    starts = starts_s(multispectral((407, 576)), Timing(exposure_ms=100, wheel_ms=650))
    assert starts[6] == pytest.approx(0.6)
    assert starts[7] == pytest.approx(1.35)
    assert starts[13] == pytest.approx(1.95)


def test_the_fundamental_of_a_square_wave() -> None:
    """C and X in turn at 20 a second: total light is a square wave of 10 Hz between 1 and 1/2, whose fundamental
    has the amplitude 4 / pi * 1/4. Its harmonics only make it square."""
    total = seen(("C", "X"), Timing(exposure_ms=50))["total"]
    assert total.lines == ((pytest.approx(10), pytest.approx(2 / np.pi, rel=1e-3)),)
    assert total.swing == pytest.approx(2 / np.pi, rel=1e-3)
    assert total.flashes


def test_z_and_its_complement_flash_for_who_looks_into_the_camera() -> None:
    """Integrals over the half sphere: 5/6 and 1/6. 641 lights come within 2 % of them."""
    views = seen(("Z", "Zc"), Timing(exposure_ms=50), lights=light_positions(8))
    assert not views["total"].flashes
    assert views["front"].swing == pytest.approx(4 / np.pi * (1 - 1 / 5), rel=0.02)
    assert views["back"].flashes
    assert not views["left"].flashes


def test_sides_in_turn_flash_although_the_total_does_not() -> None:
    views = seen(("X", "Xc"), Timing(exposure_ms=50))
    assert not views["total"].flashes
    assert views["left"].flashes
    assert views["right"].flashes


@pytest.mark.parametrize(("rate", "flashes"), [(5.9, False), (6, True), (20, True), (60, True), (60.2, False)])
def test_only_3_to_30_hz_count(rate: float, flashes: bool) -> None:
    assert seen(("C", "X"), Timing(exposure_ms=1000 / rate))["total"].flashes == flashes


@pytest.mark.parametrize(("kind", "hz"), [("minimal", 20 / 3), ("wilson", 5)])
def test_total_light_of_a_performance_flashes_at_the_tracking_rate(kind: str, hz: float) -> None:
    """The thesis' 20 pictures a second."""
    total = seen(cycle(kind), Timing(exposure_ms=50))["total"]  # type: ignore[arg-type]
    assert total.strongest_hz == pytest.approx(hz)
    assert total.swing > 0.4


def test_a_fast_sequence_still_flashes_slowly_to_the_eyes() -> None:
    """At 100 pictures a second the tracking rate is 33 Hz, but Z and Zc come back only once in nine pictures."""
    views = seen(cycle("minimal", sets="mixed"), Timing(exposure_ms=10))
    assert views["front"].flashes
    assert views["front"].strongest_hz == pytest.approx(100 / 9)
    assert views["total"].swing < 0.1 * views["front"].swing
    assert not any(one.flashes for one in flicker(cycle("minimal", sets="mixed"), Timing(exposure_ms=1000 / 300)))


def test_slow_sequences_do_not_flash() -> None:
    for sequence in (cycle("minimal"), cycle("wilson"), static()):
        assert not any(one.flashes for one in flicker(sequence, Timing(exposure_ms=400)))
    assert not any(one.flashes for one in flicker(multispectral((407, 576)), Timing(exposure_ms=400, wheel_ms=650)))


def test_lights_that_go_off_flash_at_the_frame_rate() -> None:
    """On for 50 of 100 ms: a square wave of 10 Hz between 1 and 0."""
    dark = seen(("C",), Timing(exposure_ms=50, setup_ms=30, readout_ms=20, dark_pauses=True))["total"]
    assert dark.lines == ((pytest.approx(10), pytest.approx(4 / np.pi)),)
    assert not seen(("C",), Timing(exposure_ms=50, setup_ms=50))["total"].lines


@settings(max_examples=25, deadline=None)
@given(st.lists(st.sampled_from(["C", "X", "Yc", "Z", "Zc", "O", "L03"]), min_size=1, max_size=12), st.booleans())
def test_lines_are_those_of_a_sampled_transform(sequence: list[str], dark: bool) -> None:
    """The same light sampled 480 times a picture; lines below 20 Hz are then known to 0.2 % of the brightest."""
    timing = Timing(exposure_ms=30, setup_ms=20, dark_pauses=dark)
    one = seen(tuple(sequence), timing)["total"]
    lights = light_positions(2)[:, [2, 1]]
    level = {
        "C": 41.0, "X": 20.5, "Yc": np.sum(1 - lights[:, 1]) / 2, "Z": np.sum(1 + lights[:, 0]) / 2,
        "Zc": np.sum(1 - lights[:, 0]) / 2, "O": 0.0, "L03": 1.0,
    }  # fmt: skip
    bright = np.concatenate([[level[n]] * 288 + [0 if dark else level[n]] * 192 for n in sequence])
    bright = bright / max(bright.max(), 1e-30)
    spectrum = np.fft.rfft(bright) / bright.size
    hz = np.arange(spectrum.size) / (0.05 * len(sequence))
    wanted = {round(f, 6): 4 * abs(c) for f, c in zip(hz, spectrum, strict=True) if f > 0}
    top = 20 if dark else 10
    for frequency, swing in one.lines:
        assert 3 - 1e-6 <= frequency <= top + 1e-6
        assert swing == pytest.approx(wanted[round(frequency, 6)], abs=0.002)
    strong = {f for f, swing in wanted.items() if swing > 0.015 and 3 <= f <= top}
    assert strong <= {round(f, 6) for f, _ in one.lines}


@pytest.mark.parametrize("wrong", [{"exposure_ms": 0}, {"exposure_ms": 5, "setup_ms": -1}, {"exposure_ms": np.nan}])
def test_impossible_times_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(RigError, match="a number of milliseconds"):
        Timing(**wrong)


def test_a_light_that_is_not_there_and_a_cycle_of_ten_minutes_are_refused() -> None:
    with pytest.raises(RigError, match="L00 to L40"):
        flicker(("L99",), Timing(exposure_ms=50))
    with pytest.raises(RigError, match="too long"):
        flicker(("C", "X") * 30_000, Timing(exposure_ms=10))

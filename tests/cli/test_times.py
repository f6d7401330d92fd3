"""The times of a rig as options."""

import argparse

import pytest

from lightstage.cli.times import add_timing, timing_of
from lightstage.store.errors import RequestError


def options(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_timing(parser)
    return parser.parse_args(words)


def test_times_are_read_and_what_is_not_named_is_none() -> None:
    timing = timing_of(options("--exposure-ms", "10", "--setup-ms", "2.5"))
    assert timing is not None
    assert (timing.exposure_ms, timing.setup_ms, timing.readout_ms, timing.wheel_ms) == (10, 2.5, 0, 0)
    assert not timing.overlap
    # one picture after the other: 1000 / (10 + 2.5)
    assert timing.frame_rate_hz == pytest.approx(80)


def test_reading_out_while_the_lights_are_set_up_takes_the_longer_of_the_two() -> None:
    words = ("--exposure-ms", "10", "--setup-ms", "4", "--readout-ms", "6")
    apart, together = (timing_of(options(*words, *more)) for more in ((), ("--overlap", "--dark-pauses")))
    assert apart is not None
    assert together is not None
    assert apart.frame_rate_hz == pytest.approx(1000 / 20)
    assert together.frame_rate_hz == pytest.approx(1000 / 16)
    assert together.dark_pauses


def test_a_capture_says_its_rate_where_no_option_does() -> None:
    assert timing_of(options()) is None
    timing = timing_of(options(), rate_hz=50)
    assert timing is not None
    assert timing.exposure_ms == 20
    named = timing_of(options("--exposure-ms", "5"), rate_hz=50)
    assert named is not None
    assert named.exposure_ms == 5


@pytest.mark.parametrize("words", [("--setup-ms", "1"), ("--readout-ms", "0"), ("--overlap",), ("--dark-pauses",)])
def test_nothing_stands_without_an_exposure(words: tuple[str, ...]) -> None:
    with pytest.raises(RequestError, match=f"{words[0]} stands alone"):
        timing_of(options(*words), rate_hz=50)


def test_a_time_that_cannot_be_is_refused() -> None:
    with pytest.raises(RequestError, match="exposure"):
        timing_of(options("--exposure-ms", "-1"))

"""What `stimuli` lets one choose."""

import argparse

import pytest

from lightstage.cli.stimulus_options import add_options, check, levels_of
from lightstage.store.errors import RequestError


def options(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_options(parser)
    return parser.parse_args(["a", *words])


def test_the_defaults_are_right() -> None:
    chosen = options()
    check(chosen)
    assert (chosen.kinds, chosen.match, chosen.across) == ("shape,texture,both", "mean-contrast", "set")
    assert levels_of(chosen.levels) == [0, 0.25, 0.5, 0.75, 1]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--match", "histogram,none"), "none stands alone"),
        (("--match", "none", "--mean", "0.5"), "are met by matching"),
        (("--kinds", "both,both"), "stands twice"),
        (("--contrast", "0.6"), "above 0 and up to 0.5"),
        (("--eyes-px", "10"), "above 15 and up to 2000"),
        (("--levels", "0,x"), "expected numbers from 0 to 1"),
    ],
)
def test_what_cannot_be_meant(words: tuple[str, ...], said: str) -> None:
    with pytest.raises(RequestError, match=said):
        check(options(*words))

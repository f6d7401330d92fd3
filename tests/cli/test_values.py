"""Numbers and places given as options."""

import argparse

import pytest

from lightstage.cli.values import number, pixel, whole
from lightstage.store.errors import RequestError


def test_numbers_are_read() -> None:
    assert (whole("-12"), whole("0")) == (-12, 0)
    assert (number("1e-3"), number("-0.5"), number("7")) == (0.001, -0.5, 7.0)
    assert isinstance(whole("3"), int)


@pytest.mark.parametrize("text", ["", "x", "1.5", "1e3", "nan"])
def test_what_is_no_whole_number_is_refused(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match=f"a whole number is expected, found '{text}'"):
        whole(text)


@pytest.mark.parametrize("text", ["", "x", "nan", "inf", "-inf", "1e999"])
def test_what_is_no_finite_number_is_refused(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match=f"a finite number is expected, found '{text}'"):
        number(text)


@pytest.mark.parametrize("read", [whole, number])
def test_what_is_absurdly_large_is_refused(read: type) -> None:
    for text in ("1" + 40 * "0", "-1" + 40 * "0"):
        with pytest.raises(argparse.ArgumentTypeError, match=r"is larger than .*, which is the most"):
            read(text)


def test_a_pixel_is_a_pair_of_whole_numbers() -> None:
    assert (pixel("3,4"), pixel("-1, 0")) == ((3, 4), (-1, 0))
    for text in ("", "3", "3,4,5", "a,b", "1.5,2"):
        with pytest.raises(RequestError, match=f"--at {text}: expected X,Y in whole pixels"):
            pixel(text)

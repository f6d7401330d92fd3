"""Numbers and places given as options: what no command could make sense of is refused before one begins.

Which numbers are right is each command's business; here it is only that they are finite and not absurd, as in a
file (`store.document`, which is imported when a number is given, not before).
"""

import argparse
import math

from lightstage.api.errors import RequestError


def whole(text: str) -> int:
    """A whole number.

    Raises:
        argparse.ArgumentTypeError: it is none, or too large.
    """
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"a whole number is expected, found '{text}'") from None
    return int(_bounded(value, text))


def number(text: str) -> float:
    """A finite number.

    Raises:
        argparse.ArgumentTypeError: it is none, infinite, or too large.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"a finite number is expected, found '{text}'")
    return _bounded(value, text)


def pixel(text: str) -> tuple[int, int]:
    """(x, y) of an --at.

    Raises:
        RequestError: it is no pair of whole numbers.
    """
    try:
        x, y = (int(part) for part in text.split(","))
    except ValueError:
        raise RequestError(f"--at {text}: expected X,Y in whole pixels, such as 120,200") from None
    return x, y


def _bounded(value: float, text: str) -> float:
    from lightstage.store.document import LARGEST

    if abs(value) > LARGEST:
        raise argparse.ArgumentTypeError(f"{text} is larger than {LARGEST:g}, which is the most")
    return value

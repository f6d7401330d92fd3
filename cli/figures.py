"""matplotlib, as every command uses it: no window, and nothing written to the user's home."""

from functools import cache
from pathlib import Path
from typing import Any


@cache
def pyplot() -> Any:
    """`matplotlib.pyplot`, for files."""
    _matplotlib().use("Agg")
    import matplotlib.pyplot

    return matplotlib.pyplot


def fonts() -> Path:
    """The folder of the fonts that matplotlib brings."""
    return Path(_matplotlib().get_data_path(), "fonts", "ttf")


def _matplotlib() -> Any:
    from lightstage.home import spare_home

    spare_home()
    import matplotlib

    return matplotlib

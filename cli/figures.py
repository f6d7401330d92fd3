"""matplotlib, as every command uses it: no window, the same look for everybody, nothing written to the user's home.

matplotlib makes a folder of settings and a list of fonts in the home. Here it gets a folder that lasts as long as
the process, so the settings that somebody keeps there do not change our figures either.
"""

import atexit
import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any


@cache
def pyplot() -> Any:
    """`matplotlib.pyplot`, for files."""
    with _own_folder():
        import matplotlib

        matplotlib.use("Agg")
        import matplotlib.pyplot

        return matplotlib.pyplot


def fonts() -> Path:
    """The folder of the fonts that matplotlib brings."""
    with _own_folder():
        import matplotlib

        return Path(matplotlib.get_data_path(), "fonts", "ttf")


@cache
def _folder() -> str:
    import shutil
    import tempfile

    folder = tempfile.mkdtemp(prefix="lightstage-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@contextmanager
def _own_folder() -> Iterator[None]:
    before = os.environ.get("MPLCONFIGDIR")
    os.environ["MPLCONFIGDIR"] = _folder()
    try:
        yield
    finally:
        # the processes that this one starts have no such folder
        if before is None:
            del os.environ["MPLCONFIGDIR"]
        else:
            os.environ["MPLCONFIGDIR"] = before

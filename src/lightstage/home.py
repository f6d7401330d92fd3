"""The user's home, which matplotlib would write to: it makes a folder of settings and a list of fonts there.

It is loaded with colour-science also where nothing is drawn. It gets a folder that lasts as long as the process, so
the settings that somebody keeps in the home do not change our figures either.
"""

import atexit
import os

_TEMPORARY = ("TMPDIR", "TEMP", "TMP")
"""Environment variables that name a folder for what is temporary; `tempfile`, which asks for more, loads long."""


def spare_home() -> None:
    """Give matplotlib, when it is loaded, a folder of its own; for this process and those that it starts."""
    if "MPLCONFIGDIR" in os.environ:
        return
    places = [os.environ[name] for name in _TEMPORARY if os.environ.get(name)] + ["/tmp", "/var/tmp"]
    usable = (place for place in places if os.path.isdir(place) and os.access(place, os.W_OK | os.X_OK))
    place = next(usable, None)
    if place is None:  # matplotlib says what it needs
        return
    folder = os.path.join(os.path.abspath(place), f"lightstage-{os.urandom(8).hex()}")
    os.environ["MPLCONFIGDIR"] = folder
    atexit.register(_remove, folder)


def _remove(folder: str) -> None:
    if os.path.isdir(folder):
        import shutil

        shutil.rmtree(folder, ignore_errors=True)

"""The user's home, which matplotlib would write to: it makes a folder of settings and a list of fonts there.

It is loaded with colour-science also where nothing is drawn. It gets a folder that lasts as long as the process, so
the settings that somebody keeps in the home do not change our figures either.
"""

import os


def spare_home() -> None:
    """Give matplotlib, when it is loaded, a folder of its own; for this process and those that it starts."""
    if "MPLCONFIGDIR" in os.environ:
        return
    import atexit
    import secrets
    import shutil
    import tempfile

    try:
        folder = os.path.join(tempfile.gettempdir(), f"lightstage-{secrets.token_hex(8)}")
    except FileNotFoundError:  # no folder for what is temporary; matplotlib says what it needs
        return
    os.environ["MPLCONFIGDIR"] = folder
    atexit.register(shutil.rmtree, folder, ignore_errors=True)

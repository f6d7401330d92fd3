"""matplotlib, its fonts and a colour scale, as every product uses them: no window, nothing in the user's home.

Light to import.
"""

import io
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from PIL.ImageFont import FreeTypeFont

_DOTS_PER_INCH = 110
"""A figure of ten inches is as wide as a browser's window."""


@cache
def pyplot() -> Any:
    """`matplotlib.pyplot`, for files."""
    _matplotlib().use("Agg")
    import matplotlib.pyplot

    return matplotlib.pyplot


def png_of(figure: Any) -> bytes:
    """A figure of `pyplot` as a PNG; it is closed."""
    data = io.BytesIO()
    try:
        figure.savefig(data, format="png", dpi=_DOTS_PER_INCH)
    finally:
        pyplot().close(figure)
    return data.getvalue()


@cache
def font(size: int) -> "FreeTypeFont":
    """The font that matplotlib brings; OpenCV's has no degree sign."""
    from PIL import ImageFont

    return ImageFont.truetype(Path(_matplotlib().get_data_path(), "fonts", "ttf", "DejaVuSans.ttf"), size)


@cache
def colours() -> "NDArray[np.uint8]":
    """256 colours (rgb), viridis: its 0 is purple, so that black is free to say 'not known'."""
    import cv2
    import numpy as np

    steps = np.arange(256, dtype=np.uint8)[:, None]
    return np.asarray(cv2.applyColorMap(steps, cv2.COLORMAP_VIRIDIS)[:, 0, ::-1].copy(), np.uint8)


def _matplotlib() -> Any:
    from lightstage.home import spare_home

    spare_home()
    import matplotlib

    return matplotlib

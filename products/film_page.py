"""A frame of the film: three panels beside each other.

colour      (n + 1) / 2, green up (OpenGL) or down (DirectX)
relit       max(0, n . l), l one distant light to the upper left of the camera (Lambert 1760), albedo 1
change      atan2(|n x m|, n . m) in degrees, m the normal at the same pixel one frame before
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow
from PIL import ImageDraw

from lightstage.formats.video import even
from lightstage.products.choices import CONVENTIONS
from lightstage.products.counts import shown_8
from lightstage.products.figures import colours, font

Image = NDArray[np.float32]
Picture = NDArray[np.uint8]
"""(y, x, rgb)."""
LIGHT = (-0.5, 0.3, math.sqrt(1 - 0.5**2 - 0.3**2))
"""Towards the light: left, up and mostly frontal. World axes: x right, y up, z towards the camera."""
NO_CHANGE_RGB = (56, 56, 56)
"""Where there is no frame before to compare with; black says that there is no normal."""
_NARROW, _WIDE = 360, 640
"""Pixels across a panel: enough for its text, and three of them within what browsers decode quickly."""
_GAP, _HEAD, _TITLE, _FOOT = 12, 34, 26, 48


def angle_deg(normal: Image, before: Image) -> Image:
    """Angle between two maps (y, x, xyz) in degrees, exact near 0; NaN where either is."""
    across = np.linalg.norm(np.cross(normal, before), axis=-1)
    return np.asarray(np.degrees(np.arctan2(across, np.sum(normal * before, axis=-1))), np.float32)


def as_colour(normal: Image, convention: str) -> Picture:
    """(y, x, rgb); black where there is no normal."""
    sign = np.array([1, -1 if convention == "directx" else 1, 1], np.float32)
    return shown_8((normal * sign + 1) / 2)


def relit(normal: Image) -> Picture:
    """(y, x, rgb) grey: n . LIGHT as it is, without display gamma, which would flatten the relief."""
    shade = shown_8(np.maximum(normal @ np.array(LIGHT, np.float32), 0))
    return np.repeat(shade[..., None], 3, axis=-1)


def as_map(change_deg: Image | None, top_deg: float, shape: tuple[int, int]) -> Picture:
    """(y, x, rgb) on the colour scale from 0 to `top_deg`; black where not valid, grey where nothing was before."""
    if change_deg is None:
        return np.full((*shape, 3), NO_CHANGE_RGB, np.uint8)
    colour = colours()[shown_8(change_deg / np.float32(top_deg))]
    colour[~np.isfinite(change_deg)] = 0
    return colour


class Layout:
    """Where the panels and the text are; what does not change from frame to frame is drawn once."""

    def __init__(self, shape: tuple[int, int], *, convention: str, top_deg: float) -> None:
        height, width = shape
        if width < _NARROW:
            times = -(-_NARROW // width)
            self.panel = (width * times, height * times)
        else:
            scale = min(1.0, _WIDE / width)
            self.panel = (max(1, round(width * scale)), max(1, round(height * scale)))
        self._grown = width < _NARROW
        self._convention = convention
        self.top_deg = top_deg
        across, down = self.panel
        self.size = (even(3 * across + 4 * _GAP), even(_HEAD + _TITLE + down + _FOOT))
        self._template = self._draw_template()

    def left(self, panel: int) -> int:
        """The first column of a panel."""
        return _GAP + panel * (self.panel[0] + _GAP)

    @property
    def top(self) -> int:
        """The first row of the panels."""
        return _HEAD + _TITLE

    def _draw_template(self) -> Picture:
        canvas = np.full((self.size[1], self.size[0], 3), 24, np.uint8)
        foot = self.top + self.panel[1]
        bar = min(self.panel[0], 256)
        left = self.left(2)
        canvas[foot + 8 : foot + 20, left : left + bar] = colours()[np.linspace(0, 255, bar).astype(int)]
        image = Pillow.fromarray(canvas)
        draw = ImageDraw.Draw(image)
        small = font(13)
        for panel, title in enumerate(
            ("normals", "relit: n · l, one light upper left", "change since the frame before")
        ):
            draw.text((self.left(panel), _HEAD + 3), title, fill=(225, 225, 225), font=font(15))
        draw.text((self.left(0), foot + 6), CONVENTIONS[self._convention], fill=(170, 170, 170), font=small)
        draw.text((self.left(1), foot + 6), "black: no normal, or in shade", fill=(170, 170, 170), font=small)
        for at, text, anchor in (
            (left, "0°", "la"),
            (left + bar / 2, f"{self.top_deg / 2:g}°", "ma"),
            (left + bar, f"{self.top_deg:g}° or more", "ma"),
        ):
            draw.text((at, foot + 24), text, fill=(200, 200, 200), font=small, anchor=anchor)
        return np.asarray(image)

    def draw(self, caption: str, normal: Image, before: Image | None) -> Picture:
        """One frame (y, x, rgb). `before` is None for the first."""
        canvas = self._template.copy()
        change = None if before is None else angle_deg(normal, before)
        shape = (normal.shape[0], normal.shape[1])
        for panel, picture in enumerate(
            (as_colour(normal, self._convention), relit(normal), as_map(change, self.top_deg, shape))
        ):
            fitted = cv2.resize(
                picture, self.panel, interpolation=cv2.INTER_NEAREST if self._grown else cv2.INTER_AREA
            )
            canvas[self.top : self.top + self.panel[1], self.left(panel) : self.left(panel) + self.panel[0]] = (
                fitted
            )
        image = Pillow.fromarray(canvas)
        draw = ImageDraw.Draw(image)
        draw.text((_GAP, 8), caption, fill=(255, 255, 255), font=font(17))
        if change is None:
            words = "no frame before"
        elif np.isfinite(change).any():
            words = f"mean {np.nanmean(change):.2f}°"
        else:
            words = "no normals to compare"
        right = self.left(2) + self.panel[0]
        draw.text((right, _HEAD + 3), words, fill=(255, 255, 255), font=font(15), anchor="ra")
        return np.asarray(image)

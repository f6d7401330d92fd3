"""The page of an alignment.

Top row the pictures as captured, below them the same aligned, each column on one brightness scale. Marked points
lie at the same coordinates in every picture: where the alignment is right, the cross hair stays on one place of the
subject. Then how well: the residual before and after, the least confidence of the members, and the flow of the
member that moves most, as arrows from the tracking frame to the picture.

The layout is that of the figure "Alignment of spherical gradient images" in Dutta (2010), chapter 4.
"""

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow
from PIL import ImageDraw

from lightstage.products.alignment import CONFIDENT, AlignedSet, Column, Residual, least_confidence, length
from lightstage.products.figures import colours, font

Image = NDArray[np.float32]
Picture = NDArray[np.uint8]
"""(y, x, rgb)."""
Rgb = tuple[int, int, int]
GAMMA = 2.2
BACKGROUND_RGB = (24, 24, 24)
UNKNOWN_RGB = (70, 30, 90)
"""Violet: no grey of a picture, and no colour of the points."""
UNKNOWN_VALUE_RGB = (90, 90, 90)
"""Grey: not on the colour scale, which begins with violet."""
POINT_RGB = ((255, 80, 70), (90, 220, 90), (80, 170, 255))
_WHITE, _PALE = (255, 255, 255), (190, 190, 190)
_GAP, _HEAD, _ROW, _TITLE, _FOOT = 12, 36, 26, 20, 60
_PANEL, _NARROWEST, _PAGE = 300, 120, 2400
"""Pixels across a picture, and at the least where there are so many that the page gets wider than the last."""
_KEYS_PX = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100)
"""How long the key's arrow may be."""


def box(width: int) -> tuple[int, int]:
    """Half the side of a point's box, and its side, in pixels of the picture."""
    half = max(3, width // 28)
    return half, 2 * half + 1


class Page:
    """Where things are on the page, and the pens."""

    def __init__(self, shape: tuple[int, int], columns: int) -> None:
        height, width = shape
        across = max(_NARROWEST, min(_PANEL, _PAGE // columns))
        self.scale: float = -(-across // width) if width < across else across / width
        self.panel = (max(1, round(width * self.scale)), max(1, round(height * self.scale)))
        self.inset = (self.panel[0] - 2 * 4) // 3
        self.row = _ROW + _TITLE + self.panel[1] + 4 + self.inset + _GAP
        """The height of a row of pictures."""
        self.size = (
            max(columns, 4) * (self.panel[0] + _GAP) + _GAP,
            _HEAD + 2 * self.row + _ROW + _TITLE + self.panel[1] + _FOOT,
        )
        self.image = Pillow.new("RGB", self.size, BACKGROUND_RGB)
        self.pen = ImageDraw.Draw(self.image)

    def left(self, column: int) -> int:
        """The first column of a tile."""
        return _GAP + column * (self.panel[0] + _GAP)

    def top(self, row: int) -> int:
        """The first row of a row's pictures."""
        return _HEAD + row * self.row + _ROW + _TITLE

    def place(self, picture: Picture, left: int, top: int, size: tuple[int, int]) -> None:
        """Put a picture (y, x, rgb) there, in that size."""
        grows = size[0] >= picture.shape[1]
        fitted = cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST if grows else cv2.INTER_AREA)
        self.image.paste(Pillow.fromarray(fitted), (left, top))

    def text(
        self, at: tuple[float, float], words: str, size: int = 13, rgb: Rgb = _PALE, anchor: str = "la"
    ) -> None:
        """Write."""
        self.pen.text(at, words, fill=rgb, font=font(size), anchor=anchor)

    def at(self, column: int, row: int, point: tuple[float, float]) -> tuple[float, float]:
        """The middle of a pixel of a tile's picture, on the page."""
        return (
            self.left(column) + (point[0] + 0.5) * self.scale,
            self.top(row) + (point[1] + 0.5) * self.scale,
        )


def draw(aligned: AlignedSet, points: Sequence[tuple[int, int]], residual: Residual | None) -> Picture:
    """The page."""
    middle, columns = aligned.middle, aligned.columns
    page = Page((middle.captured.shape[0], middle.captured.shape[1]), len(columns))
    time = "" if middle.time_s is None else f"    {1000 * middle.time_s:.1f} ms"
    title = f"{aligned.session}    tracking frame {aligned.tracking}{time}    engine {aligned.engine}"
    page.text((_GAP, 8), title, 18, _WHITE)
    page.text((_GAP, page.top(0) - _TITLE - _ROW + 2), "as captured", 16, _WHITE)
    page.text((_GAP, page.top(1) - _TITLE - _ROW + 2), "aligned to the tracking frame", 16, _WHITE)
    for i, column in enumerate(columns):
        values = np.concatenate([p[np.isfinite(p)] for p in (column.captured, column.aligned)])
        top = float(np.percentile(values, 99.5)) if values.size else 1.0
        tracking = column is middle
        page.text((page.left(i), page.top(0) - _TITLE), column.caption, rgb=_WHITE if tracking else _PALE)
        sure = column.confidence >= CONFIDENT
        words = "the tracking frame" if tracking else "left out: does not belong to the set"
        if not tracking and not column.left_out:
            moved = length(column.flow)[sure & np.isfinite(column.flow).all(axis=0)]
            words = f"moved by {np.median(moved):.2f} px (median)" if moved.size else "nowhere sure"
        page.text((page.left(i), page.top(1) - _TITLE), words, rgb=_WHITE if tracking else _PALE)
        for row, picture in enumerate((column.captured, column.aligned)):
            _draw_picture(page, i, row, as_grey(picture, top), points)
    _draw_measures(page, middle, columns, residual)
    return np.asarray(page.image)


def as_grey(picture: Image, top: float) -> Picture:
    """(y, x, rgb), white at `top`, with display gamma; UNKNOWN_RGB where not known."""
    unit = np.clip(np.nan_to_num(picture) / max(top, 1e-30), 0, 1) ** (1 / GAMMA)
    grey = np.repeat(np.round(unit * 255).astype(np.uint8)[..., None], 3, axis=-1)
    grey[~np.isfinite(picture)] = UNKNOWN_RGB
    return grey


def as_colours(values: Image, top: float) -> Picture:
    """(y, x, rgb) on the colour scale from 0 to `top`; UNKNOWN_VALUE_RGB where not known."""
    unit = np.clip(np.nan_to_num(values) / max(top, 1e-30), 0, 1)
    rgb: Picture = colours()[np.round(unit * 255).astype(np.uint8)]
    rgb[~np.isfinite(values)] = UNKNOWN_VALUE_RGB
    return rgb


def _draw_picture(page: Page, column: int, row: int, picture: Picture, points: Sequence[tuple[int, int]]) -> None:
    """A picture with its points, and below it what is in their boxes, larger."""
    half, side = box(picture.shape[1])
    padded = np.pad(picture, ((half, half), (half, half), (0, 0)))
    page.place(picture, page.left(column), page.top(row), page.panel)
    foot = page.top(row) + page.panel[1] + 4
    for i, (x, y) in enumerate(points):
        rgb = POINT_RGB[i]
        left, top = page.at(column, row, (x - half - 0.5, y - half - 0.5))
        right, bottom = page.at(column, row, (x + half + 0.5, y + half + 0.5))
        page.pen.rectangle((left, top, right, bottom), outline=rgb)
        _draw_cross(page, page.at(column, row, (x, y)), (right - left) / 2, rgb)
        page.text((right + 3, top - 2), str(i + 1), 13, rgb)
        start = page.left(column) + i * (page.inset + 4)
        page.place(padded[y : y + side, x : x + side], start, foot, (page.inset, page.inset))
        end = (start + page.inset - 1, foot + page.inset - 1)
        page.pen.rectangle((start, foot, *end), outline=rgb)
        _draw_cross(page, (start + page.inset / 2, foot + page.inset / 2), page.inset / 2, rgb)
        page.text((start + 4, foot + 2), str(i + 1), 13, rgb)


def _draw_cross(page: Page, middle: tuple[float, float], reach: float, rgb: Rgb) -> None:
    """A cross hair that leaves the point itself free."""
    x, y = middle
    for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        page.pen.line(
            (x + 0.2 * reach * dx, y + 0.2 * reach * dy, x + 0.75 * reach * dx, y + 0.75 * reach * dy), fill=rgb
        )


def _draw_measures(page: Page, middle: Column, columns: Sequence[Column], residual: Residual | None) -> None:
    """The third row: residuals, confidence, flow."""
    page.text((_GAP, page.top(2) - _TITLE - _ROW + 2), "how well", 16, _WHITE)
    foot = page.top(2) + page.panel[1] + 6
    tile = 0
    if residual is None:
        lacks = "a complement pair" if middle.illumination == "C" else "a picture under constant light"
        page.text((_GAP + 80, page.top(2) - _TITLE - _ROW + 4), f"(no residual: the set has not {lacks})", 13)
    else:
        known = residual.before[np.isfinite(residual.before)]
        top = max(float(np.percentile(known, 99)), 0.001)
        for name, values, mean in (
            ("before", residual.before, residual.mean_before),
            ("after", residual.after, residual.mean_after),
        ):
            page.text((page.left(tile), page.top(2) - _TITLE), f"|r + r' - c| / mean c, {name}")
            page.place(as_colours(values, top), page.left(tile), page.top(2), page.panel)
            _draw_scale(page, tile, foot, f"{top:.2g}")
            page.text((page.left(tile), foot + 30), f"mean {mean:.4f}", 14, _WHITE)
            tile += 1
    least = least_confidence(columns)
    page.text((page.left(tile), page.top(2) - _TITLE), "confidence, least of the members")
    page.place(as_colours(least, 1.0), page.left(tile), page.top(2), page.panel)
    _draw_scale(page, tile, foot, "1")
    share = 100 * float((least >= CONFIDENT).mean())
    page.text((page.left(tile), foot + 30), f"{share:.0f} % of the picture at least {CONFIDENT:g}", 13, _WHITE)
    _draw_flow(page, tile + 1, middle, columns, foot)
    unknown = "not known: violet in pictures, grey in maps"
    page.text((page.size[0] - _GAP, 10), unknown, 13, anchor="ra")


def _draw_scale(page: Page, tile: int, top: int, end: str) -> None:
    steps = colours()[np.linspace(0, 255, page.panel[0]).astype(int)]
    page.place(np.repeat(steps[None], 8, axis=0), page.left(tile), top, (page.panel[0], 8))
    page.text((page.left(tile), top + 11), "0", 12)
    page.text((page.left(tile) + page.panel[0], top + 11), end, 12, anchor="ra")


def _draw_flow(page: Page, tile: int, middle: Column, columns: Sequence[Column], foot: int) -> None:
    """Arrows on the dimmed tracking frame, where the flow is sure and the subject is lit."""
    height, width = middle.captured.shape
    level = np.nan_to_num(middle.captured)
    lit = level > 0.05 * np.percentile(level, 99)

    def sure(column: Column) -> NDArray[np.bool_]:
        return lit & (column.confidence >= CONFIDENT) & np.isfinite(column.flow).all(axis=0)

    def typical(column: Column) -> float:
        moved = length(column.flow)[sure(column)]
        return float(moved.mean()) if moved.size else 0.0

    most = max(columns, key=typical)
    page.place(
        as_grey(middle.captured, 4 * float(np.percentile(level, 99.5))), page.left(tile), page.top(2), page.panel
    )
    if not typical(most) > 0:
        page.text((page.left(tile), page.top(2) - _TITLE), "flow: nothing moves")
        return
    page.text((page.left(tile), page.top(2) - _TITLE), f"flow of frame {most.frame} ({most.illumination})")
    step = max(1, width // 18)
    where = sure(most)
    long = float(np.percentile(length(most.flow)[where], 99))
    # on the page, the longest arrows reach over one step and a half
    stretch = 1.5 * step * page.scale / max(long, 1e-6)
    for y in range(step // 2, height, step):
        for x in range(step // 2, width, step):
            if where[y, x]:
                u, v = (float(value) for value in most.flow[:, y, x])
                end = (x + u * stretch / page.scale, y + v * stretch / page.scale)
                if 0 <= end[0] < width and 0 <= end[1] < height:
                    _draw_arrow(page, page.at(tile, 2, (x, y)), (u * stretch, v * stretch))
    key = max((size for size in _KEYS_PX if size <= max(long, _KEYS_PX[0])), default=_KEYS_PX[0])
    _draw_arrow(page, (page.left(tile) + 2, foot + 6), (key * stretch, 0.0))
    page.text((page.left(tile) + 10 + key * stretch, foot - 2), f"{key:g} px")
    page.text(
        (page.left(tile), foot + 30), f"mean {typical(most):.2f} px, drawn {stretch / page.scale:.2g} x", 13, _WHITE
    )


def _draw_arrow(page: Page, start: tuple[float, float], way: tuple[float, float]) -> None:
    rgb = (255, 210, 60)
    length = math.hypot(*way)
    end = (start[0] + way[0], start[1] + way[1])
    page.pen.line((*start, *end), fill=rgb)
    if length < 2:
        return
    head = min(4.0, length / 2)
    for turn in (2.6, -2.6):  # radians: back along the shaft, to either side
        angle = math.atan2(way[1], way[0]) + turn
        page.pen.line((*end, end[0] + head * math.cos(angle), end[1] + head * math.sin(angle)), fill=rgb)

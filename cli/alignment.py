"""alignment: what `align` did to the pictures of one tracking frame, on one page.

Top row the pictures as captured, below them the same aligned, each column on one brightness scale. Marked points
lie at the same coordinates in every picture: where the alignment is right, the cross hair stays on one place of
the subject. Then

    residual     |r_a + r_a' - c| / mean c, over the pixels known both before and after (Wilson et al. 2010)
    confidence   the least over the members
    flow         of the member that moves most, as arrows from the tracking frame to the picture

A small residual alone proves nothing: a wrong flow can have a smaller one than the true flow. That is why the
points are there.

The layout is that of the figure "Alignment of spherical gradient images" in Dutta (2010), chapter 4.
"""

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.cli.film import colours, font
from lightstage.cli.show import Screen
from lightstage.cli.values import whole
from lightstage.formats.png import encode_png
from lightstage.formats.whole_file import write_whole
from lightstage.store.errors import RequestError
from lightstage.store.root import Store

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

MOST_POINTS = 3
CONFIDENT = 0.5
"""Below it the flow is likely wrong by more than a pixel; points and arrows are not put there."""
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


def configure(commands: Any) -> None:
    """Add the command of this file."""
    alignment = commands.add_parser("alignment", help="draw how well the pictures of a tracking frame are aligned")
    alignment.add_argument("--session", required=True, metavar="S", help="the session")
    alignment.add_argument("--tracking", type=whole, metavar="N", help="the tracking frame (default: the first)")
    alignment.add_argument(
        "--at",
        action="append",
        default=[],
        metavar="X,Y",
        help=f"mark this pixel, up to {MOST_POINTS} times (default: textured places that move most)",
    )
    alignment.add_argument(
        "--to", type=Path, metavar="FILE.png", help="default: pictures/<session>_alignment_<tracking>.png"
    )
    alignment.set_defaults(handler=handle_alignment)


@dataclass(frozen=True)
class Column:
    """One picture of the set. Pictures are (y, x), radiance, NaN where not known."""

    frame: int
    illumination: str
    time_s: float | None
    captured: "NDArray[np.float32]"
    aligned: "NDArray[np.float32]"
    flow: "NDArray[np.float32]"
    """(xy, y, x), pixels: aligned(x) = captured(x + flow(x))."""
    confidence: "NDArray[np.float32]"

    @property
    def caption(self) -> str:
        """Which picture it is."""
        time = "" if self.time_s is None else f"  {1000 * self.time_s:.1f} ms"
        return f"frame {self.frame}  {self.illumination}{time}"

    @property
    def left_out(self) -> bool:
        """Whether `align` found that it does not belong to the set."""
        return not bool((self.confidence > 0).any())


@dataclass(frozen=True)
class Residual:
    """|r_a + r_a' - c| / mean c before and after, over the same pixels."""

    before: "NDArray[np.float32]"
    """(y, x), the mean over pairs; NaN where no pair is known."""
    after: "NDArray[np.float32]"
    mean_before: float
    mean_after: float


def handle_alignment(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage alignment."""
    from lightstage.store.sessions import read_session

    store = Store(options.store, create=False)
    session = read_session(options.session, store).name
    if options.to is not None and options.to.suffix.lower() != ".png":
        raise RequestError(f"--to {options.to}: the picture is a PNG; name a file that ends in .png")
    tracking, engine, columns = read_columns(session, options.tracking, store)
    here = next(column for column in columns if column.frame == tracking)
    height, width = here.captured.shape
    points = (
        given_points(options.at, (height, width)) if options.at else chosen_points(here, columns, box(width)[0])
    )
    residual = residual_of(here, columns)
    time = "" if here.time_s is None else f"    {1000 * here.time_s:.1f} ms"
    title = f"{session}    tracking frame {tracking}{time}    engine {engine}"
    picture = draw(title, here, columns, points, residual)
    path = options.to or store.root / "pictures" / f"{session}_alignment_{tracking}.png"
    _write(path, picture)
    screen.say(str(path))
    screen.document(
        {
            "path": str(path),
            "session": session,
            "tracking": tracking,
            "points": [list(point) for point in points],
            "residual_before": None if residual is None else residual.mean_before,
            "residual_after": None if residual is None else residual.mean_after,
        }
    )
    return 0


def read_columns(session: str, tracking: int | None, store: Store) -> tuple[int, str, list[Column]]:
    """The tracking frame, the engine, and the pictures of its set in time order, with the tracking frame.

    Raises:
        RequestError: there is no result of align, or not of this tracking frame, or not of the stack in use.
    """
    import numpy as np

    from lightstage.store.grid import open_dataset
    from lightstage.store.results import current_path

    dataset = open_dataset(current_path(session, "align", store))
    stack = open_dataset(current_path(session, "stack", store))
    have = [int(frame) for frame in dataset["tracking"].values]
    if not have or (tracking is not None and tracking not in have):
        listed = ", ".join(map(str, have)) or "none"
        asked = f"tracking frame {tracking}" if tracking is not None else "tracking frame"
        raise RequestError(f"'align' of session '{session}' has no {asked}; it has {listed}")
    frame = have[0] if tracking is None else tracking
    set_ = dataset.isel(tracking=have.index(frame))
    places = {int(n): i for i, n in enumerate(stack["frame"].values)}
    frames = [int(n) for n in set_["frame"].values]
    wanted = {n for n in frames if n >= 0} | {frame}
    sizes = [(part.sizes["y"], part.sizes["x"]) for part in (stack, dataset)]
    if not wanted <= set(places) or sizes[0] != sizes[1]:
        raise RequestError(
            f"'align' of session '{session}' was made of another stack than the one in use; "
            f"`lightstage run align --session {session}` makes it anew"
        )
    dim = stack["radiance"].dims[0]
    times = stack["time_s"].values if "time_s" in stack.coords else np.full(len(places), np.nan)
    columns = []
    for n in sorted(wanted):
        place = places[n]
        captured = np.asarray(stack["radiance"].isel({dim: place, "band": 0, "component": 0}).values, np.float32)
        if n in frames:
            member = set_.isel(member=frames.index(n))
            aligned = np.asarray(member["aligned"].isel(band=0, component=0).values, np.float32)
            flow = np.asarray(member["flow"].transpose("xy", "y", "x").values, np.float32)
            confidence = np.nan_to_num(np.asarray(member["confidence"].values, np.float32))
        else:  # the method does not read the tracking frame: nothing was done to it
            aligned, flow = captured, np.zeros((2, *captured.shape), np.float32)
            confidence = np.isfinite(captured).astype(np.float32)
        time = float(times[place])
        name = str(stack["illumination"].values[place])
        columns.append(Column(n, name, time if math.isfinite(time) else None, captured, aligned, flow, confidence))
    return frame, str(dataset.attrs.get("engine", "unknown")), columns


def given_points(texts: Sequence[str], shape: tuple[int, int]) -> list[tuple[int, int]]:
    """(x, y) of every --at.

    Raises:
        RequestError: too many, not X,Y, or outside the picture of `shape` (y, x).
    """
    height, width = shape
    if len(texts) > MOST_POINTS:
        raise RequestError(f"--at is given {len(texts)} times; at most {MOST_POINTS} points are marked")
    points = []
    for text in texts:
        try:
            x, y = (int(part) for part in text.split(","))
        except ValueError:
            raise RequestError(f"--at {text}: expected X,Y in whole pixels, such as 120,200") from None
        if not (0 <= x < width and 0 <= y < height):
            raise RequestError(
                f"--at {text} is outside the picture; X is 0 to {width - 1} and Y is 0 to {height - 1}"
            )
        points.append((x, y))
    return points


def chosen_points(here: Column, columns: Sequence[Column], margin: int) -> list[tuple[int, int]]:
    """(x, y) of up to MOST_POINTS places with texture that move most, an eighth of the width apart.

    Their score is the smaller eigenvalue of the structure tensor of the tracking frame (Shi and Tomasi 1994) times
    the largest flow; without any motion it is the eigenvalue alone. None are closer to the border than `margin`.
    """
    import cv2
    import numpy as np

    height, width = here.captured.shape
    texture = cv2.cornerMinEigenVal(cv2.GaussianBlur(np.nan_to_num(here.captured), (0, 0), 1.0), 5)
    moves = np.max([np.nan_to_num(_length(column.flow)) for column in columns], axis=0)
    score = texture * moves if moves.any() else texture
    known = (least_confidence(columns) >= CONFIDENT) & np.isfinite(here.captured)
    inner = np.zeros_like(known)
    inner[margin : height - margin, margin : width - margin] = True
    # where the picture ends at unknown pixels, the derivative is of the filling
    whole = cv2.erode(known.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    score = np.where(whole & inner, score, 0)
    y, x = np.mgrid[0:height, 0:width]
    points: list[tuple[int, int]] = []
    while len(points) < MOST_POINTS and score.max() > 0:
        row, column = (int(i) for i in np.unravel_index(int(score.argmax()), score.shape))
        points.append((column, row))
        score[np.hypot(x - column, y - row) < width / 8] = 0
    return points


def least_confidence(columns: Sequence[Column]) -> "NDArray[np.float32]":
    """(y, x), over the members that were not left out."""
    import numpy as np

    kept = [column.confidence for column in columns if not column.left_out]
    least: NDArray[np.float32] = np.min(kept, axis=0) if kept else np.zeros_like(columns[0].confidence)
    return least


def residual_of(here: Column, columns: Sequence[Column]) -> Residual | None:
    """The mean over the set's pairs; None where it has no constant picture or no pair."""
    import numpy as np

    if here.illumination != "C":
        return None
    by_name = {column.illumination: column for column in columns if column.illumination != "C"}
    together = [(by_name[name], by_name[f"{name}c"]) for name in "XYZ" if {name, f"{name}c"} <= set(by_name)]
    before, after, level = [], [], []
    for a, b in together:
        off = [
            np.abs(a.captured + b.captured - here.captured),
            np.abs(a.aligned + b.aligned - here.aligned),
        ]
        known = np.isfinite(off[0]) & np.isfinite(off[1])
        before.append(np.where(known, off[0], np.nan))
        after.append(np.where(known, off[1], np.nan))
        level.append(np.where(known, here.captured, np.nan))
    total = float(np.nansum(level)) if level else 0.0
    if not total > 0:
        return None
    mean = total / float(np.isfinite(level).sum())
    return Residual(
        _mean(before) / np.float32(mean),
        _mean(after) / np.float32(mean),
        float(np.nansum(before)) / total,
        float(np.nansum(after)) / total,
    )


def _mean(pictures: Sequence[Any]) -> Any:
    """(y, x), over those that are known there, NaN where none is."""
    import numpy as np

    count = np.isfinite(pictures).sum(axis=0)
    return np.where(count > 0, np.nansum(pictures, axis=0) / np.maximum(count, 1), np.nan).astype(np.float32)


def _length(flow: Any) -> Any:
    import numpy as np

    return np.hypot(flow[0], flow[1])


def box(width: int) -> tuple[int, int]:
    """Half the side of a point's box, and its side, in pixels of the picture."""
    half = max(3, width // 28)
    return half, 2 * half + 1


class Page:
    """Where things are on the page, and the pens."""

    def __init__(self, shape: tuple[int, int], columns: int) -> None:
        from PIL import Image, ImageDraw

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
        self.image = Image.new("RGB", self.size, BACKGROUND_RGB)
        self.pen = ImageDraw.Draw(self.image)

    def left(self, column: int) -> int:
        """The first column of a tile."""
        return _GAP + column * (self.panel[0] + _GAP)

    def top(self, row: int) -> int:
        """The first row of a row's pictures."""
        return _HEAD + row * self.row + _ROW + _TITLE

    def place(self, picture: Any, left: int, top: int, size: tuple[int, int]) -> None:
        """Put a picture (y, x, rgb) there, in that size."""
        import cv2
        from PIL import Image

        grows = size[0] >= picture.shape[1]
        fitted = cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST if grows else cv2.INTER_AREA)
        self.image.paste(Image.fromarray(fitted), (left, top))

    def text(
        self, at: tuple[float, float], words: str, size: int = 13, rgb: Any = _PALE, anchor: str = "la"
    ) -> None:
        """Write."""
        self.pen.text(at, words, fill=rgb, font=font(size), anchor=anchor)

    def at(self, column: int, row: int, point: tuple[float, float]) -> tuple[float, float]:
        """The middle of a pixel of a tile's picture, on the page."""
        return (
            self.left(column) + (point[0] + 0.5) * self.scale,
            self.top(row) + (point[1] + 0.5) * self.scale,
        )


def draw(
    title: str,
    here: Column,
    columns: Sequence[Column],
    points: Sequence[tuple[int, int]],
    residual: Residual | None,
) -> "NDArray[np.uint8]":
    """The page (y, x, rgb)."""
    import numpy as np

    page = Page((here.captured.shape[0], here.captured.shape[1]), len(columns))
    page.text((_GAP, 8), title, 18, _WHITE)
    page.text((_GAP, page.top(0) - _TITLE - _ROW + 2), "as captured", 16, _WHITE)
    page.text((_GAP, page.top(1) - _TITLE - _ROW + 2), "aligned to the tracking frame", 16, _WHITE)
    for i, column in enumerate(columns):
        values = np.concatenate([p[np.isfinite(p)] for p in (column.captured, column.aligned)])
        top = float(np.percentile(values, 99.5)) if values.size else 1.0
        tracking = column is here
        page.text((page.left(i), page.top(0) - _TITLE), column.caption, rgb=_WHITE if tracking else _PALE)
        sure = column.confidence >= CONFIDENT
        said = "the tracking frame" if tracking else "left out: does not belong to the set"
        if not tracking and not column.left_out:
            moved = _length(column.flow)[sure & np.isfinite(column.flow).all(axis=0)]
            said = f"moved by {np.median(moved):.2f} px (median)" if moved.size else "nowhere sure"
        page.text((page.left(i), page.top(1) - _TITLE), said, rgb=_WHITE if tracking else _PALE)
        for row, picture in enumerate((column.captured, column.aligned)):
            _draw_picture(page, i, row, as_grey(picture, top), points)
    _draw_measures(page, here, columns, residual)
    return np.asarray(page.image)


def as_grey(picture: "NDArray[np.float32]", top: float) -> "NDArray[np.uint8]":
    """(y, x, rgb), white at `top`, with display gamma; UNKNOWN_RGB where not known."""
    import numpy as np

    unit = np.clip(np.nan_to_num(picture) / max(top, 1e-30), 0, 1) ** (1 / GAMMA)
    grey = np.repeat(np.round(unit * 255).astype(np.uint8)[..., None], 3, axis=-1)
    grey[~np.isfinite(picture)] = UNKNOWN_RGB
    return grey


def as_colours(values: "NDArray[np.float32]", top: float) -> "NDArray[np.uint8]":
    """(y, x, rgb) on the colour scale from 0 to `top`; UNKNOWN_VALUE_RGB where not known."""
    import numpy as np

    unit = np.clip(np.nan_to_num(values) / max(top, 1e-30), 0, 1)
    rgb: NDArray[np.uint8] = colours()[np.round(unit * 255).astype(np.uint8)]
    rgb[~np.isfinite(values)] = UNKNOWN_VALUE_RGB
    return rgb


def _draw_picture(page: Page, column: int, row: int, picture: Any, points: Sequence[tuple[int, int]]) -> None:
    """A picture with its points, and below it what is in their boxes, larger."""
    import numpy as np

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


def _draw_cross(page: Page, middle: tuple[float, float], reach: float, rgb: tuple[int, int, int]) -> None:
    """A cross hair that leaves the point itself free."""
    x, y = middle
    for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        page.pen.line(
            (x + 0.2 * reach * dx, y + 0.2 * reach * dy, x + 0.75 * reach * dx, y + 0.75 * reach * dy), fill=rgb
        )


def _draw_measures(page: Page, here: Column, columns: Sequence[Column], residual: Residual | None) -> None:
    """The third row: residuals, confidence, flow."""
    import numpy as np

    page.text((_GAP, page.top(2) - _TITLE - _ROW + 2), "how well", 16, _WHITE)
    foot = page.top(2) + page.panel[1] + 6
    tile = 0
    if residual is None:
        lacks = "a complement pair" if here.illumination == "C" else "a picture under constant light"
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
    _draw_flow(page, tile + 1, here, columns, foot)
    unknown = "not known: violet in pictures, grey in maps"
    page.text((page.size[0] - _GAP, 10), unknown, 13, anchor="ra")


def _draw_scale(page: Page, tile: int, top: int, end: str) -> None:
    import numpy as np

    steps = colours()[np.linspace(0, 255, page.panel[0]).astype(int)]
    page.place(np.repeat(steps[None], 8, axis=0), page.left(tile), top, (page.panel[0], 8))
    page.text((page.left(tile), top + 11), "0", 12)
    page.text((page.left(tile) + page.panel[0], top + 11), end, 12, anchor="ra")


def _draw_flow(page: Page, tile: int, here: Column, columns: Sequence[Column], foot: int) -> None:
    """Arrows on the dimmed tracking frame, where the flow is sure and the subject is lit."""
    import numpy as np

    height, width = here.captured.shape
    level = np.nan_to_num(here.captured)
    lit = level > 0.05 * np.percentile(level, 99)

    def sure(column: Column) -> Any:
        return lit & (column.confidence >= CONFIDENT) & np.isfinite(column.flow).all(axis=0)

    def typical(column: Column) -> float:
        moved = _length(column.flow)[sure(column)]
        return float(moved.mean()) if moved.size else 0.0

    most = max(columns, key=typical)
    page.place(
        as_grey(here.captured, 4 * float(np.percentile(level, 99.5))), page.left(tile), page.top(2), page.panel
    )
    if not typical(most) > 0:
        page.text((page.left(tile), page.top(2) - _TITLE), "flow: nothing moves")
        return
    page.text((page.left(tile), page.top(2) - _TITLE), f"flow of frame {most.frame} ({most.illumination})")
    step = max(1, width // 18)
    where = sure(most)
    long = float(np.percentile(_length(most.flow)[where], 99))
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


def _write(path: Path, picture: "NDArray[np.uint8]") -> None:
    """Whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, encode_png(picture))

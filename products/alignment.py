"""What `align` did to the pictures of one tracking frame: the set, what is left of it, and points to look at.

    residual     |r_a + r_a' - c| / mean c, over the pixels known both before and after (Wilson et al. 2010)

A small residual alone proves nothing: a wrong flow can have a smaller one than the true flow. That is why there are
points, which lie at the same coordinates in every picture.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lightstage.products.choices import ALIGNMENT_POINTS
from lightstage.products.errors import ProductError
from lightstage.products.tracking import check_frame

Image = NDArray[np.float32]
CONFIDENT = 0.5
"""Below it the flow is likely wrong by more than a pixel; points and arrows are not put there."""
_APART = 8
"""Points are this part of the width apart, at least."""


@dataclass(frozen=True)
class Column:
    """One picture of the set. Pictures are (y, x), radiance, NaN where not known."""

    frame: int
    illumination: str
    time_s: float | None
    captured: Image
    aligned: Image
    flow: Image
    """(xy, y, x), pixels: aligned(x) = captured(x + flow(x))."""
    confidence: Image

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

    before: Image
    """(y, x), the mean over pairs; NaN where no pair is known."""
    after: Image
    mean_before: float
    mean_after: float


@dataclass(frozen=True)
class AlignedSet:
    """The pictures that stand for one tracking frame, in time order, the tracking frame among them."""

    session: str
    tracking: int
    engine: str
    columns: tuple[Column, ...]

    @property
    def middle(self) -> Column:
        """The tracking frame."""
        return next(column for column in self.columns if column.frame == self.tracking)


def read_set(session: str, aligned: Any, stack: Any, tracking: int | None) -> AlignedSet:
    """The set of a tracking frame.

    Args:
        session: its name.
        aligned, stack: the results of these nodes, opened.
        tracking: the frame; None for the first.

    Raises:
        ProductError: it is no tracking frame of the result, or the result is not of this stack.
    """
    have = [int(frame) for frame in aligned["tracking"].values]
    frame = have[0] if have and tracking is None else tracking
    check_frame(frame, have, "align", session)
    assert frame is not None
    chosen = aligned.isel(tracking=have.index(frame))
    places = {int(n): i for i, n in enumerate(stack["frame"].values)}
    frames = [int(n) for n in chosen["frame"].values]
    wanted = {n for n in frames if n >= 0} | {frame}
    sizes = [(part.sizes["y"], part.sizes["x"]) for part in (stack, aligned)]
    if not wanted <= set(places) or sizes[0] != sizes[1]:
        raise ProductError(
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
            member = chosen.isel(member=frames.index(n))
            moved = np.asarray(member["aligned"].isel(band=0, component=0).values, np.float32)
            flow = np.asarray(member["flow"].transpose("xy", "y", "x").values, np.float32)
            confidence = np.nan_to_num(np.asarray(member["confidence"].values, np.float32))
        else:  # the method does not read the tracking frame: nothing was done to it
            moved, flow = captured, np.zeros((2, *captured.shape), np.float32)
            confidence = np.isfinite(captured).astype(np.float32)
        time = float(times[place])
        name = str(stack["illumination"].values[place])
        columns.append(Column(n, name, time if math.isfinite(time) else None, captured, moved, flow, confidence))
    return AlignedSet(session, frame, str(aligned.attrs.get("engine", "unknown")), tuple(columns))


def chosen_points(aligned: AlignedSet, margin: int) -> list[tuple[int, int]]:
    """(x, y) of up to ALIGNMENT_POINTS places with texture that move most, an eighth of the width apart.

    Their score is the smaller eigenvalue of the structure tensor of the tracking frame (Shi and Tomasi 1994) times
    the largest flow; without any motion it is the eigenvalue alone. None are closer to the border than `margin`.
    """
    middle, columns = aligned.middle, aligned.columns
    height, width = middle.captured.shape
    texture = cv2.cornerMinEigenVal(cv2.GaussianBlur(np.nan_to_num(middle.captured), (0, 0), 1.0), 5)
    moves = np.max([np.nan_to_num(length(column.flow)) for column in columns], axis=0)
    score = texture * moves if moves.any() else texture
    known = (least_confidence(columns) >= CONFIDENT) & np.isfinite(middle.captured)
    inner = np.zeros_like(known)
    inner[margin : height - margin, margin : width - margin] = True
    # where the picture ends at unknown pixels, the derivative is of the filling
    whole = cv2.erode(known.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    score = np.where(whole & inner, score, 0)
    y, x = np.mgrid[0:height, 0:width]
    points: list[tuple[int, int]] = []
    while len(points) < ALIGNMENT_POINTS and score.max() > 0:
        row, column = (int(i) for i in np.unravel_index(int(score.argmax()), score.shape))
        points.append((column, row))
        score[np.hypot(x - column, y - row) < width / _APART] = 0
    return points


def least_confidence(columns: Sequence[Column]) -> Image:
    """(y, x), over the members that were not left out."""
    kept = [column.confidence for column in columns if not column.left_out]
    return np.asarray(np.min(kept, axis=0) if kept else np.zeros_like(columns[0].confidence))


def residual_of(aligned: AlignedSet) -> Residual | None:
    """The mean over the set's pairs; None where it has no constant picture or no pair."""
    middle = aligned.middle
    if middle.illumination != "C":
        return None
    by_name = {column.illumination: column for column in aligned.columns if column.illumination != "C"}
    together = [(by_name[name], by_name[f"{name}c"]) for name in "XYZ" if {name, f"{name}c"} <= set(by_name)]
    before, after, level = [], [], []
    for a, b in together:
        off = [
            np.abs(a.captured + b.captured - middle.captured),
            np.abs(a.aligned + b.aligned - middle.aligned),
        ]
        known = np.isfinite(off[0]) & np.isfinite(off[1])
        before.append(np.where(known, off[0], np.nan))
        after.append(np.where(known, off[1], np.nan))
        level.append(np.where(known, middle.captured, np.nan))
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


def _mean(pictures: Sequence[Image]) -> Image:
    """(y, x), over those that are known there, NaN where none is."""
    count = np.isfinite(pictures).sum(axis=0)
    return np.where(count > 0, np.nansum(pictures, axis=0) / np.maximum(count, 1), np.nan).astype(np.float32)


def length(flow: Image) -> Image:
    """(y, x), pixels."""
    return np.asarray(np.hypot(flow[0], flow[1]))

"""The film: normals in time, relit, and how fast they change (`film_page.py` draws a frame).

A pixel's change is not only noise: where the subject moves, another place of the surface comes to the pixel. What a
film shows that a picture does not is flicker and jumps.

Frames are read, drawn and handed to the encoder one by one, so that memory does not grow with the film.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.formats.png import encode_png
from lightstage.formats.video import write_film
from lightstage.products import names
from lightstage.products.choices import FILM_FASTEST_FPS, FILM_SLOWER, FILM_SLOWEST_FPS, FILMS
from lightstage.products.contact_sheet import LIT
from lightstage.products.errors import ProductError
from lightstage.products.film_page import Layout, angle_deg
from lightstage.products.progress import Progress, silent

Image = NDArray[np.float32]
TOPS_DEG = (1, 2, 5, 10, 20, 45, 90, 180)
"""What the end of the colour scale may be."""
_TOP_PERCENT = 95
"""Of the changes, that stay below the end of the scale."""
_LEAST_FPS = 0.1
"""What players take."""


@dataclass(frozen=True)
class Subject:
    """What a film says of the session that it shows."""

    session: str
    illumination: Sequence[str]
    """Of every frame of the session."""
    frame_rate_hz: float | None


@dataclass(frozen=True)
class Series:
    """The normals of one node and band in time."""

    subject: Subject
    node: str
    dataset: Any
    dim: str
    """frame or tracking."""
    band: int | None
    """Index, or None where a result has no bands."""
    frames: tuple[int, ...]
    """Indices in the session."""
    illumination: tuple[str, ...]
    time_s: tuple[float | None, ...]

    @property
    def name(self) -> str:
        """File name without extension."""
        return names.film(self.subject.session, self.node, self._band_nm)

    @property
    def _band_nm(self) -> float | None:
        if self.band is None or self.dataset.sizes["band"] == 1:
            return None
        return float(self.dataset.band.values[self.band])

    def normal(self, index: int) -> Image:
        """(y, x, xyz) unit vectors, NaN where not valid or, by the albedo, unlit; read when asked."""
        chosen = {self.dim: index} | ({} if self.band is None else {"band": self.band})
        picture = self.dataset.isel(chosen)
        normal = np.array(picture["normal"].transpose("y", "x", "xyz").values, np.float32)
        if "albedo" in picture:
            albedo = picture["albedo"].values
            if np.isfinite(albedo).any():
                # the background's normals are noise, and would drown the subject's
                normal[~(albedo > LIT * np.nanpercentile(albedo, 99))] = np.nan
        return normal

    def caption(self, index: int) -> str:
        """What the frame is."""
        words = [self.subject.session, self.node]
        if self._band_nm is not None:
            words.append(f"{self._band_nm:g} nm")
        words.append(f"frame {self.frames[index]}")
        if self.illumination[index]:
            words.append(f"light {self.illumination[index]}")
        time = self.time_s[index]
        if time is not None:
            words.append(f"{1000 * time:.1f} ms")
        return "    ".join(words)


def open_series(dataset: Any, node: str, subject: Subject) -> list[Series]:
    """The series that a result holds, one a band.

    Raises:
        ProductError: it holds no normals in time.
    """
    dims = dataset["normal"].dims if "normal" in dataset else ()
    dim = next((name for name in ("frame", "tracking") if name in dims), None)
    if dim is None or "xyz" not in dims:
        raise ProductError(
            f"'{node}' of session '{subject.session}' has no normals in time, so there is no film of it; "
            "name upsample or normals"
        )
    count = dataset.sizes[dim]
    if count == 0:
        raise ProductError(f"'{node}' of session '{subject.session}' has no frame; there is nothing to show")
    frames = tuple(int(i) for i in (dataset[dim].values if dim in dataset.coords else range(count)))
    lights = subject.illumination
    if "illumination" in dataset.coords:
        illumination = tuple(str(name) for name in dataset["illumination"].values)
    else:
        illumination = tuple(lights[i] if 0 <= i < len(lights) else "" for i in frames)
    times = dataset["time_s"].values if "time_s" in dataset.coords else np.full(count, np.nan)
    return [
        Series(
            subject,
            node,
            dataset,
            dim,
            band,
            frames,
            illumination,
            tuple(float(t) if math.isfinite(t) else None for t in times),
        )
        for band in (range(dataset.sizes["band"]) if "band" in dims else (None,))
    ]


def frames_per_second(series: Series, given: float | None) -> float:
    """A film's rate: the one given, or the session's / 6 so that one sees what happens, and at least 5.

    Raises:
        ProductError: `given` is no rate that players take.
    """
    if given is None:
        return max(FILM_SLOWEST_FPS, (series.subject.frame_rate_hz or 0.0) / FILM_SLOWER)
    if not _LEAST_FPS <= given <= FILM_FASTEST_FPS:  # also false for NaN
        raise ProductError(
            f"a film of {given:g} frames a second: expected a rate between {_LEAST_FPS:g} and "
            f"{FILM_FASTEST_FPS:g}, such as 10"
        )
    return given


def pace(series: Series, fps: float) -> str:
    """How the film's time compares with the subject's."""
    first, last = series.time_s[0], series.time_s[-1]
    text = f"{fps:g} frames a second"
    if first is None or last is None or last <= first:
        return text
    slower = (last - first) / (len(series.frames) - 1) * fps
    if abs(slower - 1) < 0.01:
        return f"{text}, as fast as captured"
    return (
        f"{text}, {1 / slower:.3g} times slower than captured"
        if slower < 1
        else f"{text}, {slower:.3g} times faster than captured"
    )


def scale_top_deg(series: Series, pairs: int = 6) -> float:
    """The end of the colour scale: that of TOPS_DEG which 95 % of the changes of a few pairs of frames stay below.

    One scale for the whole film, from a sample, so that the film is read only once.
    """
    count = len(series.frames)
    seen = []
    for i in np.unique(np.linspace(1, count - 1, pairs).astype(int)) if count > 1 else ():
        change = angle_deg(series.normal(int(i)), series.normal(int(i) - 1))[::2, ::2]
        seen.append(change[np.isfinite(change)])
    values = np.concatenate(seen) if seen else np.empty(0)
    high = float(np.percentile(values, _TOP_PERCENT)) if values.size else 0.0
    return float(next(top for top in TOPS_DEG if high <= top))


def drawn(series: Series, layout: Layout) -> Iterator[NDArray[np.uint8]]:
    """Every frame of a film, one at a time."""
    before = None
    for index in range(len(series.frames)):
        normal = series.normal(index)
        yield layout.draw(series.caption(index), normal, before)
        before = normal


@dataclass(frozen=True)
class Film:
    """What was written of a series."""

    files: tuple[str, ...]
    frames: int
    pace: str | None
    """In words; None of single pictures."""
    fps: float | None
    top_deg: float
    """Where the scale of the change ends."""


def file_names(every: Sequence[Series], form: str) -> list[str]:
    """What `write_series` makes of series in a format."""
    return [
        name
        for series in every
        for name in (
            [f"{series.name}.{form}"]
            if form in FILMS
            else [f"{series.name}_{names.frame(frame)}.png" for frame in series.frames]
        )
    ]


def check(every: Sequence[Series], form: str, fps: float | None) -> None:
    """What can be refused before anything is read.

    Raises:
        ProductError: a film of one frame, or a rate that players do not take.
    """
    for series in every if form in FILMS else ():
        if len(series.frames) < 2:
            raise ProductError(
                f"'{series.node}' of session '{series.subject.session}' has one frame, and a film needs two; "
                "as png it is a picture"
            )
        frames_per_second(series, fps)


def write_series(
    folder: Path,
    every: Sequence[Series],
    *,
    form: str,
    convention: str = "opengl",
    fps: float | None = None,
    progress: Progress = silent,
) -> Iterator[Film]:
    """Write a film of each series, or its frames as pictures; says of each what it is as it is done.

    Args:
        folder: is there.
        every: from `open_series`.
        form: one of `choices.FILM_FORMATS`.
        convention: where green points, of `choices.CONVENTIONS`.
        fps: frames a second; None: by the session's rate.
        progress: shows how far it is.

    Raises:
        ProductError: see `check`.
        OSError: a file cannot be written.
    """
    check(every, form, fps)
    for series in every:
        layout = Layout(_shape(series), convention=convention, top_deg=scale_top_deg(series))
        count = len(series.frames)
        pictures = progress(drawn(series, layout), count, "frames")
        files = tuple(file_names([series], form))
        if form in FILMS:
            rate = frames_per_second(series, fps)
            write_film(folder / files[0], pictures, layout.size, rate)
            yield Film(files, count, pace(series, rate), rate, layout.top_deg)
        else:
            for name, picture in zip(files, pictures, strict=True):
                (folder / name).write_bytes(encode_png(picture))
            yield Film(files, count, None, None, layout.top_deg)


def _shape(series: Series) -> tuple[int, int]:
    sizes: Mapping[str, int] = series.dataset["normal"].sizes
    return int(sizes["y"]), int(sizes["x"])

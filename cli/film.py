"""The film: normals in time, relit, and how fast they change.

Three panels beside each other, a frame at a time:

    colour      (n + 1) / 2, green up (OpenGL) or down (DirectX)
    relit       max(0, n . l), l one distant light to the upper left of the camera (Lambert 1760), albedo 1
    change      atan2(|n x m|, n . m) in degrees, m the normal at the same pixel one frame before

A pixel's change is not only noise: where the subject moves, another place of the surface comes to the pixel. What a
film shows that a picture does not is flicker and jumps.

Frames are read, drawn and handed to the encoder one by one, so that memory does not grow with the film.
"""

import math
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.cli.figures import fonts
from lightstage.cli.show import Screen
from lightstage.formats.png import encode_png
from lightstage.formats.whole_file import whole_file, write_whole
from lightstage.store.errors import RequestError, WorkError
from lightstage.store.root import Store

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from PIL.ImageFont import FreeTypeFont

    from lightstage.store.sessions import Session

FILMS = ("mp4", "gif")
FORMATS = (*FILMS, "png")
LIGHT = (-0.5, 0.3, math.sqrt(1 - 0.5**2 - 0.3**2))
"""Towards the light: left, up and mostly frontal. World axes: x right, y up, z towards the camera."""
LIT = 0.05
"""Of the 99th percentile of the albedo: what is darker is background, as on the contact sheet."""
SLOWER = 6
SLOWEST_FPS = 5.0
FASTEST_FPS = 120.0
TOPS_DEG = (1, 2, 5, 10, 20, 45, 90, 180)
"""What the end of the colour scale may be."""
NO_CHANGE_RGB = (56, 56, 56)
"""Where there is no frame before to compare with; black says that there is no normal."""
_NARROW, _WIDE = 360, 640
"""Pixels across a panel: enough for its text, and three of them within what browsers decode quickly."""
_GAP, _HEAD, _TITLE, _FOOT = 12, 34, 26, 48
_GREEN = {"opengl": "green = up (OpenGL)", "directx": "green = down (DirectX)"}


@dataclass(frozen=True)
class Series:
    """The normals of one node and band in time."""

    session: str
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
    frame_rate_hz: float | None

    @property
    def name(self) -> str:
        """File name without extension."""
        band = self._band_nm
        return f"{self.session}_{self.node}" + (f"_{band:g}nm" if band is not None else "")

    @property
    def _band_nm(self) -> float | None:
        if self.band is None or self.dataset.sizes["band"] == 1:
            return None
        return float(self.dataset.band.values[self.band])

    def normal(self, index: int) -> "NDArray[np.float32]":
        """(y, x, xyz) unit vectors, NaN where not valid or, by the albedo, unlit; read when asked."""
        import numpy as np

        chosen = {self.dim: index} | ({} if self.band is None else {"band": self.band})
        here = self.dataset.isel(chosen)
        normal = np.array(here["normal"].transpose("y", "x", "xyz").values, np.float32)
        if "albedo" in here:
            albedo = here["albedo"].values
            if np.isfinite(albedo).any():
                # the background's normals are noise, and would drown the subject's
                normal[~(albedo > LIT * np.nanpercentile(albedo, 99))] = np.nan
        return normal

    def caption(self, index: int) -> str:
        """What the frame is."""
        words = [self.session, self.node]
        if self._band_nm is not None:
            words.append(f"{self._band_nm:g} nm")
        words.append(f"frame {self.frames[index]}")
        if self.illumination[index]:
            words.append(f"light {self.illumination[index]}")
        time = self.time_s[index]
        if time is not None:
            words.append(f"{1000 * time:.1f} ms")
        return "    ".join(words)


def open_series(dataset: Any, node: str, session: "Session") -> list[Series]:
    """The series that a result holds, one a band.

    Raises:
        RequestError: it holds no normals in time.
    """
    import numpy as np

    dims = dataset["normal"].dims if "normal" in dataset else ()
    dim = next((name for name in ("frame", "tracking") if name in dims), None)
    if dim is None or "xyz" not in dims:
        raise RequestError(
            f"'{node}' of session '{session.name}' has no normals in time, so there is no film of it; "
            "name upsample or normals"
        )
    count = dataset.sizes[dim]
    if count == 0:
        raise RequestError(f"'{node}' of session '{session.name}' has no frame; there is nothing to show")
    frames = tuple(int(i) for i in (dataset[dim].values if dim in dataset.coords else range(count)))
    lights: Sequence[str] = session.facts["illumination"]
    if "illumination" in dataset.coords:
        illumination = tuple(str(name) for name in dataset["illumination"].values)
    else:
        illumination = tuple(lights[i] if 0 <= i < len(lights) else "" for i in frames)
    times = dataset["time_s"].values if "time_s" in dataset.coords else np.full(count, np.nan)
    return [
        Series(
            session.name,
            node,
            dataset,
            dim,
            band,
            frames,
            illumination,
            tuple(float(t) if math.isfinite(t) else None for t in times),
            session.facts["frame_rate_hz"],
        )
        for band in (range(dataset.sizes["band"]) if "band" in dims else (None,))
    ]


def frames_per_second(series: Series, given: float | None) -> float:
    """--fps, or the session's rate / 6 so that one sees what happens, and at least 5.

    Raises:
        RequestError: `given` is no rate that players take.
    """
    if given is None:
        return max(SLOWEST_FPS, (series.frame_rate_hz or 0.0) / SLOWER)
    if not 0.1 <= given <= FASTEST_FPS:  # also false for NaN
        raise RequestError(f"--fps {given:g}: expected frames a second between 0.1 and {FASTEST_FPS:g}, such as 10")
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


def angle_deg(normal: "NDArray[np.float32]", before: "NDArray[np.float32]") -> "NDArray[np.float32]":
    """Angle between two maps (y, x, xyz) in degrees, exact near 0; NaN where either is."""
    import numpy as np

    across = np.linalg.norm(np.cross(normal, before), axis=-1)
    angle: NDArray[np.float32] = np.degrees(np.arctan2(across, np.sum(normal * before, axis=-1))).astype(np.float32)
    return angle


def as_colour(normal: "NDArray[np.float32]", convention: str) -> "NDArray[np.uint8]":
    """(y, x, rgb); black where there is no normal."""
    import numpy as np

    sign = np.array([1, -1 if convention == "directx" else 1, 1], np.float32)
    colour: NDArray[np.uint8] = _bytes((normal * sign + 1) / 2)
    return colour


def relit(normal: "NDArray[np.float32]") -> "NDArray[np.uint8]":
    """(y, x, rgb) grey: n . LIGHT as it is, without display gamma, which would flatten the relief."""
    import numpy as np

    shade = _bytes(np.maximum(normal @ np.array(LIGHT, np.float32), 0))
    return np.repeat(shade[..., None], 3, axis=-1)


def as_map(change_deg: "NDArray[np.float32] | None", top_deg: float, shape: tuple[int, int]) -> "NDArray[np.uint8]":
    """(y, x, rgb) on the colour scale from 0 to `top_deg`; black where not valid, grey where nothing was before."""
    import numpy as np

    if change_deg is None:
        return np.full((*shape, 3), NO_CHANGE_RGB, np.uint8)
    colour: NDArray[np.uint8] = colours()[_bytes(change_deg / np.float32(top_deg))]
    colour[~np.isfinite(change_deg)] = 0
    return colour


def _bytes(unit: Any) -> Any:
    import numpy as np

    return np.nan_to_num(np.round(np.clip(unit, 0, 1) * 255), nan=0.0).astype(np.uint8)


def colours() -> Any:
    """256 colours (rgb), viridis: its 0 is purple, so that black is free to say 'no normal'."""
    import cv2
    import numpy as np

    steps = np.arange(256, dtype=np.uint8)[:, None]
    return cv2.applyColorMap(steps, cv2.COLORMAP_VIRIDIS)[:, 0, ::-1].copy()


def scale_top_deg(series: Series, pairs: int = 6) -> float:
    """The end of the colour scale: that of TOPS_DEG which 95 % of the changes of a few pairs of frames stay below.

    One scale for the whole film, from a sample, so that the film is read only once.
    """
    import numpy as np

    count = len(series.frames)
    seen = []
    for i in np.unique(np.linspace(1, count - 1, pairs).astype(int)) if count > 1 else ():
        change = angle_deg(series.normal(int(i)), series.normal(int(i) - 1))[::2, ::2]
        seen.append(change[np.isfinite(change)])
    values = np.concatenate(seen) if seen else np.empty(0)
    high = float(np.percentile(values, 95)) if values.size else 0.0
    return float(next(top for top in TOPS_DEG if high <= top))


class Layout:
    """Where the panels and the text are; what does not change from frame to frame is drawn once."""

    def __init__(self, series: Series, *, convention: str, top_deg: float) -> None:
        sizes = series.dataset["normal"].sizes
        height, width = int(sizes["y"]), int(sizes["x"])
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
        # H.264 in 4:2:0 has a colour for two by two pixels
        self.size = (_even(3 * across + 4 * _GAP), _even(_HEAD + _TITLE + down + _FOOT))
        self._template = self._draw_template()

    def left(self, panel: int) -> int:
        """The first column of a panel."""
        return _GAP + panel * (self.panel[0] + _GAP)

    @property
    def top(self) -> int:
        """The first row of the panels."""
        return _HEAD + _TITLE

    def _draw_template(self) -> Any:
        import numpy as np
        from PIL import Image, ImageDraw

        canvas = np.full((self.size[1], self.size[0], 3), 24, np.uint8)
        foot = self.top + self.panel[1]
        bar = min(self.panel[0], 256)
        left = self.left(2)
        canvas[foot + 8 : foot + 20, left : left + bar] = colours()[np.linspace(0, 255, bar).astype(int)]
        image = Image.fromarray(canvas)
        draw = ImageDraw.Draw(image)
        small = font(13)
        for panel, title in enumerate(
            ("normals", "relit: n · l, one light upper left", "change since the frame before")
        ):
            draw.text((self.left(panel), _HEAD + 3), title, fill=(225, 225, 225), font=font(15))
        draw.text((self.left(0), foot + 6), _GREEN[self._convention], fill=(170, 170, 170), font=small)
        draw.text((self.left(1), foot + 6), "black: no normal, or in shade", fill=(170, 170, 170), font=small)
        for at, text, anchor in (
            (left, "0°", "la"),
            (left + bar / 2, f"{self.top_deg / 2:g}°", "ma"),
            (left + bar, f"{self.top_deg:g}° or more", "ma"),
        ):
            draw.text((at, foot + 24), text, fill=(200, 200, 200), font=small, anchor=anchor)
        return np.asarray(image)

    def draw(self, caption: str, normal: Any, before: Any) -> Any:
        """One frame (y, x, rgb). `before` is None for the first."""
        import cv2
        import numpy as np
        from PIL import Image, ImageDraw

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
        image = Image.fromarray(canvas)
        draw = ImageDraw.Draw(image)
        draw.text((_GAP, 8), caption, fill=(255, 255, 255), font=font(17))
        if change is None:
            said = "no frame before"
        elif np.isfinite(change).any():
            said = f"mean {np.nanmean(change):.2f}°"
        else:
            said = "no normals to compare"
        right = self.left(2) + self.panel[0]
        draw.text((right, _HEAD + 3), said, fill=(255, 255, 255), font=font(15), anchor="ra")
        return np.asarray(image)


def _even(size: int) -> int:
    return size + size % 2


_fonts: dict[int, "FreeTypeFont"] = {}


def font(size: int) -> "FreeTypeFont":
    """The font that matplotlib brings; OpenCV's has no degree sign."""
    from PIL import ImageFont

    if size not in _fonts:
        _fonts[size] = ImageFont.truetype(fonts() / "DejaVuSans.ttf", size)
    return _fonts[size]


def drawn(series: Series, layout: Layout) -> Iterator[Any]:
    """Every frame of a film, one at a time."""
    before = None
    for index in range(len(series.frames)):
        normal = series.normal(index)
        yield layout.draw(series.caption(index), normal, before)
        before = normal


def write_film(path: Path, pictures: Iterable[Any], size: tuple[int, int], fps: float) -> None:
    """Encode pictures (y, x, rgb) as they come, into a file beside `path` that takes its name when it is whole.

    mp4: H.264, 4:2:0, index first, which browsers play. gif: a palette a frame, endless.

    Raises:
        OSError: it cannot be written.
        WorkError: there is no encoder, or it gave up.
    """
    with whole_file(path) as beside, _encoder(beside, path, size, fps) as send:
        for picture in pictures:
            send(picture.tobytes())


@contextmanager
def _encoder(temporary: Path, path: Path, size: tuple[int, int], fps: float) -> Iterator[Callable[[bytes], object]]:
    """ffmpeg as a process that takes raw pictures; it ends with the block, well or not at all."""
    command = [
        *(_ffmpeg(), "-hide_banner", "-loglevel", "error", "-nostdin", "-y"),
        *("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}", "-r", f"{fps:.6g}", "-i", "pipe:0"),
        *(_GIF if path.suffix == ".gif" else _MP4),
        str(temporary),
    ]
    with tempfile.TemporaryFile() as said:
        try:
            process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=said)
        except OSError as error:
            raise WorkError(f"the encoder {command[0]} does not start ({error.strerror})") from None
        assert process.stdin is not None
        try:
            try:
                yield process.stdin.write
                process.stdin.close()
            except BrokenPipeError:
                with suppress(BrokenPipeError):  # it has ended early, and says below why
                    process.stdin.close()
            code = process.wait()
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
                with suppress(BrokenPipeError):
                    process.stdin.close()
        said.seek(0)
        text = said.read().decode(errors="replace").strip()
    if code:
        if "No space left on device" in text:
            raise WorkError(f"the disk that holds {path} is full; free some space, or choose another --to")
        last = text.splitlines()[-1] if text else f"ended with {code}"
        raise WorkError(f"{path} cannot be written (ffmpeg: {last})")


# Browsers take untagged small pictures for BT.601 and large ones for BT.709: say which it is.
_MP4 = (
    *("-vf", "scale=out_color_matrix=bt709:out_range=tv,format=yuv420p"),
    *("-c:v", "libx264", "-preset", "medium", "-crf", "16", "-movflags", "+faststart"),
    *("-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709", "-color_range", "tv"),
)
# A palette for the whole film would need the whole film in memory first.
_GIF = (
    *("-filter_complex", "split[a][b];[a]palettegen=stats_mode=single[p];[b][p]paletteuse=new=1:dither=sierra2_4a"),
    *("-loop", "0"),
)


def _ffmpeg() -> str:
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        raise WorkError(
            "there is no ffmpeg to write films with: install imageio-ffmpeg, which brings one, "
            "or export --format png"
        ) from None


def write_pictures(folder: Path, series: Series, pictures: Iterable[Any]) -> list[Path]:
    """The frames as PNG, numbered by the frame of the session.

    Raises:
        OSError: one cannot be written.
    """

    files = []
    for frame, picture in zip(series.frames, pictures, strict=True):
        path = folder / f"{series.name}_{frame:04d}.png"
        write_whole(path, encode_png(picture))
        files.append(path)
    return files


def export_film(
    dataset: Any,
    node: str,
    session: "Session",
    folder: Path,
    screen: Screen,
    *,
    form: str,
    convention: str,
    fps: float | None,
) -> dict[str, Any]:
    """Write what `export --format mp4|gif|png` asks for and say what it is; returns the answer for --json."""
    every = open_series(dataset, node, session)
    files: list[str] = []
    tops = []
    rate = None
    for series in every:
        count = len(series.frames)
        if form in FILMS:
            if count < 2:
                raise RequestError(
                    f"'{node}' of session '{session.name}' has one frame, and a film needs two; "
                    "--format png draws it"
                )
            rate = frames_per_second(series, fps)
        layout = Layout(series, convention=convention, top_deg=scale_top_deg(series))
        tops.append(layout.top_deg)
        pictures = screen.progress(drawn(series, layout), count, "frames")
        scale = f"the scale of the change ends at {layout.top_deg:g} degrees"
        if rate is not None:
            path = folder / f"{series.name}.{form}"
            write_film(path, pictures, layout.size, rate)
            files.append(str(path))
            screen.say(f"{count} frames at {pace(series, rate)}; {scale}")
        else:
            files += [str(path) for path in write_pictures(folder, series, pictures)]
            screen.say(f"{count} pictures of {node} ({session.name}) in {folder}; {scale}")
    return {"files": files, "convention": convention, "format": form, "fps": rate, "change_top_deg": tops}


def session_film(session: "Session", node: str, store: Store, screen: Screen) -> Path:
    """Draw a session's film beside its contact sheet, unless it shows the result in use already; returns its place.

    Raises:
        RequestError: the node has no normals in time.
    """
    from lightstage.cli.deliver import noted
    from lightstage.store.grid import open_dataset
    from lightstage.store.results import current_path

    result = current_path(session.name, node, store)
    folder = store.root / "pictures"
    path = folder / f"{session.name}_{node}.mp4"
    note = path.with_suffix(".txt")
    if path.is_file() and note.is_file() and note.read_text() == noted(path, f"{result}\n"):
        return path
    folder.mkdir(exist_ok=True)
    note.unlink(missing_ok=True)
    export_film(open_dataset(result), node, session, folder, screen, form="mp4", convention="opengl", fps=None)
    note.write_text(noted(path, f"{result}\n"))
    return path

"""Films: MP4 (H.264, 4:2:0, index first, which browsers play) and GIF (a palette a frame, endless), through ffmpeg.

Pictures are handed to the encoder as they come, so that memory does not grow with the film. The encoder is the one
that imageio-ffmpeg brings, started by us: its own `write_frames` looks neither at the encoder's answer, so that a
full disk leaves half a film in silence, nor keeps its words from the user's terminal.
"""

import errno
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from lightstage.formats.whole_file import whole_file

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

FORMATS = ("mp4", "gif")

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


def even(size: int) -> int:
    """The next even number of pixels: H.264 in 4:2:0 has a colour for two by two pixels."""
    return size + size % 2


def write_film(path: Path, pictures: "Iterable[NDArray[np.uint8]]", size: tuple[int, int], fps: float) -> None:
    """Encode pictures as they come, into a film that appears under its name when it is whole.

    Args:
        path: its suffix is one of FORMATS.
        pictures: (y, x, rgb).
        size: pixels across and down, even numbers.
        fps: frames a second.

    Raises:
        OSError: it cannot be written, or there is no encoder, or it gave up.
    """
    with whole_file(path) as beside, _encoder(beside, path, size, fps) as send:
        for picture in pictures:
            send(picture.tobytes())


@contextmanager
def _encoder(beside: Path, path: Path, size: tuple[int, int], fps: float) -> Iterator[Callable[[bytes], object]]:
    """ffmpeg as a process that takes raw pictures; it ends with the block, well or not at all."""
    command = [
        *(_ffmpeg(), "-hide_banner", "-loglevel", "error", "-nostdin", "-y"),
        *("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}", "-r", f"{fps:.6g}", "-i", "pipe:0"),
        *(_GIF if path.suffix == ".gif" else _MP4),
        str(beside),
    ]
    with tempfile.TemporaryFile() as words:
        try:
            process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=words)
        except OSError as error:
            raise OSError(error.errno, f"the encoder does not start ({error.strerror})", command[0]) from None
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
        words.seek(0)
        text = words.read().decode(errors="replace").strip()
    if code:
        if "No space left on device" in text:
            raise OSError(errno.ENOSPC, "the disk is full", str(beside))
        last = text.splitlines()[-1] if text else f"ended with {code}"
        raise OSError(errno.EIO, f"the film cannot be encoded (ffmpeg: {last})", str(beside))


def _ffmpeg() -> str:
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        raise OSError(
            errno.ENOENT, "there is no ffmpeg to write films with; install imageio-ffmpeg, which brings one"
        ) from None

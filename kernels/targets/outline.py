"""A mirror ball's outline as a capture shows it: the kernel of `stages/calibration/outline.py`.

The search is in `ball_outline.py`, the fit in `ball_conic.py`.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.targets.ball_conic import Floats, outline_of_points
from lightstage.kernels.targets.ball_outline import find_outline
from lightstage.kernels.targets.item_pictures import mask_of


class Lens(NamedTuple):
    """How the camera sees; both None where it is taken as orthographic."""

    intrinsics: Floats | None = None
    """(3, 3), pixels."""
    distortion: Floats | None = None
    """k1 k2 p1 p2 k3."""

    @classmethod
    def of(cls, camera: Mapping[str, Any] | None) -> "Lens":
        """From K and distortion of a camera item."""
        if camera is None:
            return cls()
        return cls(np.asarray(camera["K"], float), np.asarray(camera["distortion"], float))


def outline(
    raw: Mapping[tuple[int, float], NDArray[np.uint16]],
    *,
    lens: Lens,
    mask: NDArray[np.bool_] | None,
    by_hand: Floats | None,
) -> Mapping[str, NDArray[Any]]:
    """The outline at one place of the ball.

    Args:
        raw: (y, x) counts by frame and band: the pictures under all lights, or all under one each.
        lens: of the camera.
        mask: (y, x), where the ball is.
        by_hand: (point, xy) on the outline, pixels.

    Returns:
        `conic` (row, column), `ring` (point, xy) as in the picture, `centre_px` (xy), `radius_px`, `rms_px` ().

    Raises:
        KernelError: no ball, two balls, or a ball cut by the frame.
    """
    if by_hand is not None:
        frame = next(iter(raw.values())).shape
        ball = outline_of_points(by_hand, **lens._asdict(), frame=frame)
    else:
        mean = np.mean([np.asarray(picture, np.float32) for picture in raw.values()], axis=0)
        ball = find_outline(mean, mask=mask, **lens._asdict())
    return {
        "conic": ball.conic,
        "ring": ball.ring_px,
        "centre_px": ball.centre_px,
        "radius_px": np.array(ball.radius_px),
        "rms_px": np.array(ball.rms_px),
    }


def prepare(
    *, camera: Mapping[str, Any] | None, mask: Any, by_hand: Sequence[Sequence[float]] | None
) -> Mapping[str, Any]:
    """The context in numbers."""
    return {
        "lens": Lens.of(camera),
        "mask": mask_of(mask),
        "by_hand": None if by_hand is None else np.array(by_hand),
    }


def ring_radius_px(ring: Floats) -> float:
    """Radius of an outline (point, xy): that of the circle as large as its box."""
    return float(np.sqrt(np.prod(np.ptp(ring, axis=0)))) / 2

"""What is aligned: the pictures around a tracking frame, which each is, and where alignment has brought it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lightstage.hw.illuminations import CONSTANT

Image = NDArray[np.float32]
LOST = np.float32(0.02)
"""Confidence below which an aligned picture is NaN."""
DOUBTED = np.float32(0.05)
"""The least confidence that doubt alone leaves: a flow that may be wrong is not a point that is hidden."""
UNKNOWN = np.float32(0.25)
"""Confidence of what may have moved and was not aligned."""


class Shot(NamedTuple):
    """One picture, as it was taken."""

    frame: int
    """Its index in the session."""
    illumination: str
    time_s: float
    """The tracking frame's is 0."""


class Shots(NamedTuple):
    """A tracking frame's set, and the tracking frames beside it."""

    members: tuple[Shot | None, ...]
    """In the order of the dimension `member`; None for a place that this set does not fill."""
    around: tuple[Shot, ...]
    """The tracking frames before and after that are no members."""
    bands_nm: tuple[float, ...]
    components: tuple[str, ...]
    """What lies along the first axis of a picture; the diffuse component, or the total, is first."""
    moving: bool
    """Whether the subject may have moved between the pictures."""
    apart: bool
    """Whether every picture of the set is a set of its own, because nothing is to be moved."""

    @property
    def filled(self) -> dict[int, Shot]:
        """The set's pictures by their place along `member`."""
        return {place: shot for place, shot in enumerate(self.members) if shot is not None}

    @property
    def tracking(self) -> int:
        """The place of the tracking frame; of the first picture, where none is under constant light."""
        constant = [
            place for place, shot in self.filled.items() if shot.illumination == CONSTANT and shot.time_s == 0
        ]
        return (constant or list(self.filled))[0]

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> "Shots":
        """From plain data: a shot is its three fields, or None."""
        return cls(
            tuple(None if shot is None else Shot(*shot) for shot in plain["members"]),
            tuple(Shot(*shot) for shot in plain["around"]),
            tuple(plain["bands_nm"]),
            tuple(plain["components"]),
            plain["moving"],
            plain["apart"],
        )


@dataclass
class Member:
    """A picture of the set on its way to the tracking frame."""

    place: int
    """Along the dimension `member`."""
    shot: Shot
    bands: Sequence[Image]
    """(component, y, x) each, as they came."""
    picture: Image
    """(y, x): what its motion is told by, all bands as one."""
    flow: Image
    """(xy, y, x), pixels, on the tracking frame's grid; NaN where it is left out."""
    confidence: Image
    """(y, x), 0 to 1."""
    left_out: bool = False
    """Whether the picture does not belong to the set."""

    @classmethod
    def unmoved(cls, place: int, shot: Shot, bands: Sequence[Image], picture: Image) -> "Member":
        """Where it was taken, and sure of it wherever it is valid."""
        flow = np.zeros((2, *picture.shape), np.float32)
        return cls(place, shot, bands, picture, flow, np.isfinite(picture).astype(np.float32))

    @property
    def illumination(self) -> str:
        """Under which light it was taken."""
        return self.shot.illumination

    @property
    def is_constant(self) -> bool:
        """Whether that is the tracking frame's light."""
        return self.illumination == CONSTANT

    def __str__(self) -> str:
        return f"frame {self.shot.frame} ({self.illumination})"

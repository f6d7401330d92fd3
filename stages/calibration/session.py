"""What the calibration stages ask of a session: which camera, which frames, which place of the target."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.dag.stage import Grid, StageError

SCALE = 16
"""Stored value = counts x this: a mean of frames has fractions."""


def reference(raw: Grid) -> int:
    """Index of the reference camera along `polarisation`: cross, or the only one."""
    polarisations = list(raw.along("polarisation"))
    return polarisations.index("cross") if "cross" in polarisations else 0


def parts(facts: Mapping[str, Any], frames: int) -> list[int]:
    """Per frame, the place of the target (0 when it was not moved)."""
    return list(facts.get("part", [0] * frames))


def frames_of(raw: Grid, wanted: str) -> list[int]:
    """Indices of the frames under an illumination; `L` means every single light."""
    names = list(raw.along("illumination"))
    return [i for i, name in enumerate(names) if name == wanted or (wanted == "L" and name.startswith("L"))]


def need_target(facts: Mapping[str, Any], kind: str, why: str) -> Mapping[str, Any]:
    """The session's target.

    Raises:
        StageError: it is not of the kind.
    """
    target = facts["target"] or {}
    if target.get("kind") != kind:
        shown = f"shows {target['kind']}" if target else "names no target"
        raise StageError(f"{why} needs a capture with target: {{kind: {kind}, ...}}; this one {shown}")
    return target


def light_numbers(names: Sequence[str]) -> list[int]:
    """The numbers of the single lights among illuminations, each once, in order."""
    return sorted({int(name[1:]) for name in names if name.startswith("L")})


def intrinsics(items: Mapping[str, Mapping[str, Any]], shape: Sequence[int]) -> dict[str, Any] | None:
    """The part of the camera item that geometry reads, or None when there is none.

    Raises:
        StageError: it is for pictures of another size.
    """
    if "camera" not in items:
        return None
    camera = items["camera"]
    width, height = camera["size_px"]
    if (height, width) != tuple(shape):
        raise StageError(f"the camera item is for {width} x {height}; the pictures are {shape[1]} x {shape[0]}")
    return {name: camera[name] for name in ("K", "distortion", "world_to_camera")}


def listed(mask: NDArray[np.bool_]) -> list[list[int]]:
    """(x, y) of a mask's pixels."""
    return [[int(x), int(y)] for y, x in np.argwhere(mask)]


def stored(counts: NDArray[Any]) -> NDArray[np.uint16]:
    """Counts as an item's picture holds them."""
    return np.clip(np.round(counts * SCALE), 0, 65535).astype(np.uint16)

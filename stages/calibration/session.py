"""What the calibration stages ask of a session: which camera, which frames, which place of the target."""

from collections.abc import Mapping, Sequence
from typing import Any

from lightstage.dag.stage import Grid, Items, StageError
from lightstage.hw import cameras
from lightstage.hw.illuminations import is_light, light_number


def reference(raw: Grid) -> int:
    """Index of the reference camera along `polarisation`: cross, or the only one."""
    return cameras.reference_index(list(raw.along("polarisation")))


def reference_camera(facts: Mapping[str, Any]) -> str:
    """The name of the reference camera."""
    return cameras.reference_camera(facts["cameras"])


def mount_of(facts: Mapping[str, Any], camera: str) -> Mapping[str, Any]:
    """How a camera is mounted: rotate and mirror."""
    mount: Mapping[str, Any] = facts["mount"].get(camera, {"rotate": 0, "mirror": False})
    return mount


def upright_shape(facts: Mapping[str, Any], camera: str) -> tuple[int, int]:
    """(rows, columns) of a camera's pictures, mount undone."""
    rows, columns = facts["shape"]
    turned = mount_of(facts, camera)["rotate"] in (90, 270)
    return (columns, rows) if turned else (rows, columns)


def parts(facts: Mapping[str, Any], frames: int) -> list[int]:
    """Per frame, the place of the target (0 when it was not moved)."""
    return list(facts.get("part", [0] * frames))


def exposures_s(facts: Mapping[str, Any], frames: int) -> list[float | None]:
    """Per frame, how long it was exposed; None where the capture does not say."""
    return list(facts.get("exposure_s", [None] * frames))


def frames_of(raw: Grid, illumination: str) -> list[int]:
    """Indices of the frames under an illumination."""
    return [i for i, name in enumerate(raw.along("illumination")) if name == illumination]


def single_lights(raw: Grid) -> list[int]:
    """Indices of the frames under one light each."""
    return [i for i, name in enumerate(raw.along("illumination")) if is_light(name)]


def light_numbers(names: Sequence[str]) -> list[int]:
    """The numbers of the single lights among illuminations, each once, in order."""
    return sorted({light_number(name) for name in names if is_light(name)})


def need_target(facts: Mapping[str, Any], kind: str, why: str) -> Mapping[str, Any]:
    """The session's target.

    Raises:
        StageError: it is not of the kind.
    """
    target: Mapping[str, Any] = facts["target"] or {}
    if target.get("kind") != kind:
        shown = f"shows {target['kind']}" if target else "names no target"
        raise StageError(f"{why} needs a capture with target: {{kind: {kind}, ...}}; this one {shown}")
    return target


def intrinsics(items: Items, shape: Sequence[int]) -> dict[str, Any] | None:
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
    return {name: camera[name] for name in ("size_px", "K", "distortion", "world_to_camera")}


def stored_picture(items: Items, kind: str, camera: str) -> dict[str, Any] | None:
    """What a dark or flat item has of a camera, and in which steps; None when it has nothing."""
    if kind not in items or camera not in items[kind]["pictures"]:
        return None
    return {"picture": items[kind]["pictures"][camera], "scale": items[kind]["scale"]}

"""Captures of targets as declarations see them: sizes and labels, no pixels."""

from collections.abc import Sequence
from typing import Any

from lightstage.dag.stage import CalibrationPicture, Grid, Stage

BOTH = ("parallel", "cross")
FACTS: dict[str, Any] = {
    "cameras": {"parallel": "CAM0", "cross": "CAM1"},
    "mount": {"CAM0": {"rotate": 90, "mirror": True}},
    "shape": [8, 12],
    "white_level": 1023,
    "mask": None,
    "target": None,
}
BALL = {**FACTS, "target": {"kind": "mirror_ball", "radius_mm": 38.1}}
BOARD = {**FACTS, "target": {"kind": "checkerboard", "inner_corners": [4, 3], "square_mm": 12.0}}
CAMERA = {
    "size_px": [12, 8],
    "K": [[30, 0, 6], [0, 30, 4], [0, 0, 1]],
    "distortion": [0, 0, 0, 0, 0],
    "world_to_camera": {"R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "t_mm": [0, 0, 890]},
    "residuals": {"rms_px": 0.2},
}


def raw(illumination: Sequence[str], *, bands: Sequence[float] = (0.0,), cameras: Sequence[str] = BOTH) -> Grid:
    return Grid(
        {"frame": len(illumination), "band": len(bands), "polarisation": len(cameras), "y": 8, "x": 12},
        {
            "illumination": (("frame",), list(illumination)),
            "band": (("band",), list(bands)),
            "polarisation": (("polarisation",), list(cameras)),
        },
    )


def outline(*part: int) -> Grid:
    return Grid({"part": len(part)}, {"part": (("part",), list(part))})


def corners(frames: int, cameras: Sequence[str] = BOTH) -> Grid:
    sizes = {"frame": frames, "polarisation": len(cameras), "row": 3, "column": 4, "xy": 2}
    return Grid(sizes, {"polarisation": (("polarisation",), list(cameras))})


def stored(kind: str, *cameras: str, **more: Any) -> dict[str, Any]:
    """An item with a picture of each camera."""
    pictures = {name: CalibrationPicture(f"{kind}-{name}", lambda: None) for name in cameras}
    return {kind: {"pictures": pictures, "scale": 16, "images": {}, **more}}


def context(stage: Stage, labels: dict[str, Any], facts: dict[str, Any], items: Any, **params: Any) -> Any:
    assert stage.context is not None
    return stage.context(labels, facts, items, stage.params(**params))

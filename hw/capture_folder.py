"""One capture folder of a calibration target (lightstage-capture/1) that appears whole, with items and truth."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.hw.folder import appearing, dump, save
from lightstage.hw.sensor import BITS, STORED_SCALE
from lightstage.hw.virtual_rig import CAMERA_MM, Rig, Shot

Array = NDArray[np.float64]
Exposure = tuple[dict[str, Any], Mapping[tuple[int, int], Array]]
"""A frame's keys, and its noise-free pictures by (band, camera)."""
_CAMERAS: dict[int, str] = {0: "parallel", 1: "cross"}


def written(
    shot: Shot,
    folder: Path,
    target: dict[str, Any],
    options: dict[str, Any],
    frames: Callable[[], Iterable[Exposure]],
    truth: dict[str, Any],
    *,
    cameras: Sequence[int] = (0, 1),
    items: Sequence[str] = ("camera", "dark"),
) -> Path:
    """Expose and write everything beside `folder`, then give it its name; nothing happens when it holds the same.

    Args:
        frames: called once; yields each frame's keys and noise-free pictures.
        truth: what `truth/truth.yaml` says.
        items: calibration items to add: camera, dark, flat.

    Raises:
        RigError: the folder holds something else.
    """
    what = {"virtual_rig": 1, "target": target, "options": options, "shot": shot.described()}

    def write(work: Path) -> None:
        rig = Rig.made(shot)
        generators = [np.random.default_rng([shot.seed, 25, camera]) for camera in (0, 1)]
        described = []
        numbers = shot.bands_nm if target["kind"] == "white" else (0,)
        for i, (keys, pictures) in enumerate(frames()):
            described.append(keys)
            for (band, camera), picture in pictures.items():
                name = f"{i:04d}_{keys['illumination']}_{numbers[band]}nm_CAM{camera}.png"
                save(work / name, rig.sensors[camera].expose(picture, generators[camera]))
        description = {
            "format": "lightstage-capture/1",
            "session": shot.session,
            "rig": "virtual",
            "bits": BITS,
            "frame_rate_hz": None,
            "cameras": {_CAMERAS[c]: f"CAM{c}" for c in cameras},
            "mount": {"CAM0": {"rotate": 180, "mirror": True}, "CAM1": {"rotate": 0, "mirror": False}},
            "bands_nm": list(numbers),
            "files": "{frame:04d}_{illumination}_{band}nm_{camera}.png",
            "frames": described,
            "calibration": "calibration/",
            "target": target,
        }
        dump(work / "capture.yaml", description)
        (work / "calibration").mkdir()
        _items(work / "calibration", shot, rig, items)
        (work / "truth").mkdir()
        dump(work / "truth" / "truth.yaml", truth)

    return appearing(folder, what, write)


def _items(folder: Path, shot: Shot, rig: Rig, kinds: Sequence[str]) -> None:
    for kind in kinds:
        item: dict[str, Any] = {"item": kind, "rig": "virtual"}
        if kind == "camera":
            item |= {"size_px": [shot.width, shot.height], "K": rig.K, "distortion": [0, 0, 0, 0, 0]}
            item["world_to_camera"] = {"R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "t_mm": [0, 0, CAMERA_MM]}
        else:
            for camera, sensor in enumerate(rig.sensors):
                frame = sensor.dark_frame() if kind == "dark" else sensor.flat_frame()
                save(folder / f"{kind}_CAM{camera}.png", frame)
            item |= {"images": {f"CAM{c}": f"{kind}_CAM{c}.png" for c in (0, 1)}, "scale": STORED_SCALE}
            if kind == "flat":
                item["dark_included"] = True
        dump(folder / f"{kind}.yaml", item)

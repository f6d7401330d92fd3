"""One capture folder of a target: what lies in it, and that an archive takes it."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from lightstage.hw.capture_folder import Exposure, written
from lightstage.hw.errors import RigError
from lightstage.hw.virtual_rig import Rig, Shot
from lightstage.store.importer import import_capture
from lightstage.store.root import Store

SHOT = Shot(session="target", width=48, height=36, bands_nm=(434, 576), seed=3)
LEVELS = {(0, 0): 100.0, (0, 1): 300.0}


def picture(path: Path) -> np.ndarray:
    stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert stored is not None
    return stored.astype(float)


def frames() -> Iterator[Exposure]:
    for part in (0, 4):
        yield {"illumination": "C", "part": part}, {k: np.full((36, 48), level) for k, level in LEVELS.items()}


def make(folder: Path, target: dict[str, Any] | None = None, **more: Any) -> Path:
    return written(SHOT, folder, target or {"kind": "flat"}, {"bend": 0}, frames, {"level": np.float64(2)}, **more)


def test_frames_carry_their_keys_and_pictures_their_levels(tmp_path: Path) -> None:
    folder = make(tmp_path / "a")
    description = yaml.safe_load((folder / "capture.yaml").read_text())
    assert description["frames"] == [{"illumination": "C", "part": 0}, {"illumination": "C", "part": 4}]
    assert description["cameras"] == {"parallel": "CAM0", "cross": "CAM1"}
    assert description["bands_nm"] == [0]  # a flat target is seen without filters, whatever the shot has
    assert yaml.safe_load((folder / "truth" / "truth.yaml").read_text()) == {"level": 2.0}
    rig = Rig.made(SHOT)
    for (_, camera), level in LEVELS.items():
        for frame in (0, 1):
            shown = picture(folder / f"{frame:04d}_C_0nm_CAM{camera}.png")
            sensor = rig.sensors[camera]
            # noise of 6 counts at most over 1,728 pixels: 0.15
            assert (shown - sensor.dark).mean() == pytest.approx((level * sensor.response).mean(), abs=0.5)
    # two exposures of one sensor are not one picture twice
    assert (picture(folder / "0000_C_0nm_CAM0.png") != picture(folder / "0001_C_0nm_CAM0.png")).any()


def test_items_are_those_asked_for(tmp_path: Path) -> None:
    folder = make(tmp_path / "a", items=("camera", "dark", "flat"), cameras=(1,)) / "calibration"
    assert sorted(p.name for p in folder.glob("*.yaml")) == ["camera.yaml", "dark.yaml", "flat.yaml"]
    camera = yaml.safe_load((folder / "camera.yaml").read_text())
    assert camera["size_px"] == [48, 36]
    # 1020 px at a width of 406, and the camera 890 mm from the stage's centre, looking down -z
    assert camera["K"][0][0] == pytest.approx(1020 * 48 / 406)
    assert camera["world_to_camera"]["t_mm"] == [0, 0, 890]
    flat = yaml.safe_load((folder / "flat.yaml").read_text())
    assert (flat["scale"], flat["dark_included"]) == (16, True)
    sensor = Rig.made(SHOT).sensors[1]
    np.testing.assert_allclose(picture(folder / "dark_CAM1.png") / 16, sensor.dark, atol=1 / 32)
    lit = (picture(folder / "flat_CAM1.png") - picture(folder / "dark_CAM1.png")) / 16
    np.testing.assert_allclose(lit, 0.7 * 1007 * sensor.response, atol=1 / 16 + 1e-9)


def test_a_white_target_is_seen_in_the_bands_of_the_shot(tmp_path: Path) -> None:
    def both() -> Iterable[Exposure]:
        yield {"illumination": "C"}, {(b, 1): np.full((36, 48), 100.0 * (1 + b)) for b in (0, 1)}

    folder = written(SHOT, tmp_path / "w", {"kind": "white"}, {}, both, {}, cameras=(1,))
    assert sorted(p.name for p in folder.glob("*.png")) == ["0000_C_434nm_CAM1.png", "0000_C_576nm_CAM1.png"]


def test_an_archive_takes_it(tmp_path: Path, store: Store) -> None:
    done = import_capture(make(tmp_path / "a"), store)
    assert done.warnings == ()
    assert set(done.session.items) == {"camera", "dark"}


def test_the_same_again_costs_nothing_and_another_is_refused(tmp_path: Path) -> None:
    folder = make(tmp_path / "a")
    before = {p: p.stat().st_mtime_ns for p in folder.rglob("*")}
    make(folder)
    assert {p: p.stat().st_mtime_ns for p in folder.rglob("*")} == before
    with pytest.raises(RigError, match="holds something else"):
        make(folder, {"kind": "dark"})

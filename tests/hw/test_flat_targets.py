"""Flat targets: corners that OpenCV finds in the pictures, and levels measured in them."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from lightstage.hw import flat_targets
from lightstage.hw.errors import RigError
from lightstage.hw.virtual_rig import Rig, Shot

DARK = 16.0


def picture(folder: Path, name: str) -> np.ndarray:
    stored = cv2.imread(str(folder / f"{name}.png"), cv2.IMREAD_UNCHANGED)
    assert stored is not None
    return stored.astype(float)


def truth_of(folder: Path) -> Any:
    return yaml.safe_load((folder / "truth" / "truth.yaml").read_text())


@pytest.mark.parametrize("seed", [1, 2])
def test_corners_are_where_opencv_sees_them_in_both_cameras(tmp_path: Path, seed: int) -> None:
    shot = Shot(session="board", width=320, height=244, seed=seed)
    folder = flat_targets.checkerboard(shot, tmp_path / "b", poses=2, inner_corners=(7, 5), square_mm=14.0)
    truth = truth_of(folder)
    for frame in range(2):
        for camera in (0, 1):
            shown = np.clip(picture(folder, f"{frame:04d}_C_0nm_CAM{camera}") / 4, 0, 255).astype(np.uint8)
            corners = np.array(truth[f"corners_cam{camera}"][frame], np.float32)
            assert len(corners) == 35
            stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
            seen = cv2.cornerSubPix(shown, corners[:, None] + np.float32(0.7), (4, 4), (-1, -1), stop)[:, 0]
            # noise of 1 % of the contrast: each is good to some hundredths, the mean of 35 to less
            off = seen - corners
            assert np.abs(off).max() < 0.35
            assert np.abs(off.mean(axis=0)).max() < 0.06
    board = truth["poses"][0]
    rotation = np.array(board["R"])
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)


@pytest.mark.parametrize(("kind", "level"), [("dark", 0.0), ("flat", 0.7 * 1007)])
def test_uniform_frames_average_to_the_sensor(tmp_path: Path, kind: Any, level: float) -> None:
    shot = Shot(session="u", width=64, height=48)
    folder = flat_targets.uniform(shot, tmp_path / "u", kind=kind, repeats=4)
    name = "O" if kind == "dark" else "C"
    assert truth_of(folder)["level"] == pytest.approx(level)
    assert len(list(folder.glob("*.png"))) == 8
    for camera in (0, 1):
        mean = np.mean([picture(folder, f"{i:04d}_{name}_0nm_CAM{camera}") for i in range(4)], axis=0)
        sensor = Rig.made(shot).sensors[camera]
        off = mean - (sensor.dark + sensor.response * level)
        # noise of 8.6 counts (1 without light) over 4 frames and 3,072 pixels
        assert abs(off.mean()) < 4 * (8.6 if level else 1.05) / np.sqrt(4 * off.size)


def test_exposures_grow_with_time_and_bend_as_asked(tmp_path: Path) -> None:
    shot = Shot(session="e", width=64, height=48)
    for bend in (0.0, 0.1):
        folder = flat_targets.exposures(shot, tmp_path / f"e{bend}", steps=6, repeats=1, bend=bend)
        frames = yaml.safe_load((folder / "capture.yaml").read_text())["frames"]
        times = np.array([frame["exposure_s"] for frame in frames])
        np.testing.assert_allclose(times, [0.002, 0.006, 0.01, 0.014, 0.018, 0.022])
        response = Rig.made(shot).sensors[1].response.mean()
        counts = np.array([picture(folder, f"{i:04d}_C_0nm_CAM1").mean() for i in range(6)]) - DARK
        share = times / 0.02  # of the full range of 1007 counts
        expected = 1007 * response * share * (1 - bend * share)
        np.testing.assert_allclose(counts[:5], expected[:5], rtol=0.01)
    assert truth_of(folder)["counts_per_s"] == pytest.approx(1007 / 0.02)


def test_a_white_target_is_as_bright_as_its_reflectance_times_the_scale(tmp_path: Path) -> None:
    shot = Shot(session="w", width=96, height=72, bands_nm=(434, 576), seed=5)
    folder = flat_targets.bands(shot, tmp_path / "w")
    truth = truth_of(folder)
    np.testing.assert_allclose(
        truth["scale"], np.prod([truth[name] for name in ("exposure", "transmission", "source")], axis=0), rtol=1e-6
    )
    described = yaml.safe_load((folder / "capture.yaml").read_text())["target"]
    np.testing.assert_allclose(described["reflectance"], truth["reflectance"], atol=1e-6)
    sensor = Rig.made(shot).sensors[1]
    for b, nm in enumerate((434, 576)):
        signal = (picture(folder, f"0000_C_{nm}nm_CAM1") - sensor.dark) / sensor.response
        middle = signal[31:41, 43:53]  # within 25 mm of the stage's centre
        # uneven by 1e-4 a mm: 0.4 %; noise of 8 counts over 100 pixels: 0.1 %
        assert middle.mean() == pytest.approx(truth["scale"][b] * truth["reflectance"][b], rel=0.01)


def test_a_chart_shows_its_printed_reflectances_and_only_in_its_bands(tmp_path: Path) -> None:
    shot = Shot(session="c", width=240, height=184, bands_nm=(655,), seed=6)
    folder = flat_targets.bands(shot, tmp_path / "c", checker=True)
    truth = truth_of(folder)
    to_image = np.array(truth["target_to_image"])
    sensor = Rig.made(shot).sensors[1]
    signal = (picture(folder, "0000_C_655nm_CAM1") - sensor.dark) / sensor.response / truth["scale"][0]
    # middles of patches of 20 mm: rows go down from v = -5, columns from u = -60; the lowest row is grey
    for column, printed in ((0, 0.889), (2, 0.350), (5, 0.033)):
        u, v = -60 + 20 * (column + 0.5), -5 - 20 * 3.5
        x, y, w = to_image @ [u, v, 1]
        around = signal[round(y / w) - 2 : round(y / w) + 3, round(x / w) - 2 : round(x / w) + 3]
        assert around.mean() == pytest.approx(printed, rel=0.02, abs=0.003)
    with pytest.raises(RigError, match=r"bands \[500\]: the ColorChecker's patches are known at \(407, 434"):
        flat_targets.bands(Shot(bands_nm=(500,)), tmp_path / "x", checker=True)
    assert not (tmp_path / "x").exists()

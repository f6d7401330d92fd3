"""Mirror balls: highlights found in the pictures where the truth has them, wiring, order, and polarisers."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from lightstage.hw import ball_targets
from lightstage.hw.errors import RigError
from lightstage.hw.virtual_rig import Shot

SHOT = Shot(session="ball", width=160, height=122, seed=4)


def pictures(folder: Path) -> list[tuple[dict[str, Any], np.ndarray]]:
    """Every frame's keys and its picture, in order."""
    frames = yaml.safe_load((folder / "capture.yaml").read_text())["frames"]
    out = []
    for i, keys in enumerate(frames):
        stored = cv2.imread(str(folder / f"{i:04d}_{keys['illumination']}_0nm_CAM1.png"), cv2.IMREAD_UNCHANGED)
        assert stored is not None
        out.append((keys, stored.astype(float)))
    return out


def truth_of(folder: Path) -> Any:
    return yaml.safe_load((folder / "truth" / "truth.yaml").read_text())


def spot(picture: np.ndarray, dark: np.ndarray) -> tuple[np.ndarray, float]:
    """Centroid and sum of what a light adds, by counting around the brightest pixel."""
    more = cv2.GaussianBlur(picture - dark, (0, 0), 1.0)
    row, column = np.unravel_index(more.argmax(), more.shape)
    y, x = np.mgrid[max(0, row - 4) : row + 5, max(0, column - 4) : column + 5]
    y, x = (np.clip(a, 0, n - 1) for a, n in ((y, picture.shape[0]), (x, picture.shape[1])))
    around = (picture - dark)[y, x]
    around = around - np.median(around)
    total = float(around.sum())
    return np.array([(x * around).sum(), (y * around).sum()]) / total, total


@pytest.fixture(scope="module")
def chrome(tmp_path_factory: pytest.TempPathFactory) -> Path:
    options: dict[str, Any] = {"positions": 2, "dead": (7,), "swapped": (2, 9)}
    return ball_targets.mirror_ball(SHOT, tmp_path_factory.mktemp("rig") / "ball", **options)


def test_every_light_makes_its_highlight_and_the_ball_is_where_it_is_said(chrome: Path) -> None:
    truth, shown = truth_of(chrome), pictures(chrome)
    assert [(k["illumination"], k["part"]) for k, _ in shown[40:45]] == [
        ("L40", 0), ("C", 0), ("O", 0), ("L00", 1), ("L01", 1),
    ]  # fmt: skip
    checked = 0
    for part in (0, 1):
        ball = truth["parts"][part]
        frames = [p for k, p in shown if k["part"] == part]
        for light in range(41):
            if not ball["visible"][light] or light in (2, 7, 9):
                continue
            place, total = spot(frames[light], frames[-1])
            np.testing.assert_allclose(place, ball["highlight_px"][light], atol=0.25)
            assert total == pytest.approx(ball["flux_counts"][light], rel=0.12)  # vignetting, and the room around
            checked += 1
        radius = 1020 * 160 / 406 * 38.1 / (890 - ball["centre_mm"][2])
        middle = np.mean([p for p, seen in zip(ball["highlight_px"], ball["visible"], strict=True) if seen], axis=0)
        along = np.array(ball["highlight_px"]) - middle
        assert np.linalg.norm(along, axis=1).max() < 2 * radius
    assert checked > 50


def test_a_dead_light_is_dark_and_swapped_ones_light_for_each_other(chrome: Path) -> None:
    ball = truth_of(chrome)["parts"][0]
    frames = [p for k, p in pictures(chrome) if k["part"] == 0]
    assert ball["flux_counts"][7] == 0
    assert np.abs((frames[7] - frames[-1]).mean()) < 0.1  # noise of 1.4 over 19,520 pixels
    for light, other in ((2, 9), (9, 2)):
        np.testing.assert_allclose(spot(frames[light], frames[-1])[0], ball["highlight_px"][other], atol=0.25)


def test_lights_that_are_not_there_cannot_be_dead(tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"lights \[41\] cannot be dead: this rig has L00 to L40"):
        ball_targets.mirror_ball(SHOT, tmp_path / "x", dead=(41,))
    assert not (tmp_path / "x").exists()


def test_a_test_sequence_lights_quarters_and_leaks_a_little(tmp_path: Path) -> None:
    order = (0, 1, 3, 2)
    folder = ball_targets.sync(SHOT, tmp_path / "s", cycles=1, leak=0.05, order=order)
    truth, shown = truth_of(folder), pictures(folder)
    names = [keys["illumination"] for keys, _ in shown]
    assert names == [*(f"L{k:02d}" for k in range(41)), "C", "O", "T0", "T1", "T2", "T3"]
    assert truth["shown"] == list(order)
    dark = shown[42][1]
    seen = np.flatnonzero(truth["visible"])
    y, x = np.mgrid[0:122, 0:160]
    # where highlights are; elsewhere a picture of one light is its noise
    on = np.any([np.hypot(x - u, y - v) < 2 for u, v in np.array(truth["highlight_px"])[seen]], axis=0)
    alone = np.stack([(shown[k][1] - dark)[on] for k in seen], axis=1)
    for i, step in enumerate(order):
        # light adds: each picture is a sum of the pictures of one light each
        drive = np.linalg.lstsq(alone, (shown[43 + i][1] - dark)[on], rcond=None)[0]
        leaks = truth["leak_before"][i], truth["leak_after"][i]
        assert drive[seen % 4 == step].mean() == pytest.approx(1 - sum(leaks), abs=0.02)
        for neighbour, leak in ((step - 1, leaks[0]), (step + 1, leaks[1])):
            if 0 <= neighbour < 4:
                assert drive[seen % 4 == neighbour].mean() == pytest.approx(leak, abs=0.02)


def test_a_light_is_as_bright_as_the_law_of_its_polariser(tmp_path: Path) -> None:
    angles = (0, 45, 90, 135)
    folder = ball_targets.polarisers(SHOT, tmp_path / "p", ball="plastic", angles_deg=angles)
    truth, shown = truth_of(folder), pictures(folder)
    assert yaml.safe_load((folder / "capture.yaml").read_text())["target"]["material"] == "dielectric"
    assert [k.get("polariser_deg") for k, _ in shown[:5]] == [0, 45, 90, 135, 0]
    assert "polariser_deg" not in shown[-1][0]
    dark = np.full((122, 160), 16.0)
    compared = 0
    for light in range(41):
        if not truth["visible"][light]:
            continue
        sums = np.array([spot_at(shown[4 * light + i][1] - dark, truth["highlight_px"][light]) for i in range(4)])
        if sums.max() < 500:
            continue
        # I(t) = a + b cos^2(t - theta0): what two crossed settings add up to does not depend on the setting
        assert sums[0] + sums[2] == pytest.approx(sums[1] + sums[3], rel=0.08)
        double = np.radians(2 * np.array(angles))
        theta0 = 0.5 * np.degrees(np.arctan2(sums @ np.sin(double), sums @ np.cos(double)))
        off = (theta0 - truth["theta0_deg"][light] + 90) % 180 - 90
        assert abs(off) < 3, light
        compared += 1
    assert compared > 20


def spot_at(picture: np.ndarray, place: list[float]) -> float:
    """Sum over 9 x 9 pixels, less what lies around."""
    x, y = (round(v) for v in place)
    around = picture[y - 6 : y + 7, x - 6 : x + 7]
    return float((around[2:-2, 2:-2] - np.median(around)).sum())

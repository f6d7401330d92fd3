"""The virtual rig is good enough to be believed: its light is physical, its truth is true, its seed decides."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from hw import head, skin
from hw.errors import RigError
from hw.sensor import ELECTRONS_PER_COUNT, OFFSET, READ_NOISE_ELECTRONS, Sensor
from hw.virtual_rig import Shot, capture
from store.importer import import_capture
from store.root import Store


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return capture(Shot(width=120, height=92, bands_nm=(434, 576)), tmp_path_factory.mktemp("rig") / "demo")


def picture(folder: Path, name: str) -> np.ndarray:
    found = cv2.imread(str(folder / f"{name}.png"), cv2.IMREAD_UNCHANGED)
    assert found is not None
    return found.astype(float)


def test_what_it_writes_is_a_capture_that_imports_without_a_word(small: Path, store: Store) -> None:
    done = import_capture(small, store)
    assert done.warnings == ()
    assert set(done.session.items) == {"camera", "homography", "lights", "dark", "flat", "bands"}
    assert max(row["saturated"] for row in done.session.verdict) < 0.001


def test_light_adds(small: Path) -> None:
    """X + X' = C up to noise: the mean of 5,000 pixels is known to 0.2 counts."""
    total = picture(small, "0001_X_576nm_CAM1") + picture(small, "0004_Xc_576nm_CAM1") - OFFSET
    constant = picture(small, "0000_C_576nm_CAM1")
    lit = constant > 60
    assert abs(np.mean((total - constant)[lit])) < 0.3


def test_the_parallel_camera_is_turned_and_mirrored(small: Path) -> None:
    """Undoing the mount (upside down here) brings it within a few pixels of the other."""
    cross = picture(small, "0000_C_576nm_CAM1")
    parallel = picture(small, "0000_C_576nm_CAM0")
    right = np.corrcoef(parallel[::-1].ravel(), cross.ravel())[0, 1]
    wrong = np.corrcoef(parallel.ravel(), cross.ravel())[0, 1]
    assert right > 0.9 > wrong


def test_truth_normals_are_those_of_the_depth_map(small: Path) -> None:
    """Independent of the distance field's gradient: cross products of neighbouring points. Relief of 2 mm is below
    the pixel of 3 mm at this size, so the median is compared."""
    truth = np.load(small / "truth" / "ground_truth_cam1.npz")
    camera = yaml.safe_load((small / "calibration" / "camera.yaml").read_text())
    matrix = np.array(camera["K"])
    depth, mask = truth["depth_mm"].astype(float), truth["mask"]
    y, x = np.mgrid[0 : depth.shape[0], 0 : depth.shape[1]]
    px = (x - matrix[0, 2]) / matrix[0, 0] * depth
    py = -(y - matrix[1, 2]) / matrix[1, 1] * depth
    points = np.stack([px, py, 890 - depth])
    across = points[:, 1:-1, 2:] - points[:, 1:-1, :-2]
    up = points[:, :-2, 1:-1] - points[:, 2:, 1:-1]
    normal = np.cross(across, up, axis=0)
    normal /= np.linalg.norm(normal, axis=0) + 1e-30
    inside = cv2.erode(mask.astype(np.uint8), np.ones((5, 5)))[1:-1, 1:-1] > 0
    cosine = np.einsum("ayx,yxa->yx", normal, truth["normal"][1:-1, 1:-1])[inside]
    assert np.median(np.degrees(np.arccos(np.clip(cosine, -1, 1)))) < 8
    np.testing.assert_allclose(np.linalg.norm(truth["normal"][mask], axis=1), 1, rtol=1e-5)


def test_the_same_seed_gives_the_same_bytes_and_another_another_head(small: Path, tmp_path: Path) -> None:
    shot = Shot(width=64, height=48, bands_nm=(576,))
    first, second = capture(shot, tmp_path / "a"), capture(shot, tmp_path / "b")
    for path in sorted(first.rglob("*.png")):
        assert path.read_bytes() == (second / path.relative_to(first)).read_bytes()
    other = capture(Shot(width=64, height=48, bands_nm=(576,), seed=2), tmp_path / "c")
    masks = [np.load(f / "truth" / "ground_truth_cam1.npz")["mask"] for f in (first, other)]
    assert (masks[0] != masks[1]).any()


def test_it_does_not_write_over_something_else(tmp_path: Path) -> None:
    shot = Shot(width=64, height=48, bands_nm=(0,))
    capture(shot, tmp_path / "a")
    capture(shot, tmp_path / "a")  # the same: nothing happens
    with pytest.raises(RigError, match="holds something else"):
        capture(Shot(width=64, height=48, bands_nm=(0,), seed=9), tmp_path / "a")
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("wrong", [{"width": 8}, {"bands_nm": (200,)}, {"seed": -1}, {"bands_nm": ()}])
def test_impossible_shots_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(RigError):
        Shot(**wrong)  # type: ignore[arg-type]


def test_the_sensors_noise_is_shot_and_read_noise() -> None:
    """Variance = counts / gain + read noise; 160,000 pixels know it to 1 %."""
    generator = np.random.default_rng(0)
    sensor = Sensor(np.full((400, 400), OFFSET), np.ones((400, 400)))
    shown = sensor.expose(np.full((400, 400), 500.0), generator).astype(float)
    expected = 500 / ELECTRONS_PER_COUNT + (READ_NOISE_ELECTRONS / ELECTRONS_PER_COUNT) ** 2 + 1 / 12
    assert shown.mean() == pytest.approx(500 + OFFSET, abs=0.1)
    assert shown.var() == pytest.approx(expected, rel=0.03)


def test_skin_is_darker_in_blue_and_blood_shows_at_576() -> None:
    pale, flushed = np.array([0.2]), np.array([0.6])
    assert skin.albedo(pale, pale, 434) < skin.albedo(pale, pale, 655)
    drop = [float(skin.albedo(pale, flushed, b)[0] / skin.albedo(pale, pale, b)[0]) for b in (576, 655)]
    assert drop[0] < 0.8 < drop[1]


def test_the_head_is_closed_and_in_its_bound() -> None:
    shape = head.parts(3)
    field = head.coarse_field(shape)
    assert field.min() < -20
    rim = np.concatenate(
        [field[0].ravel(), field[-1].ravel(), field[:, -1].ravel(), field[:, :, 0].ravel(), field[:, :, -1].ravel()]
    )
    assert rim.min() > 0

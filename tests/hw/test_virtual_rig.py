"""The virtual rig is good enough to be believed: its light is physical, its truth is true, its seed decides."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from lightstage.hw.errors import RigError
from lightstage.hw.gradients import weights
from lightstage.hw.sensor import OFFSET
from lightstage.hw.virtual_rig import Shot, capture
from lightstage.store.importer import import_capture
from lightstage.store.root import Store


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


@pytest.mark.slow
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


@pytest.mark.parametrize(
    "wrong",
    [
        {"width": 8},
        {"bands_nm": (200,)},
        {"seed": -1},
        {"bands_nm": ()},
        {"motion": "walk", "bands_nm": (0,)},
        {"motion": "slow"},  # six bands
        {"motion": "slow", "bands_nm": (0,), "sequence": ("X", "Y")},
    ],
)
def test_impossible_shots_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(RigError):
        Shot(**wrong)  # type: ignore[arg-type]


CYCLE = ("X", "Z", "C", "Y", "Xc")


@pytest.fixture(scope="module")
def fast(tmp_path_factory: pytest.TempPathFactory) -> Path:
    shot = Shot(width=160, height=122, bands_nm=(0,), sequence=(*CYCLE, "C", "Zc"), motion="fast")
    return capture(shot, tmp_path_factory.mktemp("rig") / "fast")


def truth_of(folder: Path, frame: int) -> dict[str, np.ndarray]:
    with np.load(folder / "truth" / f"gt_t{frame:02d}.npz") as file:
        return {name: file[name].astype(np.float32) for name in file}


def flow_of(folder: Path, frame: int) -> dict[str, np.ndarray]:
    with np.load(folder / "truth" / f"flow_t{frame:02d}.npz") as file:
        return {name: file[name] for name in file}


def brought(picture_there: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """What lies where the flow points, bilinear."""
    y, x = np.mgrid[0 : flow.shape[0], 0 : flow.shape[1]].astype(np.float32)
    to = flow.astype(np.float32)
    return cv2.remap(picture_there, x + to[..., 0], y + to[..., 1], cv2.INTER_LINEAR)


def inner(mask: np.ndarray) -> np.ndarray:
    return cv2.erode(mask.astype(np.uint8), np.ones((5, 5))) > 0


@pytest.mark.slow
def test_a_performance_is_a_capture_in_time_that_imports(fast: Path, store: Store) -> None:
    done = import_capture(fast, store)
    assert done.warnings == ()
    description = yaml.safe_load((fast / "capture.yaml").read_text())
    assert description["frame_rate_hz"] == 60
    assert description["cameras"] == {"cross": "CAM1"}
    assert [frame["illumination"] for frame in description["frames"]] == [*CYCLE, "C", "Zc"]
    assert description["frames"][3]["time_s"] == pytest.approx(0.05)
    assert max(row["saturated"] for row in done.session.verdict) < 0.001


def test_flow_goes_to_the_tracking_frames_and_from_them_to_what_stands_between(fast: Path) -> None:
    """The same names as in the rendered performances, whose first C is at 2 as well."""
    labels = [{k.removeprefix("flow_to_") for k in flow_of(fast, t) if k.startswith("flow_to")} for t in range(7)]
    assert labels == [
        {"nextC"},
        {"nextC"},
        {"nextC", "t00", "t01", "t03", "t04"},
        {"prevC", "nextC"},
        {"prevC", "nextC"},
        {"prevC", "t03", "t04", "t06"},
        {"prevC"},
    ]
    assert (int(flow_of(fast, 3)["t_prevC"]), int(flow_of(fast, 3)["t_nextC"])) == (2, 5)


def test_a_rigid_point_is_where_turning_and_shifting_by_hand_brings_it(fast: Path) -> None:
    """The upper forehead and crown, above all that talks. float16 flow of 6 px is good to 0.002 px, the field's hit
    to 0.01 mm.
    """
    camera = yaml.safe_load((fast / "calibration" / "camera.yaml").read_text())
    k = np.array(camera["K"])
    course = yaml.safe_load((fast / "truth" / "meta.yaml").read_text())["motion_per_frame"]
    here, there = 1, 2
    truth, found = truth_of(fast, here), flow_of(fast, here)
    depth = truth["depth_mm"].astype(float)
    y, x = np.mgrid[0 : depth.shape[0], 0 : depth.shape[1]]
    px, py = (x - k[0, 2]) / k[0, 0] * depth, -(y - k[1, 2]) / k[1, 1] * depth
    world = np.stack([px, py, 890 - depth], axis=-1)

    def turn(frame: int) -> np.ndarray:
        return Rotation.from_euler("xyz", course[frame]["rot_deg_xyz"], degrees=True).as_matrix()

    own = (world - course[here]["trans_mm"]) @ turn(here)
    moved = own @ turn(there).T + course[there]["trans_mm"]
    u = k[0, 0] * moved[..., 0] / (890 - moved[..., 2]) + k[0, 2]
    v = -k[1, 1] * moved[..., 1] / (890 - moved[..., 2]) + k[1, 2]
    rigid = (truth["mask"] > 0) & (own[..., 1] > 75)
    assert rigid.sum() > 300
    expected = np.stack([u - x, v - y], axis=-1)[rigid]
    assert np.linalg.norm(expected, axis=-1).mean() > 0.3
    np.testing.assert_allclose(found["flow_to_nextC"][rigid].astype(float), expected, atol=0.01)
    # visible: the other picture's depth is that of the point, up to interpolation on a curved surface
    seen = rigid & found["visible_nextC"] & inner(truth["mask"])
    seen &= brought(np.float32(inner(truth_of(fast, there)["mask"])), found["flow_to_nextC"]) > 0.999
    error = np.abs(brought(truth_of(fast, there)["depth_mm"], found["flow_to_nextC"]) - (890 - moved[..., 2]))[seen]
    assert np.percentile(error, 95) < 1.0


def test_skin_and_relief_move_with_the_flow(fast: Path) -> None:
    """Skin brought from another picture along the flow is this picture's skin; left where it was, it is not.

    Talking included: lips and cheeks have most of the colour. Freckles and pores are finer than these pixels of
    2 mm and bilinear values blur them, so pictures are compared after a blur of 1 px.
    """
    for here, label, there in ((0, "nextC", 2), (2, "t04", 4), (6, "prevC", 5)):
        found, mine, other = flow_of(fast, here), truth_of(fast, here), truth_of(fast, there)
        keep = inner(mine["mask"]) & found[f"visible_{label}"]
        keep &= brought(other["mask"], found[f"flow_to_{label}"]) > 0.999
        still = np.zeros_like(found[f"flow_to_{label}"])
        for name in ("albedo", "normal"):
            followed, left = (
                np.mean(np.abs(cv2.GaussianBlur(brought(other[name], flow) - mine[name], (0, 0), 1.0))[keep])
                for flow in (found[f"flow_to_{label}"], still)
            )
            assert left > 2.5 * followed


def test_the_lamps_stay_where_they_are_when_the_head_turns(fast: Path) -> None:
    """The forehead against Lambert's law summed over the lamps in the world's frame.

    Only its own relief shades it a little, at rest (the first picture) as in motion. Lamps that turned with the
    head would be off by 0.01 (Y) and 0.024 (Xc).
    """
    camera = yaml.safe_load((fast / "calibration" / "camera.yaml").read_text())
    k = np.array(camera["K"])
    lamps = yaml.safe_load((fast / "calibration" / "lights.yaml").read_text())["lights"]
    places, ideal = (np.array([lamp[key] for lamp in lamps]) for key in ("position_mm", "drive_position"))
    exposure = yaml.safe_load((fast / "calibration" / "bands.yaml").read_text())["bands"][0]["exposure"]
    sensor = [
        cv2.imread(str(fast / "calibration" / f"{kind}_CAM1.png"), cv2.IMREAD_UNCHANGED) / 16
        for kind in ("dark", "flat")
    ]
    ratio = []
    for frame, name in ((0, "X"), (2, "C"), (3, "Y"), (4, "Xc"), (5, "C")):
        truth = truth_of(fast, frame)
        depth = truth["depth_mm"].astype(float)
        y, x = np.mgrid[0 : depth.shape[0], 0 : depth.shape[1]]
        px, py = (x - k[0, 2]) / k[0, 0] * depth, -(y - k[1, 2]) / k[1, 1] * depth
        forehead = inner(truth["mask"]) & (np.abs(px) < 30) & (py > 60) & (py < 95)
        to_lamp = places - np.stack([px, py, 890 - depth], axis=-1)[forehead][:, None]
        distance = np.linalg.norm(to_lamp, axis=-1)
        cosine = np.einsum("pli,pi->pl", to_lamp, truth["normal"][forehead].astype(float)) / distance
        drive = weights(name, ideal)
        light = np.sum(drive * np.clip(cosine, 0, None) * (790 / distance) ** 2, axis=1)
        expected = exposure * truth["albedo"][forehead] / 2 * light
        response = (sensor[1] - sensor[0])[forehead] / (0.7 * 1007)
        counts = (picture(fast, f"{frame:04d}_{name}_0nm_CAM1") - sensor[0])[forehead] / response
        ratio.append(np.sum(counts) / np.sum(expected))
    assert ratio[0] == pytest.approx(1, abs=0.03)
    np.testing.assert_allclose(ratio, ratio[0], atol=0.006)


def test_hidden_skin_is_not_visible(fast: Path) -> None:
    """Most of the head stays visible from one picture to the next, a rim does not, and nothing off the head is."""
    found, mask = flow_of(fast, 2), truth_of(fast, 2)["mask"] > 0
    for t in (0, 1, 3, 4):
        visible = found[f"visible_t{t:02d}"]
        assert 0.9 < visible[mask].mean() < 1
        assert not visible[~mask].any()
        assert (found[f"flow_to_t{t:02d}"][~mask] == 0).all()


@pytest.mark.slow
def test_a_still_performance_is_the_static_head(tmp_path: Path) -> None:
    """Truth to the last bit; pictures up to noise, because each has its own exposure."""
    shot = {"width": 80, "height": 61, "bands_nm": (0,)}
    static = capture(Shot(**shot, sequence=("C", "X")), tmp_path / "static")  # type: ignore[arg-type]
    still = capture(Shot(**shot, sequence=("C", "X"), motion="still"), tmp_path / "still")  # type: ignore[arg-type]
    with np.load(static / "truth" / "ground_truth_cam1.npz") as truth:
        for frame in (0, 1):
            mine = truth_of(still, frame)
            np.testing.assert_array_equal(mine["depth_mm"], truth["depth_mm"])
            np.testing.assert_array_equal(mine["mask"] > 0, truth["mask"])
            expected = np.where(truth["mask"][..., None], truth["normal"], 0)
            np.testing.assert_allclose(mine["normal"], expected, atol=5e-4)  # float16
    assert (flow_of(still, 1)["flow_to_prevC"] == 0).all()
    exposure = [
        yaml.safe_load((f / "calibration" / "bands.yaml").read_text())["bands"][0]["exposure"]
        for f in (static, still)
    ]
    for name in ("0000_C_0nm_CAM1", "0001_X_0nm_CAM1"):
        a, b = ((picture(f, name) - OFFSET) / e for f, e in zip((static, still), exposure, strict=True))
        lit = b * exposure[1] > 60
        assert np.sum(a[lit]) == pytest.approx(np.sum(b[lit]), rel=0.005)
        assert np.corrcoef(a[lit], b[lit])[0, 1] > 0.97


def test_a_static_folder_says_nothing_of_motion(small: Path) -> None:
    """What a static folder is told apart by is what it was before there was motion."""
    assert "motion" not in yaml.safe_load((small / "virtual_rig.yaml").read_text())["shot"]
    assert yaml.safe_load((small / "capture.yaml").read_text())["frame_rate_hz"] is None

"""The whole path on captures with truth. Tolerances are what 41 near lights and 10 bits allow, as measured once
(docs/accuracy.md) with a few hundredths of a degree for another library's rounding; a correct implementation cannot
be much better without a model of near light, and a wrong sign, frame or flat is far worse."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
import xarray

from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.store.document import load
from tests.conftest import Answer, run_process
from tests.rendered import angle, difference_without_noise, displacement, truth_of

pytestmark = [pytest.mark.data, pytest.mark.slow]
Run = Callable[..., Path]


@pytest.fixture(scope="module")
def run(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Import a capture, run a node with settings, and return the path of its result."""
    store = tmp_path_factory.mktemp("data") / "store"
    names: dict[str, str] = {}

    def call(capture: str, node: str, *settings: str) -> Path:
        if capture not in names:
            done = run_process("import", data / capture, "--json", store=store)
            assert done.returncode == 0, done.stderr
            names[capture] = json.loads(done.stdout)["session"]
        words = [word for setting in settings for word in ("--set", setting)]
        done = run_process("run", node, "--session", names[capture], "--json", *words, store=store)
        assert done.returncode == 0, done.stderr
        return Path(Answer(0, done.stdout, "").json["nodes"][node]["path"])

    return call


def error(path: Path, folder: Path, band: float) -> np.ndarray:
    opened = xarray.open_zarr(path, chunks=None)
    truth, mask = truth_of(folder)
    index = list(opened.band.values).index(band)
    return angle(opened.normal.values[0, index], truth)[mask]


LIMITS = {
    "rendered/static_sphere": (0.0, {"difference": 2.1, "ratio": 3.0, "minimal": 2.9}),
    "rendered/static_cylinder": (0.0, {"difference": 4.5, "ratio": 4.9, "minimal": 4.8}),
    "rendered/static_A": (576.0, {"difference": 9.4, "ratio": 9.8, "minimal": 9.7}),
}


@pytest.mark.parametrize("capture", LIMITS)
def test_diffuse_normals_reach_what_the_physics_allows(run: Run, data: Path, capture: str) -> None:
    band, limits = LIMITS[capture]
    for method in ("difference", "ratio"):
        path = run(capture, "normals", f"normals.method={method}")
        assert error(path, data / capture, band).mean() < limits[method], method
    for base in "XYZ":
        path = run(capture, "normals", "normals.method=minimal", f"normals.base={base}")
        assert error(path, data / capture, band).mean() < limits["minimal"], base


@pytest.mark.parametrize(("method", "limit"), [("difference", 12.8), ("ratio", 20.6)])
def test_specular_normals_of_the_sphere(run: Run, data: Path, method: str, limit: float) -> None:
    path = run("rendered/static_sphere", "normals", f"normals.method={method}", "normals.component=specular")
    found = error(path, data / "rendered/static_sphere", 0.0)
    assert np.nanmean(found) < limit
    assert np.isnan(found).mean() < 0.01  # saturated highlights, and what the other camera does not see


def test_six_bands_together_are_less_noisy_than_one(run: Run, data: Path) -> None:
    folder = data / "rendered/static_A"
    clean = difference_without_noise(folder)
    _, mask = truth_of(folder)
    one = xarray.open_zarr(run("rendered/static_A", "normals", "normals.method=difference"), chunks=None)
    six = xarray.open_zarr(run("rendered/static_A", "normals", "normals.fuse=bands"), chunks=None)
    assert six.band.values.tolist() == [0.0]
    index = one.band.values.tolist().index(576.0)
    alone = angle(one.normal.values[0, index], clean)[mask].mean()
    together = angle(six.normal.values[0, 0], clean)[mask].mean()
    assert alone / together > 1.8


@pytest.mark.parametrize("name", ["static_A", "fullres_A"])
def test_registration_leaves_less_than_a_tenth_of_a_pixel(run: Run, data: Path, name: str) -> None:
    path = run(f"rendered/{name}", "register")
    moved = displacement(xarray.open_zarr(path, chunks=None), data / "rendered" / name)
    assert np.hypot(*np.median(moved, axis=0)) < 0.1


def test_real_balls_one_light_at_a_time(run: Run, data: Path) -> None:
    """The data notes give 5.1 degrees for plain least squares on the grey ball and 4.1 on DiLiGenT's."""
    gray = xarray.open_zarr(run("real/uw_psm/gray", "normals", "normals.method=least_squares"), chunks=None)
    y, x = np.mgrid[0 : gray.sizes["y"], 0 : gray.sizes["x"]]
    nx, ny = (x - 244.5) / 107.8, -(y - 144.5) / 107.8
    inside = np.hypot(nx, ny) < 0.95
    truth = np.stack([nx, ny, np.sqrt(np.clip(1 - nx**2 - ny**2, 0, None))])
    assert np.nanmean(angle(gray.normal.sel(band=540).values[0], truth)[inside]) < 5.4

    import scipy.io

    ball = xarray.open_zarr(run("real/diligent_ball", "normals"), chunks=None)
    assert ball.attrs["method"] == "least_squares"
    measured = np.moveaxis(scipy.io.loadmat(data / "real/diligent_ball/Normal_gt.mat")["Normal_gt"], 2, 0)
    known = np.linalg.norm(measured, axis=0) > 0.5
    assert np.nanmean(angle(ball.normal.sel(band=540).values[0], measured)[known]) < 4.3


def test_performances_have_normals_at_their_tracking_frames(run: Run, data: Path) -> None:
    """Not aligned: the data notes' medians for the slow motion are 5.9 to 6.7 degrees."""
    for name, method, frames in (("wilson", "difference", [3, 7, 11]), ("minimal", "minimal", [2, 5, 8, 11])):
        folder = data / f"rendered/dynamic_A_slow_{name}"
        opened = xarray.open_zarr(run(f"rendered/dynamic_A_slow_{name}", "normals"), chunks=None)
        assert opened.attrs["method"] == method
        assert opened.tracking.values.tolist() == frames
        for i, frame in enumerate(frames):
            stored = np.load(folder / "truth" / f"gt_t{frame:02d}.npz")
            truth = np.moveaxis(stored["normal"].astype(float), 2, 0)
            truth /= np.linalg.norm(truth, axis=0) + 1e-30
            mask = cv2.erode(stored["mask"].astype(np.uint8), np.ones((3, 3))) > 0
            assert np.nanmedian(angle(opened.normal.values[i, 0], truth)[mask]) < 7


NEAR_LIMITS = {
    # capture: {(settings): (mean, median)}; what a trial of the method reached, see docs/methods/near-light.md
    "rendered/static_sphere": {("correct=near",): (1.7, 1.6), ("correct=near", "filter=nlm"): (0.7, 0.6)},
    "rendered/static_cylinder": {("correct=near",): (1.6, 1.5), ("correct=near", "filter=nlm"): (0.6, 0.5)},
    "rendered/static_A": {
        ("correct=near+shadows", "fuse=bands"): (4.1, 1.9),
        ("correct=full", "fuse=bands"): (3.3, 1.6),
        ("correct=full", "fuse=bands", "filter=nlm"): (3.0, 1.2),
        ("correct=full", "fuse=bands", "method=minimal"): (4.1, 2.3),
    },
}


@pytest.mark.parametrize("capture", NEAR_LIMITS)
def test_near_light_normals_without_a_distance_given(run: Run, data: Path, capture: str) -> None:
    for settings, (mean, median) in NEAR_LIMITS[capture].items():
        path = run(capture, "normals", *(f"normals.{setting}" for setting in settings))
        found = error(path, data / capture, 0.0)
        assert np.nanmean(found) < mean, settings
        assert np.nanmedian(found) < median, settings
        assert np.isnan(found).mean() < 0.01, settings  # the found mask may miss a pixel of the eroded one


def test_depth_of_the_head_comes_with_the_normals(run: Run, data: Path) -> None:
    path = run("rendered/static_A", "normals", "normals.correct=full", "normals.fuse=bands")
    opened = xarray.open_zarr(path, chunks=None)
    truth = np.load(data / "rendered/static_A/truth/ground_truth_cam1.npz")
    depth = opened.depth_mm.values[0]
    known = np.isfinite(depth) & truth["mask"]
    off = (depth - truth["depth_mm"])[known]
    # 3 % of the depth range, the mean removed; the distance itself comes from the norm, to 3 mm here
    assert np.abs(off - off.mean()).mean() < 0.03 * np.ptp(truth["depth_mm"][truth["mask"]])
    assert abs(np.median(off)) < 4
    assert opened.visibility.dims == ("tracking", "light", "y", "x")
    assert float(opened.visibility.max()) == pytest.approx(1)


def test_without_noise_the_near_model_leaves_less_than_a_tenth_of_a_degree(data: Path) -> None:
    """Pictures summed from the noise-free one-light arrays, so nothing but the model and the depth can be wrong."""
    from lightstage.kernels.normals import near_light, self_consistent
    from lightstage.kernels.surface.pinhole import Pinhole

    for name in ("static_sphere", "static_cylinder"):
        folder = data / "rendered" / name
        arrays = np.load(folder / "truth" / "olat_noisefree_cam1.npz")["D"].astype(np.float32)
        items = {
            kind: load(folder / "calibration" / f"{kind}.yaml", what="an item").value
            for kind in ("lights", "camera")
        }
        for light in items["lights"]["lights"]:
            light.setdefault("direction", None)
        lights = near_light.Lights.of(items["lights"], near=True)
        pictures = {"C": arrays.sum(axis=0)}
        for i, axis in enumerate("XYZ"):
            for suffix, sign in (("", 1), ("c", -1)):
                weights = ((1 + sign * lights.drive[:, i]) / 2).astype(np.float32)
                pictures[axis + suffix] = np.tensordot(weights, arrays, 1)
        truth, mask = truth_of(folder)
        camera = Pinhole.of(items["camera"], mask.shape)
        measured = near_light.measure([pictures])
        found = self_consistent.solve(measured, mask, camera, lights, model="near")
        normal = np.full((*mask.shape, 3), np.nan)
        points = camera.points(found.depth)[found.mask]
        normal[found.mask] = near_light.invert(measured.vector[0][found.mask], points, lights).normal
        assert np.nanmean(angle(normal.transpose(2, 0, 1), truth)[mask]) < 0.1, name


def calibrate(store: Path, item: str, *folders: Path) -> dict:
    out = store.parent / f"{item}.yaml"
    done = run_process("calibrate", item, "--from", *folders, "--out", out, "--json", store=store)
    assert done.returncode == 0, done.stderr
    return load(out, what="an item").value | {"answer": json.loads(done.stdout)}


def test_light_positions_from_the_rendered_ball(data: Path, tmp_path: Path) -> None:
    folder = data / "rendered/mirrorball"
    item = calibrate(tmp_path / "store", "lights", folder)
    truth = load(folder / "truth" / "meta.yaml", what="the truth").value
    place = np.array([light["position_mm"] for light in item["lights"]])
    right = np.array(truth["leds"]["true_positions_mm_GT"])
    seen = np.array([light["seen"] for light in item["lights"]])
    apart = angle(*((v / np.linalg.norm(v, axis=1, keepdims=True)).T for v in (place, right)))
    assert (~seen).sum() == 2  # the stand's doing
    assert np.median(apart[seen]) < 0.1
    assert apart[seen].max() < 0.3
    assert apart[~seen].max() < 1.5
    assert np.median(np.linalg.norm(place - right, axis=1)[seen]) < 3
    np.testing.assert_allclose(
        [light["drive_position"] for light in item["lights"]], truth["leds"]["ideal_unit_positions"], atol=1e-6
    )
    opened = xarray.open_zarr(item["answer"]["nodes"]["lights"]["path"], chunks=None)
    assert np.linalg.norm(opened.ball_mm.values[0, 0] - truth["ball"]["centre_camera_frame_mm"]) < 0.5


def test_light_directions_from_a_real_chrome_ball(data: Path, tmp_path: Path) -> None:
    """No camera item, no picture under all lights: orthographic, and the mask says where the ball is."""
    item = calibrate(tmp_path / "store", "lights", data / "real/uw_psm/chrome")
    found = np.array([light["direction"] for light in item["lights"]])
    theirs = np.loadtxt(data / "real/uw_psm/lights.txt", skiprows=1)
    theirs /= np.linalg.norm(theirs, axis=1, keepdims=True)
    apart = angle(found.T, theirs.T)
    assert np.median(apart) < 2  # their list is an estimate itself: a plain solve is 1.1 to 3.3 degrees from it,
    assert apart.max() < 9  # and 6.2 and 8.6 for two of the lights (the data's README)


@pytest.mark.parametrize("boards", [("board_q1", "board_q2"), ("board_full1",)])
def test_the_homography_from_rendered_boards(data: Path, tmp_path: Path, boards: tuple[str, ...]) -> None:
    folders = [data / "rendered" / name for name in boards]
    item = calibrate(tmp_path / "store", "homography", *folders)
    truth = load(folders[0] / "truth" / "board.yaml", what="the truth").value
    width, height = truth["image_size_wh"]
    # the truth maps CAM1 to raw CAM0; undoing the mount (180 degrees, mirrored) turns y
    undone = np.array([[1, 0, 0], [0, -1, height - 1], [0, 0, 1.0]]) @ np.array(truth["H_cam1_to_cam0_GT"])
    wanted = np.linalg.inv(undone)
    opened = xarray.open_zarr(item["answer"]["nodes"]["homography"]["path"], chunks=None)
    hull = cv2.convexHull(opened.points.values[0].astype(np.float32))
    y, x = np.mgrid[0:height, 0:width]
    points = np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    a, b = (m @ points for m in (np.array(item["matrix"]), wanted))
    off = np.linalg.norm(a[:2] / a[2] - b[:2] / b[2], axis=0).reshape(y.shape)
    inside = np.zeros(off.shape, np.uint8)
    cv2.fillConvexPoly(inside, np.round(hull).astype(np.int32), 1)
    assert off[inside > 0].mean() < 0.02
    assert off.mean() < 0.1


def test_the_camera_from_real_boards_is_within_opencvs_own_spread(data: Path, tmp_path: Path) -> None:
    from lightstage.kernels.targets.board_corners import find_corners
    from lightstage.kernels.targets.camera_matrix import fit_camera

    pictures = [
        cv2.imread(str(p), cv2.IMREAD_GRAYSCALE) for p in sorted((data / "real/checkerboard_opencv").glob("left*"))
    ]
    corners = [find_corners(picture, inner_corners=(9, 6)).points for picture in pictures]
    ours = fit_camera(corners, square_mm=1.0, shape=pictures[0].shape)
    board = np.zeros((54, 3), np.float32)
    board[:, :2] = np.stack(np.meshgrid(np.arange(9), np.arange(6)), axis=-1).reshape(-1, 2)
    flat = [c.reshape(-1, 1, 2).astype(np.float32) for c in corners]
    found = cv2.calibrateCameraExtended([board] * len(flat), flat, pictures[0].shape[::-1], None, None)
    _, theirs, _, _, _, spread, *_ = found
    assert abs(ours.matrix[0, 0] - theirs[0, 0]) < 3 * float(spread[0, 0])
    assert abs(ours.matrix[1, 1] - theirs[1, 1]) < 3 * float(spread[1, 0])
    assert ours.rms_px < 0.3


def test_changed_lights_cost_the_normals_that_use_them_and_no_others(data: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    run_process("import", data / "rendered/static_sphere", store=store)
    pipeline = tmp_path / "two.yaml"
    pipeline.write_text(
        "stages:\n"
        "  capture:  {uses: capture}\n"
        "  register: {uses: register, from: capture}\n"
        "  split:    {uses: split, from: register}\n"
        "  stack:    {uses: stack, from: split}\n"
        "  align:    {uses: align, from: stack}\n"
        "  plain:    {uses: normals, from: align}\n"
        "  near:     {uses: normals, from: align, params: {correct: near}}\n"
    )

    def computed() -> dict[str, int]:
        done = run_process("run", "--session", "static-sphere", "--pipeline", pipeline, "--json", store=store)
        assert done.returncode == 0, done.stderr
        return {name: node["computed"] for name, node in json.loads(done.stdout)["nodes"].items()}

    assert computed()["near"] == 1
    item = calibrate(tmp_path / "store", "lights", data / "rendered/mirrorball")["answer"]["item"]
    assert run_process("calibration", "use", item, "--session", "static-sphere", store=store).returncode == 0
    assert computed() == {"register": 0, "split": 0, "stack": 0, "align": 0, "plain": 0, "near": 1}


def true_flow(folder: Path, tracking: int, frame: int) -> tuple[np.ndarray, np.ndarray] | None:
    """(xy, y, x) pixels from a tracking frame to a picture, and where the point is seen in both."""
    stored = np.load(folder / "truth" / f"flow_t{tracking:02d}.npz")
    name = f"t{frame:02d}"
    if f"flow_to_{name}" not in stored:
        near = [k for k in ("prevC", "nextC") if f"t_{k}" in stored and int(stored[f"t_{k}"]) == frame]
        if not near:
            return None
        name = near[0]
    return np.moveaxis(stored[f"flow_to_{name}"].astype(np.float32), 2, 0), stored[f"visible_{name}"]


def pose(folder: Path, frame: int) -> tuple[np.ndarray, np.ndarray]:
    stored = np.load(folder / "truth" / f"gt_t{frame:02d}.npz")
    truth = np.moveaxis(stored["normal"].astype(float), 2, 0)
    truth /= np.linalg.norm(truth, axis=0) + 1e-30
    return truth, stored["mask"] & (np.abs(truth).sum(axis=0) > 0)


@pytest.mark.parametrize(("speed", "pixels", "degrees"), [("slow", 0.25, 0.5), ("fast", 0.45, 1.5)])
def test_alignment_of_rendered_performances(
    run: Run, data: Path, speed: str, pixels: float, degrees: float
) -> None:
    """Flows against the rendered ones; normals against those that the true flow gives with the same pictures."""
    from lightstage.kernels.motion.flow_warp import warp
    from lightstage.kernels.pictures.picture_sets import choose

    capture = f"rendered/dynamic_A_{speed}_minimal"
    folder = data / capture
    align = xarray.open_zarr(run(capture, "align"), chunks=None)
    normals = xarray.open_zarr(run(capture, "normals"), chunks=None)
    every = xarray.open_zarr(run(capture, "upsample"), chunks=None)
    radiance = xarray.open_zarr(run(capture, "stack"), chunks=None).radiance.values[:, 0, 0]
    errors, confidences, own = [], [], {}
    for k, tracking in enumerate(align.tracking.values):
        truth, mask = pose(folder, tracking)
        straight = {"C": radiance[tracking]}
        for m, frame in enumerate(align.frame.values[k]):
            known = true_flow(folder, tracking, frame) if frame >= 0 and frame != tracking else None
            if known is None:
                continue
            flow, visible = known
            error = np.hypot(*(align.flow.values[k, m] - flow))
            inside = mask & visible & np.isfinite(error)
            errors.append(error[inside])
            confidences.append(align.confidence.values[k, m][inside])
            straight[str(align.illumination.values[k, m])] = warp(radiance[frame], flow)
        base = choose(list(straight)).base
        r_c = straight[base] + straight[base + "c"]
        right = np.stack(
            [2 * straight[a] - r_c if a in straight else r_c - 2 * straight[a + "c"] for a in "XYZ"]
        ).astype(float)
        right /= np.linalg.norm(right, axis=0) + 1e-30
        found = normals.normal.values[list(normals.tracking.values).index(tracking), 0]
        off, ideal = angle(found, truth), angle(right, truth)
        both = mask & np.isfinite(off) & np.isfinite(right[0]) & np.isfinite(ideal)
        own[int(tracking)] = off[mask & np.isfinite(off)].mean()
        assert off[both].mean() - ideal[both].mean() < degrees, tracking
    error, confidence = np.concatenate(errors), np.concatenate(confidences)
    assert error.mean() < pixels
    if speed == "fast":
        assert (confidence[error > 1] < 0.5).mean() > 0.9
    for i, frame in enumerate(every.frame.values):
        truth, mask = pose(folder, frame)
        off = angle(every.normal.values[i], truth)
        nearest = min(own, key=lambda t: abs(t - int(frame)))
        assert off[mask & np.isfinite(off)].mean() < own[nearest] + 1, frame


def partial(a: np.ndarray, b: np.ndarray, given: np.ndarray) -> float:
    """Correlation of what a line through `given` leaves of a and of b."""
    left = [values - np.polyval(np.polyfit(given, values, 1), given) for values in (a, b)]
    return float(np.corrcoef(*left)[0, 1])


def test_what_is_made_of_the_heads_surface(run: Run, data: Path) -> None:
    capture = "rendered/static_A"
    truth = np.load(data / capture / "truth" / "ground_truth_cam1.npz")
    mask = truth["mask"]
    depth = xarray.open_zarr(run(capture, "shape"), chunks=None).depth_mm.values[0]
    off = (depth - truth["depth_mm"])[mask & np.isfinite(depth)]
    # 1.1 % was measured, 2.6 % with the neck where normals put it, 8 % without shadows and bounced light
    assert np.abs(off - off.mean()).mean() < 0.02 * np.ptp(truth["depth_mm"][mask])

    albedo = xarray.open_zarr(run(capture, "reflectance"), chunks=None).reflectance.values[0]
    true = np.moveaxis(truth["albedo_bands"].astype(float), 2, 0)
    for found, wanted in zip(albedo, true, strict=True):
        known = mask & np.isfinite(found)
        # 1.0 % at most was measured, 2.6 % with bounced light left in
        assert np.median(found[known] / wanted[known]) == pytest.approx(1, abs=0.015)
    plain = xarray.open_zarr(run(capture, "reflectance", "reflectance.shading=none"), chunks=None)
    lights = np.load(data / capture / "truth" / "olat_noisefree_cam1.npz")["D"].astype(float).sum(axis=0)
    shading = lights / np.maximum(truth["albedo_mono"].astype(float), 1e-3)
    inner = cv2.erode(mask.astype(np.uint8), np.ones((5, 5))) > 0
    known = inner & np.isfinite(albedo).all(axis=0)

    def tied(pictures: np.ndarray) -> float:
        return float(np.mean([np.corrcoef(picture[known], shading[known])[0, 1] for picture in pictures]))

    # what should not be in a texture: 0.54 under constant light, 0.26 with it taken out, the true albedo 0.20
    assert tied(albedo) - tied(true) < 0.5 * (tied(plain.reflectance.values[0]) - tied(true))
    assert tied(albedo) < 0.5 * tied(plain.reflectance.values[0]) + 0.02

    maps = xarray.open_zarr(run(capture, "chromophores"), chunks=None)
    melanin, blood = maps.melanin.values[0], maps.haemoglobin.values[0]
    known = mask & np.isfinite(melanin) & np.isfinite(blood)
    true_melanin, true_blood = truth["melanin"].astype(float)[known], truth["haemoglobin"].astype(float)[known]
    assert np.corrcoef(melanin[known], true_melanin)[0, 1] > 0.95
    assert np.corrcoef(blood[known], true_blood)[0, 1] > 0.95
    # each map holds next to nothing of the other pigment
    assert abs(partial(melanin[known], true_blood, true_melanin)) < 0.1
    assert abs(partial(blood[known], true_melanin, true_blood)) < 0.1

    gloss = xarray.open_zarr(run(capture, "gloss"), chunks=None)
    # the coating is GGX of width 0.25 (data notes); 0.253 was measured, and one octave of lights is a tenth
    assert np.nanmedian(gloss.roughness.values[0]) == pytest.approx(0.25, abs=0.02)


def test_the_heads_mesh_has_its_size_and_no_flipped_face(data: Path, tmp_path: Path) -> None:
    folder = data / "rendered" / "static_A"
    done = run_process("shape", folder, "--to", tmp_path, "--json", store=tmp_path / "store")
    assert done.returncode == 0, done.stderr
    (file,) = Answer(0, done.stdout, "").json["files"]
    mesh = trimesh.load_mesh(file, process=False)
    item = load(folder / "calibration" / "camera.yaml", what="an item").value
    truth = np.load(folder / "truth" / "ground_truth_cam1.npz")
    camera = Pinhole.of(item, truth["mask"].shape)
    points = camera.points(truth["depth_mm"].astype(float))[truth["mask"]]
    # depth is good to 2 mm in the mean; the widest points are on the rim, which a mesh reaches to a pixel or two
    np.testing.assert_allclose(mesh.bounds[1] * 1000, points.max(axis=0), atol=8)
    np.testing.assert_allclose(mesh.bounds[0, :2] * 1000, points.min(axis=0)[:2], atol=8)
    middle = mesh.triangles_center
    away = middle - camera.centre / 1000
    assert (np.einsum("fi,fi->f", mesh.face_normals, away) < 0).all()


def test_depth_of_the_sphere(run: Run, data: Path) -> None:
    capture = "rendered/static_sphere"
    truth = np.load(data / capture / "truth" / "ground_truth_cam1.npz")
    depth = xarray.open_zarr(run(capture, "shape"), chunks=None).depth_mm.values[0]
    off = (depth - truth["depth_mm"])[truth["mask"] & np.isfinite(depth)]
    assert np.abs(off - off.mean()).mean() < 0.01 * 100  # 1 % of the radius, mm

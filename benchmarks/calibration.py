"""Calibration against truth: light positions, homography and camera, by the real command; prints tables.

Captures: `rendered/mirrorball`, `rendered/board_*`, `real/uw_psm`, `real/checkerboard_opencv` of the shared data.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import xarray
from numpy.typing import NDArray

from benchmarks.accuracy import DATA, Bench
from lightstage.kernels.targets.board_corners import find_corners
from lightstage.kernels.targets.camera_matrix import fit_camera
from lightstage.store.document import load
from tests.rendered import angle

Array = NDArray[Any]


def item_of(bench: Bench, kind: str, *folders: Path) -> tuple[dict[str, Any], Any]:
    """The item that `calibrate` writes, and its node's result."""
    out = bench.store.parent / f"{kind}.yaml"
    answer = bench.call("calibrate", kind, "--from", *folders, "--out", out)
    path = answer["nodes"][kind]["path"]
    return load(out, what="an item").value, xarray.open_zarr(path, chunks=None)


def unit(vectors: Array) -> Array:
    """(xyz, light) unit vectors of (light, xyz)."""
    return np.asarray((vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).T)


def ball(bench: Bench) -> None:
    """Lights from the rendered ball, and from the real one."""
    folder = DATA / "rendered/mirrorball"
    item, result = item_of(bench, "lights", folder)
    truth = load(folder / "truth" / "meta.yaml", what="the truth").value
    place = np.array([light["position_mm"] for light in item["lights"]])
    right = np.array(truth["leds"]["true_positions_mm_GT"])
    seen = np.array([light["seen"] for light in item["lights"]])
    off = angle(unit(place), unit(right))
    print(f"rendered ball: direction {np.median(off[seen]):.3f} median, {off[seen].max():.3f} worst of {seen.sum()}; "
          f"hidden {', '.join(f'{v:.2f}' for v in off[~seen])} degrees; position "
          f"{np.median(np.linalg.norm(place - right, axis=1)[seen]):.2f} mm median; S_c "
          f"{np.linalg.norm(result.ball_mm.values[0, 0] - truth['ball']['centre_camera_frame_mm']):.2f} mm")  # fmt: skip
    item, _ = item_of(bench, "lights", DATA / "real/uw_psm/chrome")
    theirs = np.loadtxt(DATA / "real/uw_psm/lights.txt", skiprows=1)
    off = angle(unit(np.array([light["direction"] for light in item["lights"]])), unit(theirs))
    print("real chrome ball, degrees to lights.txt:", " ".join(f"{v:.1f}" for v in off))
    session = bench.take_in(DATA / "real/uw_psm/gray")
    for label, words in (("their", []), ("our", ["--calibration", f"lights={bench.store.parent / 'lights.yaml'}"])):
        answer = bench.call("run", "normals", "--session", session, "--set", "normals.fuse=bands", *words)
        normal = xarray.open_zarr(answer["nodes"]["normals"]["path"], chunks=None).normal.values[0, 0]
        y, x = np.mgrid[0 : normal.shape[1], 0 : normal.shape[2]]
        sphere = np.stack([(x - 244.5) / 107.8, -(y - 144.5) / 107.8, np.zeros(x.shape)])
        square = (sphere**2).sum(axis=0)
        sphere[2] = np.sqrt(np.maximum(1 - square, 0))
        error = angle(normal, sphere)[square < 0.95]
        print(
            f"grey ball with {label} lights: {np.nanmean(error):.2f} mean, {np.nanmedian(error):.2f} median degrees"
        )


def boards(bench: Bench) -> None:
    """Homographies from the rendered boards, and the camera from real ones."""
    for names in (("board_q1", "board_q2"), ("board_full1",)):
        folders = [DATA / "rendered" / name for name in names]
        item, result = item_of(bench, "homography", *folders)
        truth = load(folders[0] / "truth" / "board.yaml", what="the truth").value
        width, height = truth["image_size_wh"]
        undone = np.array([[1, 0, 0], [0, -1, height - 1], [0, 0, 1.0]]) @ np.array(truth["H_cam1_to_cam0_GT"])
        y, x = np.mgrid[0:height, 0:width]
        points = np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
        a, b = (m @ points for m in (np.array(item["matrix"]), np.linalg.inv(undone)))
        off = np.linalg.norm(a[:2] / a[2] - b[:2] / b[2], axis=0).reshape(y.shape)
        inside = np.zeros(off.shape, np.uint8)
        hull = cv2.convexHull(result.points.values[0].astype(np.float32))
        cv2.fillConvexPoly(inside, np.round(hull).astype(np.int32), 1)
        print(f"{' and '.join(names)}: transfer error {off[inside > 0].mean():.4f} px in the boards' hull, "
              f"{off.mean():.4f} px over the picture; Sampson {float(result.sampson_px.values[0]):.5f} px, geometric "
              f"{float(result.geometric_px.values[0]):.5f} px")  # fmt: skip
    for side in ("left", "right"):
        paths = sorted((DATA / "real/checkerboard_opencv").glob(f"{side}*"))
        pictures = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in paths]
        corners = [find_corners(picture, inner_corners=(9, 6)).points for picture in pictures]
        ours = fit_camera(corners, square_mm=1.0, shape=pictures[0].shape[:2])
        print(f"{side} camera, {len(pictures)} real boards: {ours.sentence}")


def main() -> None:
    """Measure and print."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder) / "store")
        ball(bench)
        boards(bench)


if __name__ == "__main__":
    main()

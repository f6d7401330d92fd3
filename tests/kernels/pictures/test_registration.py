"""Registration: dark and flat in sensor orientation, mount and homography in one resampling."""

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from lightstage.kernels.encodings import SIGNAL_STEP
from lightstage.kernels.errors import KernelError
from lightstage.kernels.pictures.registration import prepare, register
from lightstage.kernels.pictures.resampling import reorient, undone_shape, warp

PLAIN = {"rotate": 0, "mirror": False}


def item(pictures: dict[str, NDArray[Any]], **more: Any) -> dict[str, Any]:
    class Picture:
        def __init__(self, pixels: NDArray[Any]) -> None:
            self.load = lambda: pixels

    return {"pictures": {name: Picture(p) for name, p in pictures.items()}, "scale": 1.0, **more}


def prepared(shape: tuple[int, int], **change: Any) -> dict[str, Any]:
    context: dict[str, Any] = {
        "cameras": ["CAM0", "CAM1"],
        "reference": "CAM1",
        "mounts": {"CAM0": PLAIN, "CAM1": PLAIN},
        "shape": list(shape),
        "white_level": 1023,
        "dark": None,
        "flat": None,
        "homography": np.eye(3).tolist(),
        "flat_smoothing_percent": 2.0,
    }
    return dict(prepare(**{**context, **change}))


def texture(y: NDArray[Any], x: NDArray[Any]) -> NDArray[Any]:
    """Smooth at the scale of a pixel (shortest wave 9 px), so that truth between pixels is known."""
    return 500 + 120 * np.sin(0.5 * x + 0.1 * y) + 90 * np.cos(0.45 * y - 0.2 * x) + 60 * np.sin(0.7 * x - 0.3 * y)


def test_closed_form_of_dark_and_flat() -> None:
    """(raw - dark) F / (flat - dark), by hand: the flat's smoothed maximum is its value, being constant."""
    raw = np.array([[[110, 210], [310, 410]]] * 2, np.uint16)
    dark = {"CAM0": np.full((2, 2), 10, np.uint16), "CAM1": np.full((2, 2), 10, np.uint16)}
    flat = {"CAM0": np.full((2, 2), 90, np.uint16), "CAM1": np.full((2, 2), 170, np.uint16)}
    ready = prepared(
        (2, 2), dark=item(dark), flat=item(flat, dark_included=True), cameras=["CAM1"], homography=None
    )
    out = register(raw[:1], **ready)
    np.testing.assert_allclose(out["signal"][0], [[100, 200], [300, 400]], rtol=1e-6)
    ready = prepared((2, 2), dark=item(dark), flat=item(flat, dark_included=True))
    # CAM0 responds half as strongly, and F = 160 is the reference camera's for both
    np.testing.assert_allclose(ready["views"][0].gain, 2.0, rtol=1e-6)
    np.testing.assert_allclose(ready["views"][1].gain, 1.0, rtol=1e-6)


@pytest.mark.parametrize("rotate", [0, 90, 180, 270])
@pytest.mark.parametrize("mirror", [False, True])
def test_undoing_a_mount_is_rotating_clockwise_then_mirroring(rotate: int, mirror: bool) -> None:
    picture = np.arange(12, dtype=np.float32).reshape(3, 4)
    turns = {90: cv2.ROTATE_90_CLOCKWISE, 180: cv2.ROTATE_180, 270: cv2.ROTATE_90_COUNTERCLOCKWISE}
    turned = cv2.rotate(picture, turns[rotate]) if rotate else picture
    expected = turned[:, ::-1] if mirror else turned
    np.testing.assert_array_equal(reorient(picture, rotate, mirror), expected)
    assert undone_shape(rotate, picture.shape) == expected.shape


def test_one_resampling_of_mount_and_homography_finds_the_truth() -> None:
    """CAM0 is rendered analytically on its own raw grid. Keys' kernel is third order: for waves of 9 px and more
    its error is below 0.5 % of their amplitude (measured 0.3 %), where one pixel's shift changes 60 %."""
    rows, columns = 90, 110
    y, x = np.mgrid[0:rows, 0:columns].astype(float)
    h = np.array([[1.002, 0.004, -2.3], [-0.003, 0.998, 1.4], [1e-5, -2e-5, 1]])
    undone_x, undone_y = x, rows - 1 - y  # rotate 180, then mirror: upside down
    w = h[2, 0] * undone_x + h[2, 1] * undone_y + 1
    cross_x = (h[0, 0] * undone_x + h[0, 1] * undone_y + h[0, 2]) / w
    cross_y = (h[1, 0] * undone_x + h[1, 1] * undone_y + h[1, 2]) / w
    raw = np.stack([np.round(texture(cross_y, cross_x) * 16), np.round(texture(y, x) * 16)]).astype(np.uint16)
    ready = prepared(
        (rows, columns),
        mounts={"CAM0": {"rotate": 180, "mirror": True}, "CAM1": PLAIN},
        homography=h.tolist(),
        white_level=65535,
    )
    out = register(raw, **ready)
    error = (out["signal"][0] - out["signal"][1])[out["valid"]] / 16
    assert np.sqrt(np.mean(error**2)) < 0.005 * 120
    assert out["valid"].mean() > 0.9
    # nothing is invented beyond the picture
    edge = ~out["valid"]
    assert np.isnan(out["signal"][0][edge]).all()
    assert np.isfinite(out["signal"][1]).all()


def test_a_saturated_pixel_spoils_what_is_interpolated_from_it_and_no_more() -> None:
    raw = np.full((2, 20, 20), 100, np.uint16)
    raw[0, 10, 10] = 1023
    ready = prepared((20, 20), homography=[[1, 0, 0.5], [0, 1, 0], [0, 0, 1]])
    out = register(raw, **ready)
    inside = np.s_[3:17, 3:17]
    bad = np.argwhere(np.isnan(out["signal"][0][inside])) + 3
    # at (x, y) the 4 x 4 neighbours are x - 2 .. x + 1 (half a pixel to the left) and y - 1 .. y + 2
    assert {tuple(p) for p in bad} == {(y, x) for y in range(8, 12) for x in range(9, 13)}
    assert np.isfinite(out["signal"][1]).all()
    assert not out["valid"][10, 10]


def test_inputs_are_not_written_to() -> None:
    raw = np.full((2, 8, 8), 100, np.uint16)
    raw.flags.writeable = False
    register(raw, **prepared((8, 8)))
    assert (raw == 100).all()


def test_identity_keeps_values_to_the_bit() -> None:
    raw = np.random.default_rng(0).integers(0, 1000, (2, 12, 12)).astype(np.uint16)
    out = register(raw, **prepared((12, 12)))
    np.testing.assert_array_equal(out["signal"][0][1:9, 1:9], raw[0, 1:9, 1:9])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"flat": item({"CAM0": np.zeros((6, 8)), "CAM1": np.ones((6, 8))}, dark_included=False)},
            r"the flat of CAM0 is not above its dark at 48 pixel\(s\), the first at x=0, y=0",
        ),
        (
            {"dark": item({"CAM0": np.zeros((5, 8)), "CAM1": np.zeros((6, 8))})},
            "the dark of CAM0 is 8 x 5; the pictures are 8 x 6",
        ),
        (
            {"homography": [[1, 0, 900], [0, 1, 0], [0, 0, 1]]},
            "the homography puts CAM0 out of view: it covers 0%",
        ),
    ],
)
def test_bad_calibration_is_a_named_error(change: dict[str, Any], message: str) -> None:
    with pytest.raises(KernelError, match=message):
        prepared((6, 8), **change)


@pytest.mark.parametrize("turn", [0.0, 0.4, 1.5])
def test_runs_of_neighbours_equal_pixel_by_pixel(turn: float) -> None:
    """Keys' sixteen weights written out per pixel, for maps with long runs and with none."""
    rows, columns = 30, 40
    image = np.random.default_rng(0).uniform(0, 900, (rows, columns)).astype(np.float32)
    c, s = np.cos(turn), np.sin(turn)
    h = np.array([[c, -s, 7.3], [s, c, 1.9], [1e-4, -2e-4, 1]])
    found = warp(image, h, rows, columns)

    def weights(t: float) -> list[float]:
        distances = [1 + t, t, 1 - t, 2 - t]
        return [1.5 * d**3 - 2.5 * d**2 + 1 if d <= 1 else -0.5 * d**3 + 2.5 * d**2 - 4 * d + 2 for d in distances]

    for y in range(rows):
        for x in range(columns):
            u, v, w = h @ (x, y, 1)
            sx, sy = u / w, v / w
            if w > 0 and 1 <= sx < columns - 2 and 1 <= sy < rows - 2:
                ix, iy = int(sx), int(sy)
                window = image[iy - 1 : iy + 3, ix - 1 : ix + 3]
                value = np.array(weights(sy - iy)) @ window @ np.array(weights(sx - ix))
                assert found[y, x] == pytest.approx(value, abs=SIGNAL_STEP)
            else:
                assert np.isnan(found[y, x])


def test_a_warp_behind_the_camera_is_not_valid() -> None:
    out = warp(np.ones((8, 8), np.float32), np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, -1]]), 8, 8)
    assert np.isnan(out).all()

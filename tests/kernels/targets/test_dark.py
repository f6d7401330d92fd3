"""Dark frames whose every count is known."""

import numpy as np
import pytest

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.dark import dark, item, verdict

FRAMES = {(i, 0.0): np.full((12, 16), 16 + i, np.uint16) for i in range(3)}


def test_mean_noise_and_a_hot_pixel() -> None:
    frames = {name: frame.copy() for name, frame in FRAMES.items()}
    for frame in frames.values():
        frame[5, 7] += 40
        frame.flags.writeable = False
    measured = dark(frames, white_level=1023)
    assert measured["mean"][0, 0] == 17
    assert measured["mean"][5, 7] == 57
    np.testing.assert_allclose(measured["noise"], 1)  # 16, 17, 18: variance 1
    assert np.argwhere(measured["hot"]).tolist() == [[5, 7]]


def test_frames_with_light_are_refused() -> None:
    with pytest.raises(KernelError, match="300 of 1023 counts"):
        dark({(0, 0.0): np.full((12, 16), 300, np.uint16)}, white_level=1023)


def test_the_item_and_what_is_said_of_it() -> None:
    one = dark(FRAMES, white_level=1023)
    arrays = {name: np.stack([np.asarray(values)]) for name, values in one.items()}
    about = {
        "labels": {"polarisation": ["cross"]},
        "attrs": {"frames": 3},
        "facts": {"cameras": {"cross": "CAM1"}},
    }
    content = item(arrays=arrays, **about)
    assert content["images"]["CAM1"][0, 0] == 17 * content["scale"]
    assert content["hot_px"] == {"CAM1": []}
    assert "exposure_s" not in content
    ((severity, sentence),) = verdict(arrays=arrays, **about)
    assert severity == "good"
    assert sentence.startswith("CAM1: dark 17.00 counts, noise 1.00 counts, 0 hot pixels")

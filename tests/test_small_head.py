"""README's figures of accuracy, on the small capture that the repository carries.

`tests/data/small_head` is a head of the virtual rig, 112 x 84 pixels, three bands, both cameras, 10 bits with
noise, made once by `lightstage demo --session small-head --size 112x84 --bands 445,576,655 --seed 8`. So small a
head is harder than a large one: a pixel is 3 mm wide. Pictures and noise are fixed, and results are equal to
rounding on all processors, so what these figures may move by is what a change of methods does; each limit is 3 %
above what was measured.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

from lightstage.store.grid import open_dataset
from tests.conftest import REPOSITORY, run_process

pytestmark = pytest.mark.slow

CAPTURE = REPOSITORY / "tests" / "data" / "small_head"
Open = Callable[[str], xr.Dataset]


@pytest.fixture(scope="module")
def truth() -> dict[str, NDArray[np.float32]]:
    with np.load(CAPTURE / "truth" / "ground_truth_cam1.npz") as file:
        return dict(file)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Open:
    store = tmp_path_factory.mktemp("small") / "store"
    assert run_process("import", CAPTURE, store=store).returncode == 0
    done = run_process("run", "--session", "small-head", "normals", "reflectance", "shape", store=store)
    assert done.returncode == 0, done.stderr

    def opened(node: str) -> xr.Dataset:
        return open_dataset(Path(run_process("path", node, "--session", "small-head", store=store).stdout.strip()))

    return opened


def mean_degrees(result: xr.Dataset, truth: dict[str, NDArray[np.float32]]) -> float:
    """Mean angle between the first band's normals and the true ones, where both are."""
    normal = result["normal"].values[0, 0]
    cosine = np.einsum("iyx,yxi->yx", normal, truth["normal"]) / np.linalg.norm(normal, axis=0)
    known = truth["mask"] & result["valid"].values[0, 0]
    assert known.mean() > 0.25
    return float(np.degrees(np.arccos(np.clip(cosine[known], -1, 1))).mean())


def test_normals_by_default(result: Open, truth: dict[str, NDArray[np.float32]]) -> None:
    """5.80 degrees: near light and shadows are not modelled."""
    assert mean_degrees(result("normals"), truth) < 5.98


def test_normals_with_the_rig_modelled(result: Open, truth: dict[str, NDArray[np.float32]]) -> None:
    """3.51 degrees with near light, shadows and bounced light modelled."""
    assert mean_degrees(result("relief"), truth) < 3.62


def test_depth(result: Open, truth: dict[str, NDArray[np.float32]]) -> None:
    """0.95 % of its range of 121 mm; its mean distance, which the norm tells to some per cent, is left out."""
    depth = result("shape")["depth_mm"].values[0]
    known = truth["mask"] & np.isfinite(depth)
    error = (depth - truth["depth_mm"])[known]
    off = np.abs(error - np.median(error)).mean()
    assert off / np.ptp(truth["depth_mm"][known]) < 0.0098


def test_reflectance(result: Open, truth: dict[str, NDArray[np.float32]]) -> None:
    """1.1 to 1.4 % below the true albedo in the median of each band, 1.5 % off in the median of all pixels."""
    found = result("reflectance")["reflectance"].values[0]
    for band, albedo in enumerate(np.moveaxis(truth["albedo_bands"], 2, 0)):
        known = truth["mask"] & np.isfinite(found[band])
        ratio = found[band][known] / albedo[known]
        assert abs(np.median(ratio) - 1) < 0.0145
        assert np.median(np.abs(ratio - 1)) < 0.0155

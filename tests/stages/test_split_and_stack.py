"""The two arithmetic stages."""

import numpy as np
import pytest

from lightstage.dag.stage import Grid, StageError
from lightstage.kernels.pictures.components import split
from lightstage.kernels.pictures.radiance import stack
from lightstage.stages.split import STAGE as SPLIT
from lightstage.stages.split import components
from lightstage.stages.stack import STAGE as STACK

NAN = np.nan


def test_split_by_hand() -> None:
    signal = np.array([[[50, 10], [7, NAN]], [[20, 12], [NAN, 5]]], np.float32)
    out = split(signal, polarisations=("parallel", "cross"))
    np.testing.assert_array_equal(out["signal"][0], np.array([[40, 24], [NAN, 10]], np.float32))
    np.testing.assert_array_equal(out["signal"][1], np.array([[30, -2], [NAN, NAN]], np.float32))
    assert out["stats"]["negative_specular_fraction"] == 0.25  # noise is kept, and counted


@pytest.mark.parametrize(
    ("polarisations", "made"),
    [
        (("parallel", "cross"), ("diffuse", "specular")),
        (("cross",), ("diffuse",)),
        (("parallel",), ("total",)),
        (("unpolarised",), ("total",)),
    ],
)
def test_what_can_be_made(polarisations: tuple[str, ...], made: tuple[str, ...]) -> None:
    assert components(polarisations) == made
    signal = np.ones((len(polarisations), 2, 2), np.float32)
    out = split(signal, polarisations=polarisations)["signal"]
    assert out.shape == (len(made), 2, 2)
    if made == ("diffuse",):
        assert (out == 2).all()


def test_what_cannot_be_made_is_said() -> None:
    grid = Grid({"frame": 1, "band": 1, "polarisation": 1, "y": 2, "x": 2}, {"illumination": (("frame",), ["C"])})
    arrangement = SPLIT.arrange([grid], {"polarisation": ["cross"]}, SPLIT.params())
    assert arrangement.grid.attrs["cannot_be_made"] == "specular: needs the parallel camera"


def test_stack_scales_and_averages_what_is_valid() -> None:
    pictures = [np.array([[[2.0, 4.0, NAN]]], np.float32), np.array([[[4.0, NAN, NAN]]], np.float32)]
    out = stack(dict(enumerate(pictures)), counts_per_radiance=2.0)["radiance"]
    np.testing.assert_array_equal(out, np.array([[[1.5, 2.0, NAN]]], np.float32))
    np.testing.assert_array_equal(stack({0: pictures[0]}, counts_per_radiance=2.0)["radiance"][0, 0], [1, 2, NAN])


def grid_of(illumination: list[str], bands: list[float]) -> Grid:
    return Grid(
        {"frame": len(illumination), "band": len(bands), "component": 1, "y": 2, "x": 2},
        {
            "illumination": (("frame",), illumination),
            "time_s": (("frame",), [0.0] * len(illumination)),
            "band": (("band",), bands),
            "component": (("component",), ["diffuse"]),
        },
    )


def test_a_static_capture_is_by_illumination_and_a_performance_by_frame() -> None:
    grid = grid_of(["C", "X", "C"], [434.0, 576.0])
    static = STACK.arrange([grid], {"frame_rate_hz": None}, STACK.params())
    assert static.grid.sizes["illumination"] == 2
    assert list(static.grid.along("illumination")) == ["C", "X"]
    assert static.groups[1].reads["signal"] == {0: {"frame": 0, "band": 1}, 2: {"frame": 2, "band": 1}}
    moving = STACK.arrange([grid], {"frame_rate_hz": 60.0}, STACK.params())
    assert moving.grid.sizes["frame"] == 3
    assert moving.dims == {"illumination|frame": "frame"}


def test_bands_and_intensities_divide_out() -> None:
    assert STACK.context is not None
    facts = {"intensities": {"L00": [1.0, 4.0]}, "bands_nm": [434.0, 576.0]}
    bands = {"bands": [{"centre_nm": 576.0, "exposure": 10.0, "transmission": 0.5, "source": 2.0}]}
    labels = {"illumination": "L00", "band": 576.0}
    assert STACK.context(labels, facts, {"bands": bands}, STACK.params()) == {"counts_per_radiance": 40.0}
    assert STACK.context({**labels, "illumination": "C"}, facts, {}, STACK.params()) == {"counts_per_radiance": 1.0}
    with pytest.raises(StageError, match=r"no band at 434 nm \(it has 576\)"):
        STACK.context({**labels, "band": 434.0}, facts, {"bands": bands}, STACK.params())

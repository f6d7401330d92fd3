"""Diffuse and specular light out of two polarisations, which were made of them by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.kernels.pictures.components import split

NAN = np.nan


def test_by_hand() -> None:
    signal = np.array([[[50, 10], [7, NAN]], [[20, 12], [NAN, 5]]], np.float32)
    signal.flags.writeable = False
    out = split(signal, polarisations=("parallel", "cross"))
    np.testing.assert_array_equal(out["signal"][0], np.array([[40, 24], [NAN, 10]], np.float32))
    np.testing.assert_array_equal(out["signal"][1], np.array([[30, -2], [NAN, NAN]], np.float32))
    assert out["signal"].dtype == np.float32
    assert out["stats"]["negative_specular_fraction"] == 0.25  # noise is kept, and counted


@given(st.lists(st.tuples(st.integers(0, 500), st.integers(0, 500)), min_size=1, max_size=6), st.booleans())
def test_what_the_polarisers_mix_is_unmixed(pixels: list[tuple[int, int]], crossed_first: bool) -> None:
    """I_parallel = I_D / 2 + I_S, I_cross = I_D / 2; whole numbers, so to the bit. Either camera may come first."""
    diffuse, specular = (np.array(values, np.float32)[None] for values in zip(*pixels, strict=True))
    cameras = {"parallel": diffuse / 2 + specular, "cross": diffuse / 2}
    order = ("cross", "parallel") if crossed_first else ("parallel", "cross")
    out = split(np.stack([cameras[name] for name in order]), polarisations=order)["signal"]
    np.testing.assert_array_equal(out, np.stack([diffuse, specular]))


@pytest.mark.parametrize(("polarisation", "factor"), [("cross", 2), ("parallel", 1), ("unpolarised", 1)])
def test_one_camera_gives_what_it_can(polarisation: str, factor: int) -> None:
    """Twice the crossed picture is the diffuse component; anything else is the total as it is."""
    signal = np.array([[[3, NAN], [0, -1]]], np.float32)
    out = split(signal, polarisations=(polarisation,))
    np.testing.assert_array_equal(out["signal"], factor * signal)
    assert "stats" not in out

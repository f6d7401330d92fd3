"""What stored steps promise, measured with NumPy and xarray alone."""

import numpy as np
import xarray
from hypothesis import given
from hypothesis import strategies as st

from lightstage.kernels import encodings


def test_a_stored_normal_is_off_by_less_than_a_five_hundredth_of_a_degree() -> None:
    normals = np.random.default_rng(0).standard_normal((100_000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    stored = np.round(normals * encodings.NORMAL_STEPS).astype(np.int16)
    read = stored * encodings.NORMAL_ATTRS["scale_factor"]
    angle = np.degrees(2 * np.arcsin(np.linalg.norm(read - normals, axis=1) / 2))  # fine near zero
    assert 0.0005 < angle.max() < 0.002


def test_xarray_reads_unit_vectors_and_nan() -> None:
    raw = np.array([encodings.NORMAL_STEPS, -encodings.NORMAL_STEPS, 0, encodings.NORMAL_FILL], np.int16)
    stored = xarray.Dataset({"normal": ("xyz", raw, dict(encodings.NORMAL_ATTRS))})
    np.testing.assert_allclose(xarray.decode_cf(stored).normal.values, [1, -1, 0, np.nan])


def test_no_step_of_a_component_is_the_fill() -> None:
    assert encodings.NORMAL_FILL < -encodings.NORMAL_STEPS
    assert np.iinfo(np.int16).min <= encodings.NORMAL_FILL


def test_visibility_and_edges_fit_a_byte() -> None:
    assert np.iinfo(np.uint8).max == encodings.VISIBILITY_STEPS
    bits = (encodings.EDGE_RIGHT, encodings.EDGE_BELOW)
    assert all(bit.bit_count() == 1 for bit in bits)
    assert sum(bits) == bits[0] | bits[1] <= 255


@given(st.integers(0, 2**32 - 1))
def test_rounding_a_signal_adds_next_to_no_variance(seed: int) -> None:
    """A step's square over 12, where noise is a count and more."""
    assert encodings.SIGNAL_STEP**2 / 12 < 2e-6
    counts = np.random.default_rng(seed).normal(200, 1, 4000)
    rounded = np.round(counts / encodings.SIGNAL_STEP) * encodings.SIGNAL_STEP
    assert 1.1e-6 < np.mean((rounded - counts) ** 2) < 1.45e-6  # 4,000 samples know it to 1.4 %


def test_a_step_of_radiance_is_as_fine_as_a_step_of_256_counts() -> None:
    assert 256 * 2.0**-encodings.RADIANCE_BITS == encodings.SIGNAL_STEP

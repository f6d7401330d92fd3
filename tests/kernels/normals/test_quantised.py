"""Stored normals: worked by hand, there and back, and read by xarray."""

import numpy as np
import pytest
import xarray

from lightstage.kernels.encodings import NORMAL_ATTRS, NORMAL_STEPS
from lightstage.kernels.normals import quantised


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_by_hand(dtype: type) -> None:
    normal = np.array([[[0.6, 0]], [[0, 0]], [[0.8, np.nan]]], dtype)  # (xyz, 1, 2)
    stored = quantised.encode(normal)
    assert stored.dtype == np.int16
    assert stored[:, 0, 0].tolist() == [19660, 0, 26214]  # 0.6 and 0.8 x 32767, to the nearest
    assert stored[:, 0, 1].tolist() == [-32768] * 3  # one component is not known: none is


def test_there_and_back_within_a_two_hundredth_of_a_degree() -> None:
    normal = np.random.default_rng(0).normal(size=(3, 50, 40))
    normal /= np.linalg.norm(normal, axis=0)
    back = quantised.decode(quantised.encode(normal))
    across = np.linalg.norm(np.cross(normal, back, axis=0), axis=0)
    assert np.degrees(np.arcsin(across)).max() < 0.005
    np.testing.assert_array_equal(quantised.encode(back), quantised.encode(normal))


def test_what_is_not_valid_is_nan_again() -> None:
    normal = np.zeros((3, 2, 2), np.float32)
    normal[2] = 1
    valid = np.array([[True, False], [True, True]])
    before = normal.copy()
    stored = quantised.encode(normal, valid)
    np.testing.assert_array_equal(normal, before)
    np.testing.assert_array_equal(np.isnan(quantised.decode(stored)), np.broadcast_to(~valid, (3, 2, 2)))


def test_a_view_with_other_strides_is_stored_in_one_piece() -> None:
    stored = quantised.encode(np.moveaxis(np.full((4, 5, 3), 0.5), 2, 0))
    assert stored.shape == (3, 4, 5)
    assert stored.flags.c_contiguous


def test_xarray_reads_unit_vectors() -> None:
    normal = np.array([[[0.0, np.nan]], [[0.6, np.nan]], [[0.8, np.nan]]])
    raw = xarray.Dataset({"normal": (("xyz", "y", "x"), quantised.encode(normal), dict(NORMAL_ATTRS))})
    np.testing.assert_allclose(xarray.decode_cf(raw).normal.values, normal, atol=1 / NORMAL_STEPS)

"""Importing: whole or not at all, repeatable, and exactly what changed."""

import os
import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest
import xarray

from lightstage.store.errors import RequestError
from lightstage.store.importer import import_capture
from lightstage.store.root import Store
from lightstage.store.sessions import read_session, remove_session, session_names
from tests.scenes import STATIC


def opened(store: Store, name: str) -> xarray.Dataset:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return xarray.open_zarr(store.sessions / name / "raw.zarr", chunks=None)


def test_raw_opens_with_plain_xarray(sphere: Path, store: Store) -> None:
    done = import_capture(sphere, store)
    raw = opened(store, "ball")
    assert raw.raw.dims == ("frame", "band", "polarisation", "y", "x")
    assert raw.raw.dtype == np.uint16
    assert raw.raw.encoding["chunks"] == (1, 1, 1, 48, 48)
    assert list(raw.illumination.values) == list(STATIC)
    assert list(raw.polarisation.values) == ["parallel", "cross"]
    assert raw.band.values.tolist() == [576.0]
    picture = cv2.imread(str(sphere / "0003_Z_576nm_CAM1.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(raw.raw.sel(polarisation="cross").values[3, 0], picture)
    assert done.new


def test_an_interrupted_switch_is_repaired(sphere: Path, store: Store) -> None:
    """A kill between session.json and the link leaves the link on the older pictures; the next import mends it."""
    import_capture(sphere, store)
    link = store.sessions / "ball" / "raw.zarr"
    old = os.readlink(link)
    path = sphere / "0000_C_576nm_CAM1.png"
    cv2.imwrite(str(path), np.zeros((48, 48), np.uint16))
    import_capture(sphere, store)
    new = os.readlink(link)
    assert old != new
    link.unlink()
    os.symlink(old, link)
    import_capture(sphere, store)
    assert os.readlink(link) == new


def test_a_removed_session_is_gone_with_its_results(sphere: Path, store: Store) -> None:
    import_capture(sphere, store)
    remove_session("ball", store)
    assert session_names(store) == []
    with pytest.raises(RequestError, match="no session 'ball'"):
        read_session("ball", store)

"""Importing: whole or not at all, repeatable, and exactly what changed."""

import os
import shutil
import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest
import xarray
import yaml

from lightstage.store.errors import RequestError
from lightstage.store.importer import import_capture
from lightstage.store.items import get_item
from lightstage.store.root import Store
from lightstage.store.sessions import read_session, remove_session, session_names
from tests.scenes import STATIC, one_camera_capture


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


def test_importing_again_changes_nothing(sphere: Path, store: Store) -> None:
    import_capture(sphere, store)
    before = {p: p.stat().st_mtime_ns for p in store.root.rglob("*") if p.is_file() and "tmp" not in p.parts}
    again = import_capture(sphere, store)
    after = {p: p.stat().st_mtime_ns for p in store.root.rglob("*") if p.is_file() and "tmp" not in p.parts}
    assert again.changes == ()
    # the item files carry notes and are written anew; nothing else is touched
    touched = {p for p in after if before.get(p) != after[p]}
    assert {p.parent.parent.name for p in touched} <= {"calibration"}


def test_a_moved_archive_is_the_same_session(sphere: Path, store: Store, tmp_path: Path) -> None:
    import_capture(sphere, store)
    moved = shutil.copytree(sphere, tmp_path / "elsewhere")
    again = import_capture(moved, store)
    assert again.changes == ()
    assert read_session("ball", store).source["folder"] == str(moved)


def test_one_changed_picture_is_updated_and_named(sphere: Path, store: Store) -> None:
    first = import_capture(sphere, store).session
    path = sphere / "0004_Xc_576nm_CAM0.png"
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    picture[0, 0] += 1
    cv2.imwrite(str(path), picture)
    again = import_capture(sphere, store)
    assert again.changes == ("picture 0004_Xc_576nm_CAM0.png changed",)
    different = [
        (f, b, p)
        for f, frame in enumerate(again.session.images)
        for b, band in enumerate(frame)
        for p, ref in enumerate(band)
        if ref != first.images[f][b][p]
    ]
    assert different == [(4, 0, 0)]
    assert opened(store, "ball").raw.values[4, 0, 0, 0, 0] == picture[0, 0]


def test_a_picture_saved_anew_with_equal_pixels_is_no_change(sphere: Path, store: Store) -> None:
    import_capture(sphere, store)
    path = sphere / "0004_Xc_576nm_CAM0.png"
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(path), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    assert import_capture(sphere, store).changes == ()


def test_an_item_with_the_same_numbers_is_no_change_and_another_is_named(sphere: Path, store: Store) -> None:
    import_capture(sphere, store)
    path = sphere / "calibration" / "homography.yaml"
    path.write_text(
        "# the same numbers\nitem: homography\nfrom: CAM0\nto: CAM1\n"
        "matrix:\n- [1.0, 0, -1.00]\n- [0, 1, 0]\n- [0, 0, 1]\n"
    )
    assert import_capture(sphere, store).changes == ()
    path.write_text(path.read_text().replace("-1.00", "-1.25"))
    again = import_capture(sphere, store)
    assert again.changes == ("calibration item homography changed",)
    item = get_item("homography", again.session.items["homography"], store)
    assert item.values["matrix"][0][2] == -1.25


def test_wrong_items_are_refused_before_the_session_appears(sphere: Path, store: Store) -> None:
    path = sphere / "calibration" / "homography.yaml"
    path.write_text("item: homography\nfrom: CAM0\nto: CAM1\nmatrix: [[1, 0, 0], [0, .nan, 0], [0, 0]]\n")
    (sphere / "calibration" / "dark.yaml").write_text("item: dark\nimages: {CAM0: no.png}\n")
    with pytest.raises(RequestError) as caught:
        import_capture(sphere, store)
    text = str(caught.value)
    assert "homography.yaml:4" in text
    assert "no.png is missing" in text
    assert session_names(store) == []


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


def test_a_damaged_raw_picture_is_restored_by_importing_again(sphere: Path, store: Store) -> None:
    session = import_capture(sphere, store).session
    ref = session.images[2][0][1]
    path = store.chunks.path(ref.blob)
    good = path.read_bytes()
    path.write_bytes(good[:-1] + bytes([good[-1] ^ 1]))
    again = import_capture(sphere, store)
    assert again.changes == ("1 damaged or lost picture(s) were restored",)
    assert store.chunks.get(ref, dtype="<u2", shape=session.shape) is not None
    picture = cv2.imread(str(sphere / "0002_Y_576nm_CAM1.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(opened(store, "ball").raw.values[2, 0, 1], picture)


def test_the_verdict_sees_saturation_darkness_and_motion(tmp_path: Path, store: Store) -> None:
    folder = one_camera_capture(tmp_path / "c", ["C", "X", "Xc", "O"], shape=(20, 20))
    base = np.full((20, 20), 400, np.uint16)
    for name, value in (("0000_C", 800), ("0001_X", 300), ("0002_Xc", 300), ("0003_O", 0)):
        picture = np.full_like(base, value)
        if name == "0000_C":
            picture[0, :4] = 1023
        cv2.imwrite(str(folder / f"{name}_0nm_CAM1.png"), picture)
    rows = {row["illumination"]: row for row in import_capture(folder, store).session.verdict}
    assert rows["C"]["saturated"] == pytest.approx(4 / 400)
    assert rows["O"]["underexposed"] == 1
    assert rows["X"]["complement_residual"] == pytest.approx(200 / 800)


def test_a_removed_session_is_gone_with_its_results(sphere: Path, store: Store) -> None:
    import_capture(sphere, store)
    remove_session("ball", store)
    assert session_names(store) == []
    with pytest.raises(RequestError, match="no session 'ball'"):
        read_session("ball", store)


def test_another_name_can_be_given(sphere: Path, store: Store) -> None:
    assert import_capture(sphere, store, name="other").session.name == "other"
    with pytest.raises(RequestError, match="a name has up to 100 letters"):
        import_capture(sphere, store, name="../x")


def test_items_of_unknown_kind_are_passed_over_with_a_word(sphere: Path, store: Store) -> None:
    (sphere / "calibration" / "turntable.yaml").write_text(yaml.safe_dump({"item": "turntable", "angle": 3}))
    done = import_capture(sphere, store)
    assert any("turntable" in warning for warning in done.warnings)

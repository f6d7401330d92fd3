"""Importing: whole or not at all, repeatable, and exactly what changed."""

import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import xarray
import yaml
from numpy.typing import NDArray

from lightstage.store.errors import RequestError
from lightstage.store.importer import import_capture
from lightstage.store.items import get_item
from lightstage.store.root import Store
from lightstage.store.sessions import bind_item, read_session, session_names
from tests.scenes import one_camera_capture


def shown_pictures(store: Store) -> NDArray[Any]:
    """What whoever opens the session `ball` sees."""
    with xarray.open_zarr(store.sessions / "ball" / "raw.zarr", chunks=None) as opened:
        return np.asarray(opened.raw.values)


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
    assert shown_pictures(store)[4, 0, 0, 0, 0] == picture[0, 0]


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
    np.testing.assert_array_equal(shown_pictures(store)[2, 0, 1], picture)


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


def test_another_name_can_be_given(sphere: Path, store: Store) -> None:
    assert import_capture(sphere, store, name="other").session.name == "other"
    with pytest.raises(RequestError, match="a name has up to 100 letters"):
        import_capture(sphere, store, name="../x")


def test_items_of_unknown_kind_are_passed_over_with_a_word(sphere: Path, store: Store) -> None:
    (sphere / "calibration" / "turntable.yaml").write_text(yaml.safe_dump({"item": "turntable", "angle": 3}))
    done = import_capture(sphere, store)
    assert any("turntable" in warning for warning in done.warnings)


def test_a_folder_that_is_wrong_leaves_nothing_and_all_its_faults_are_named(sphere: Path, store: Store) -> None:
    (sphere / "0001_X_576nm_CAM0.png").unlink()
    (sphere / "0002_Y_576nm_CAM1.png").write_bytes(b"no picture")
    cv2.imwrite(str(sphere / "0003_Z_576nm_CAM0.png"), np.zeros((48, 47), np.uint16))
    with pytest.raises(RequestError) as caught:
        import_capture(sphere, store)
    lines = str(caught.value).splitlines()
    assert [Path(line.split(" ")[0]).name for line in lines] == [
        "0001_X_576nm_CAM0.png",
        "0002_Y_576nm_CAM1.png",
        "0003_Z_576nm_CAM0.png",
    ]
    assert lines[2].endswith("is 47 x 48; the other pictures are 48 x 48")
    assert session_names(store) == []
    kept = ("sessions", "calibration", "cache")
    assert not [path for name in kept for path in (store.root / name).rglob("*") if path.is_file()]


def test_a_mask_is_where_its_picture_is_not_zero_and_as_large_as_the_others(tmp_path: Path, store: Store) -> None:
    folder = one_camera_capture(tmp_path / "c", ["C"], shape=(2, 3), mask="mask.png")
    cv2.imwrite(str(folder / "mask.png"), np.array([[0, 1, 255], [0, 0, 7]], np.uint8))
    mask = import_capture(folder, store).session.mask
    assert mask is not None
    assert mask.load(store).tolist() == [[False, True, True], [False, False, True]]
    cv2.imwrite(str(folder / "mask.png"), np.ones((2, 2), np.uint8))
    with pytest.raises(RequestError, match=r"mask\.png is 2 x 2; the mask must be as large as the pictures, 3 x 2"):
        import_capture(folder, store)


def test_an_item_that_left_the_folder_is_released_and_one_bound_by_hand_stays(sphere: Path, store: Store) -> None:
    came = import_capture(sphere, store).session
    other = sphere / "calibration" / "homography.yaml"
    by_hand = get_item("homography", came.items["homography"], store)
    other.write_text(other.read_text().replace("-1", "-2"))
    import_capture(sphere, store)
    bind_item("ball", by_hand, store)
    assert import_capture(sphere, store).changes == ()
    assert read_session("ball", store).items["homography"] == by_hand.digest
    (sphere / "calibration" / "bands.yaml").unlink()
    done = import_capture(sphere, store)
    assert done.changes == ("calibration item bands is gone",)
    assert dict(done.session.items) == {"homography": by_hand.digest}


def test_what_the_description_says_otherwise_is_named(sphere: Path, store: Store) -> None:
    import_capture(sphere, store)
    description = sphere / "capture.yaml"
    description.write_text(description.read_text() + "rig: york\n")
    assert import_capture(sphere, store).changes == ("rig changed: None -> york",)
    (sphere / "holiday.png").write_bytes(b"")
    assert import_capture(sphere, store).warnings == (
        f"{sphere / 'holiday.png'} is not mentioned in capture.yaml; passed over",
    )


def test_the_dark_is_taken_off_before_the_verdict(tmp_path: Path, store: Store) -> None:
    """Constant 500, dark 100, pair 250 + 250: |150 + 150 - 400| / 400; 2 % above the dark is 118.5."""
    folder = one_camera_capture(
        tmp_path / "c",
        ["C", "X", "Xc", "O"],
        items={"dark": {"item": "dark", "images": {"CAM1": "dark.png"}}},
        item_pictures={"dark.png": np.full((12, 16), 100, np.uint16)},
    )
    for name, value in (("0000_C", 500), ("0001_X", 250), ("0002_Xc", 250), ("0003_O", 118)):
        cv2.imwrite(str(folder / f"{name}_0nm_CAM1.png"), np.full((12, 16), value, np.uint16))
    rows = {row["illumination"]: row for row in import_capture(folder, store).session.verdict}
    assert rows["X"]["complement_residual"] == rows["Xc"]["complement_residual"] == pytest.approx(100 / 400)
    assert [rows[name]["underexposed"] for name in ("C", "X", "O")] == [0, 0, 1]

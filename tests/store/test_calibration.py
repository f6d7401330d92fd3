"""What an item's file says: read with its pictures, its notes set apart, and every slip named with its place."""

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from lightstage.store.calibration import KINDS, CameraItem, HomographyItem, Light, items_in, read_item
from lightstage.store.errors import RequestError
from lightstage.store.items import Item
from lightstage.store.root import Store

HOMOGRAPHY = """item: homography
from: CAM0
to: CAM1
matrix: [[1, 0, -1], [0, 1, 0.5], [0, 0, 1]]
"""


def read(tmp_path: Path, store: Store, text: str, **more: Any) -> Item:
    path = tmp_path / "item.yaml"
    path.write_text(text)
    item, original = read_item(path, store.chunks, **more)
    assert original == text.encode()
    return item


def refused(tmp_path: Path, store: Store, text: str, **more: Any) -> str:
    with pytest.raises(RequestError) as caught:
        read(tmp_path, store, text, **more)
    return str(caught.value).replace(str(tmp_path / "item.yaml"), "f")


def test_numbers_are_the_item_and_notes_stand_beside_it(tmp_path: Path, store: Store) -> None:
    plain = read(tmp_path, store, HOMOGRAPHY)
    assert plain.values == {
        "item": "homography",
        "from": "CAM0",
        "to": "CAM1",
        "matrix": [[1.0, 0.0, -1.0], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]],
    }
    noted = read(tmp_path, store, HOMOGRAPHY + "rig: york\nvalid_from: 2010-03-12\nresiduals: {rms_px: 0.2}\n")
    assert noted.digest == plain.digest
    assert noted.notes == {"rig": "york", "valid_from": "2010-03-12", "residuals": {"rms_px": 0.2}}
    assert plain.notes == {}


def test_an_items_pictures_are_its_values_whatever_their_files_are_called(tmp_path: Path, store: Store) -> None:
    pixels = np.array([[1, 2], [3, 400]], np.uint16)
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(tmp_path / name), pixels)
    item = read(tmp_path, store, "item: dark\nimages: {CAM0: a.png}\n")
    assert read(tmp_path, store, "item: dark\nimages: {CAM0: b.png}\n").digest == item.digest
    np.testing.assert_array_equal(item.pictures["CAM0"].load(store), pixels)
    assert "images" not in item.values
    cv2.imwrite(str(tmp_path / "b.png"), pixels + 1)
    assert read(tmp_path, store, "item: dark\nimages: {CAM0: b.png}\n").digest != item.digest


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("rig: york\n", "f:1:1: 'item' is missing; an item file begins with one of camera, homography"),
        ("item: homographie\n", "f:1:1: the item 'homographie' is not known; did you mean 'homography'?"),
        (HOMOGRAPHY.replace("from:", "source:"), "unknown key 'source'"),
        (HOMOGRAPHY.replace("to: CAM1\n", ""), "'to' is missing: camera"),
        (HOMOGRAPHY.replace("0.5", "half"), "f:4:"),
        ("item: homography\nfrom: A\nto: B\nmatrix: [[1, 0, 0], [2, 0, 0], [0, 0, 1]]\n", "cannot be inverted"),
        ("item: dark\nimages: {CAM0: no.png}\n", "no.png is missing"),
        ("item: bands\nbands: [{centre_nm: 407, exposure: 1}, {centre_nm: 407, exposure: 2}]\n", "stands twice"),
        ("item: bands\nbands: [{centre_nm: 407, exposure: 0}]\n", "exposure"),
        ("item: lights\nlights: [{id: L00}]\n", "light L00 needs either position_mm or direction"),
        ("item: lights\nlights: [{id: L00, direction: [0, 0, 0]}]\n", "is at the origin, so it has no direction"),
        (
            "item: lights\nlights: [{id: A, direction: [0, 0, 1]}, {id: B, position_mm: [0, 0, 700]}]\n",
            "all 2 lights lie in one direction",
        ),
    ],
)
def test_what_is_wrong_is_one_sentence(tmp_path: Path, store: Store, text: str, sentence: str) -> None:
    assert sentence in refused(tmp_path, store, text)


def test_another_kind_than_asked_for_is_refused(tmp_path: Path, store: Store) -> None:
    assert "this is a homography item, where lights was asked for" in refused(
        tmp_path, store, HOMOGRAPHY, kind="lights"
    )


def test_a_picture_has_one_channel(tmp_path: Path, store: Store) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((2, 2, 3), np.uint8))
    assert "has 3 channels; one is expected" in refused(tmp_path, store, "item: dark\nimages: {CAM0: a.png}\n")


def test_a_keys_name_in_the_file_is_the_only_one() -> None:
    with pytest.raises(ValueError, match="source"):
        HomographyItem.model_validate(
            {"item": "homography", "source": "A", "to": "B", "matrix": ((1, 0, 0), (0, 1, 0), (0, 0, 1))}
        )


def camera(**changes: Any) -> dict[str, Any]:
    turned = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
    return {
        "item": "camera",
        "size_px": (406, 309),
        "K": ((1020.0, 0.0, 203.2), (0.0, 1020.0, 153.4), (0.0, 0.0, 1.0)),
        "world_to_camera": {"R": turned, "t_mm": (0.0, 0.0, 890.0)},
        **changes,
    }


def pose(rows: Any, distance: float = 890.0) -> dict[str, Any]:
    return {"world_to_camera": {"R": tuple(map(tuple, rows)), "t_mm": (0.0, 0.0, distance)}}


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (pose(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0))), "it mirrors"),
        (pose(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.5))), "its rows have the lengths 1, 1, 1.5"),
        (pose(((1.0, 0.0, 0.0), (0.6, 0.8, 0.0), (0.0, 0.0, 1.0))), "do not stand at right angles"),
        (
            pose(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), -890.0),
            "puts the stage's centre at z = -890",
        ),
        ({"K": ((1020.0, 0.0, 203.2), (0.0, 0.5, 153.4), (0.0, 0.0, 1.0))}, "the focal lengths 1020 and 0.5"),
        ({"K": ((1020.0, 0.0, 203.2), (1.0, 1020.0, 153.4), (0.0, 0.0, 1.0))}, "the form is"),
    ],
)
def test_a_camera_that_cannot_be(changes: dict[str, Any], sentence: str) -> None:
    assert CameraItem.model_validate(camera()).distortion == (0, 0, 0, 0, 0)
    with pytest.raises(ValueError, match=sentence):
        CameraItem.model_validate(camera(**changes))


def test_a_light_is_towards_its_place_from_the_centre() -> None:
    assert Light(id="A", position_mm=(0.0, 300.0, 400.0)).towards == (0.0, 0.6, 0.8)
    assert Light(id="A", direction=(2.0, 0.0, 0.0)).towards == (1.0, 0.0, 0.0)
    third = 1 / math.sqrt(3)
    Light(id="A", direction=(1.0, 0.0, 0.0), drive_position=(third, third, third))
    with pytest.raises(ValueError, match="drive_position is 2 long; it must be a unit vector"):
        Light(id="A", direction=(1.0, 0.0, 0.0), drive_position=(0.0, 2.0, 0.0))


def test_a_folder_of_items(tmp_path: Path, store: Store) -> None:
    folder = tmp_path / "calibration"
    with pytest.raises(RequestError, match=r"calibration is missing: capture\.yaml names it"):
        items_in(folder, store.chunks)
    folder.mkdir()
    (folder / "h.yaml").write_text(HOMOGRAPHY)
    (folder / "p.yml").write_text("item: polarisers\nlights: [{id: L00, angle_deg: 3, residual: 0}]\n")
    (folder / "t.yaml").write_text("item: turntable\nangle: 3\n")
    (folder / "notes.txt").write_text("of the day")
    items, warnings = items_in(folder, store.chunks)
    assert list(items) == ["homography", "polarisers"]
    assert items["homography"][1] == HOMOGRAPHY.encode()
    assert warnings == [f"{folder / 't.yaml'}: no stage reads a 'turntable' item; passed over"]
    (folder / "h2.yaml").write_text(HOMOGRAPHY)
    (folder / "l.yaml").write_text("item: lihgts\nlights: []\n")
    with pytest.raises(RequestError) as caught:
        items_in(folder, store.chunks)
    lines = str(caught.value).splitlines()
    assert len(lines) == 2
    assert "a second homography item in this folder; keep one" in lines[0]
    assert "did you mean 'lights'?" in lines[1]


def test_every_kind_is_called_what_its_file_says() -> None:
    for kind, model in KINDS.items():
        assert model.model_fields["item"].annotation.__args__ == (kind,)  # type: ignore[union-attr]

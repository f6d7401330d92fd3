"""Sets of faces that are drawn by hand: one frame, pictures between two, equal light, the recipe."""

import io
from typing import Any

import cv2
import numpy as np
import pytest
import xarray
from PIL import Image

from lightstage.products.errors import ProductError
from lightstage.products.stimuli import GIVEN, Capture, SetOptions, framed, light_preview, matched, morphed, recipe

OPTIONS = SetOptions(
    match="mean-contrast", across="set", kinds="shape,texture", mean=0.4, contrast=0.05, background=None, grey=True,
    encoding="linear", morph=None, levels="0,1", vary="shape", distance_cm=57.0, pixels_per_cm=37.8,
)  # fmt: skip


def capture(bright: float, *, eyes: tuple[float, float] = (30.0, 70.0), dy: float = 0.0) -> Capture:
    """A ball of a face, 100 x 120 pixels, whose texture is a ramp."""
    y, x = np.mgrid[0:120, 0:100]
    nx, ny = (x - 50) / 90, (60 - y) / 90
    normal = np.stack([nx, ny, np.sqrt(1 - nx**2 - ny**2)]).astype(np.float32)
    texture = (bright * (0.5 + y / 240)).astype(np.float32)
    image = np.stack([np.maximum(normal[2], 0), texture, texture * normal[2]])[None, :, None]
    pictures = xarray.Dataset(
        {"image": (("tracking", "kind", "rgb", "y", "x"), image)},
        {"tracking": [0], "kind": ["shape", "texture", "both"]},
        {"lights": "0,0,1", "cast_shadows": 0, "nothing": [1, 2]},
    )
    relief = xarray.Dataset(
        {"normal": (("tracking", "band", "xyz", "y", "x"), normal[None, None])}, {"tracking": [0]}
    )
    points = {"left_eye": np.array([eyes[0], 50.0]), "right_eye": np.array([eyes[1], 50.0 + dy])}
    return Capture(pictures, relief, "recipe-manifest", points, GIVEN)


def pair() -> tuple[Any, Any, Any]:
    return framed({"a": capture(0.3), "b": capture(0.6)}, None, lambda text: None)


def test_eyes_stand_where_the_frame_has_them() -> None:
    subjects, sources, frame = pair()
    assert frame.eyes_px == 40
    assert [subject.name for subject in subjects] == ["a", "b"]
    for source in sources.values():
        np.testing.assert_allclose(source.framed["left_eye"], frame.eyes[0], atol=1e-9)
    assert subjects[0].images["shape"].shape == (1, *frame.shape)
    assert subjects[0].attrs == {"lights": "0,0,1", "cast_shadows": 0}


def test_a_leaning_head_and_a_cut_one_are_told() -> None:
    said: list[str] = []
    framed({"a": capture(0.3, dy=8.0)}, None, said.append)
    assert any("leans by 11.3 degrees" in text for text in said)
    said.clear()
    framed({"a": capture(0.3, eyes=(5.0, 60.0))}, None, said.append)
    assert any("of the oval was not measured" in text for text in said)


def test_eyes_too_near_are_no_face() -> None:
    with pytest.raises(ProductError, match=r"the eyes are 5.0 pixels apart, too near for a face"):
        framed({"a": capture(0.3, eyes=(50.0, 55.0))}, None, lambda text: None)
    _, _, frame = framed({"a": capture(0.3, eyes=(50.0, 55.0))}, 20.0, lambda text: None)
    assert frame.eyes_px == 20


def test_a_texture_between_two_is_their_mean_and_the_shape_stays() -> None:
    subjects, sources, frame = pair()
    first, half = morphed(subjects, sources, frame, ends=("a", "b"), levels=[0, 0.5], vary="texture")
    assert (first.name, half.name) == ("a-b-texture-000", "a-b-texture-050")
    inner = np.s_[:, frame.shape[0] // 3 : frame.shape[0] // 2, frame.shape[1] // 3 : -frame.shape[1] // 3]
    a, b = (subject.images["texture"][inner] for subject in subjects)
    np.testing.assert_allclose(first.images["texture"][inner], a, rtol=1e-5)
    np.testing.assert_allclose(half.images["texture"][inner], (a + b) / 2, rtol=0.02)  # the flow is not quite 0
    np.testing.assert_array_equal(half.images["shape"], first.images["shape"])


def test_faces_with_shadows_are_not_mixed() -> None:
    shadowed = capture(0.3)
    shadowed.pictures.attrs["cast_shadows"] = 1
    subjects, sources, frame = framed({"a": shadowed, "b": capture(0.6)}, None, lambda text: None)
    with pytest.raises(ProductError, match="between two faces there is no depth"):
        morphed(subjects, sources, frame, ends=("a", "b"), levels=[0], vary="shape")


def test_all_pictures_have_one_mean_and_the_table_says_what_they_hold() -> None:
    subjects, _, frame = pair()
    made = matched(subjects, frame, OPTIONS, "the recipe")
    assert [row["file"] for row in made.rows] == ["a_shape.png", "b_shape.png", "a_texture.png", "b_texture.png"]
    assert set(made.files) == {name for row in made.rows for name in (row["file"], row["file_16bit"])}
    oval = frame.oval() > 0.99
    for row in made.rows:
        picture = np.asarray(Image.open(io.BytesIO(made.files[row["file"]])))
        assert picture.dtype == np.uint8
        assert picture[oval].mean() == pytest.approx(0.4 * 255, abs=3)
        deep = cv2.imdecode(np.frombuffer(made.files[row["file_16bit"]], np.uint8), cv2.IMREAD_UNCHANGED)
        np.testing.assert_allclose(deep / 257, picture, atol=1)  # rounded, and dithered nowhere
        assert row["recipe"] == "the recipe"
        assert row["lights"] == ("" if row["kind"] == "texture" else "0,0,1")
    (off,) = made.differences
    assert off["mean_linear"] < 0.5


def test_the_recipe_has_all_that_decides() -> None:
    subjects, sources, frame = pair()
    made = recipe(subjects, sources, frame, OPTIONS)
    assert made["options"]["match"] == "mean-contrast"
    assert made["sessions"]["a"] == {
        "result": "recipe-manifest", "points": "given", "left_eye": [30.0, 50.0], "right_eye": [70.0, 50.0],
    }  # fmt: skip
    assert made["subjects"]["b"]["lights"] == "0,0,1"


def test_a_sheet_of_lights() -> None:
    normal = capture(0.3).relief.normal.values[0, 0]
    picture = np.asarray(Image.open(io.BytesIO(light_preview("a", normal))).convert("L"))
    assert picture.shape[1] == round(1.5 * 7 * 110)
    assert picture.std() > 20

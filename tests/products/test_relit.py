"""Relit pictures without a store: files, exposure, table, sheet and film, of a surface that is made by hand."""

import csv
import io
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
import xarray
from PIL import Image

from lightstage.products.light_setups import Distant, Setup, environment_lamps, one_picture
from lightstage.products.material import Gloss, Material
from lightstage.products.relit import (
    document,
    own_pictures,
    png16,
    surface_of,
    write_pictures,
    write_sheet,
    write_table,
    write_turn,
)
from tests.products.plate import SHAPE, plate
from tests.readers import Exr


def test_the_png_is_what_the_standard_says() -> None:
    """sRGB code of linear 0.5 is 0.7354 (IEC 61966-2-1); decoded by hand."""
    alpha = np.ones((2, 3), bool)
    alpha[1, 2] = False
    data = png16(np.full((2, 3, 3), 0.5), alpha, "said")
    kinds, at = [], 8
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        kinds.append(kind)
        at += 12 + length
    assert kinds[:5] == [b"IHDR", b"sRGB", b"gAMA", b"cHRM", b"tEXt"]
    assert kinds[-1] == b"IEND"
    with Image.open(io.BytesIO(data)) as opened:
        opened.load()  # checks every chunk's sum
    counts = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert counts[0, 0].tolist() == [round(65535 * 0.735357)] * 3 + [65535]
    assert counts[1, 2].tolist() == [0, 0, 0, 0]


def front(strength: float = 1.0) -> Setup:
    (setup,) = one_picture([Distant(0, 0, strength)], None)
    return setup


def test_a_plate_that_faces_a_light_of_strength_one_shows_its_albedo(tmp_path: Path) -> None:
    material = plate(albedo=0.4)
    files, (row,) = write_pictures(tmp_path, material, surface_of(material), [front()], None, {})
    assert set(files) == {"lights.exr", "lights.png"} == {path.name for path in tmp_path.iterdir()}
    made = Exr(tmp_path / "lights.exr")
    known = made["A"] == 1
    np.testing.assert_array_equal(known, material.known)
    np.testing.assert_allclose(made["G"][known], 0.4, rtol=1e-3)
    assert row.median == pytest.approx(0.4, rel=1e-3)
    assert row.exposure == pytest.approx(0.9 / 0.4, rel=1e-3)  # the brightest shows as 0.9 of white
    assert row.clipped == 0
    assert (row.psnr_db, row.ssim) == (None, None)


def test_one_exposure_for_all_pictures_and_what_is_clipped_is_counted(tmp_path: Path) -> None:
    material = plate(albedo=0.4)
    dim, bright = front(0.5), Setup("bright", "twice", front(2.0).lamps)
    _, rows = write_pictures(tmp_path, material, surface_of(material), [dim, bright], None, {})
    assert rows[0].exposure == rows[1].exposure == pytest.approx(0.9 / 0.8, rel=1e-3)
    _, (over,) = write_pictures(tmp_path, material, surface_of(material), [bright], 2.0, {})
    assert over.clipped == 1


def test_the_session_s_own_picture_is_compared(tmp_path: Path) -> None:
    material = plate(albedo=0.4)
    shine = np.zeros((1, 1, 2, *SHAPE))
    shine[:, :, 0] = 0.4
    stack = xarray.Dataset(
        {"radiance": (("illumination", "band", "component", "y", "x"), shine)}, {"illumination": ["lights"]}
    )
    taken = own_pictures(material, [front()], stack)
    np.testing.assert_allclose(taken["lights"], 0.4, rtol=1e-6)
    assert own_pictures(material, [Setup("L99", "", front().lamps)], stack) == {}
    _, (row,) = write_pictures(tmp_path, material, surface_of(material), [front()], None, taken)
    assert row.psnr_db is not None
    assert row.psnr_db > 40


def test_table_and_sheet(tmp_path: Path) -> None:
    material = plate(albedo=0.4)
    _, rows = write_pictures(tmp_path, material, surface_of(material), [front()], None, {})
    write_table(tmp_path, rows)
    write_sheet(tmp_path, rows)
    with open(tmp_path / "relight.csv", newline="") as file:
        (read,) = csv.DictReader(file)
    assert (read["picture"], read["psnr_db"]) == ("lights", "")
    assert float(read["exposure"]) == pytest.approx(rows[0].exposure, rel=1e-5)
    with Image.open(tmp_path / "relight.png") as sheet:
        assert np.asarray(sheet).max() > 200
    assert document(material)["gloss"].startswith("none")


def test_the_environment_turns_and_other_lights_stay(tmp_path: Path) -> None:
    material = plate(albedo=0.4)
    sky = np.zeros((8, 16, 3), np.float32)
    sky[3, 8] = 20  # towards the camera
    (setup,) = one_picture([Distant(0, 0, 0.1)], environment_lamps(sky, 1), "sky")
    write_turn(tmp_path, material, surface_of(material), setup, 1.0, 2)
    film = cv2.VideoCapture(str(tmp_path / "environment_turn.mp4"))
    (there, first), (_, second) = film.read(), film.read()
    assert there
    assert first.shape == (*SHAPE, 3)
    assert first[8, 10].mean() > second[8, 10].mean() + 20 > 40  # half a turn later it lights the back


def test_colours_outside_come_to_the_border_and_holes_in_the_gloss_are_filled() -> None:
    material = plate(albedo=0.4)
    specular = np.full(SHAPE, 0.03)
    specular[2, 2] = np.nan
    gloss = Gloss(specular, np.full(SHAPE, 0.2), material.normal, 1.4, absolute=True)
    surface = surface_of(Material(**{**vars(material), "gloss": gloss}))
    assert surface.specular is not None
    np.testing.assert_allclose(surface.specular, 0.03)
    assert surface.refraction == 1.4
    assert np.nanmin(surface.albedo) >= 0

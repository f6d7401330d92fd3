"""Materials and relit pictures of a plate that faces the camera: whole folders, and whose files they are."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import xarray

import lightstage
from lightstage.api.deliveries import MaterialDelivery, RelightDelivery, one_setup
from lightstage.api.requests import make_request
from lightstage.api.subjects import material_nodes
from lightstage.dag.answer import Answer
from tests.api.test_subjects import SHAPE, answer_of, face, material_results
from tests.readers import Exr

__all__ = ["face"]


def finished(session: lightstage.OpenSession) -> Answer:
    stack = xarray.Dataset({"radiance": (("frame",), np.zeros(1))})
    return answer_of(session, {**material_results(), "stack": stack})


def material(
    session: lightstage.OpenSession, folder: Path, formats: tuple[str, ...] = ("exr",)
) -> MaterialDelivery:
    return MaterialDelivery(session.read(), session.opened, folder, formats)


def test_a_material_is_a_folder_with_its_record(face: lightstage.OpenSession, tmp_path: Path) -> None:
    delivery = material(face, tmp_path / "out")
    request = make_request("face", delivery.nodes)
    answer = finished(face)
    delivered = delivery.deliver(request, answer)
    assert {file.name for file in delivered.files} == {path.name for path in (tmp_path / "out").iterdir()}
    assert (delivered.files[-1].name, delivered.glossy, delivered.absolute) == ("material.json", False, True)
    record = json.loads(delivered.files[-1].read_text())
    assert record["session"] == "face"
    assert set(record["files"]) == set(delivered.entries)
    assert record["files"]["depth.exr"]["results"] == dict.fromkeys(delivery.nodes, "by-hand")
    depth = Exr(tmp_path / "out" / "depth.exr")
    np.testing.assert_allclose(depth.pixels[..., 0], 900)
    again = material(face, tmp_path / "out").deliver(request, answer)  # its own files it may replace
    assert again.files == delivered.files


def test_nothing_of_somebody_else_s_is_replaced_and_that_is_said_before_the_work(
    face: lightstage.OpenSession, tmp_path: Path
) -> None:
    (tmp_path / "mask.exr").write_text("somebody else's")
    with pytest.raises(lightstage.RequestError, match=r"mask\.exr is there already"):
        material(face, tmp_path)
    material(face, tmp_path, ("glb",))  # which has no mask
    (tmp_path / "file").write_text("")
    with pytest.raises(lightstage.RequestError, match="no folder can be made there"):
        material(face, tmp_path / "file")
    assert (tmp_path / "mask.exr").read_text() == "somebody else's"


def test_a_frame_that_is_not_there_leaves_no_half_of_a_folder(face: lightstage.OpenSession, tmp_path: Path) -> None:
    delivery = material(face, tmp_path / "out")
    with pytest.raises(lightstage.RequestError, match="has no tracking frame 4"):
        delivery.deliver(make_request("face", delivery.nodes), finished(face), tracking=4)
    assert list((tmp_path / "out").iterdir()) == []


def relight(session: lightstage.OpenSession, folder: Path, *lights: tuple[float, float, float]) -> RelightDelivery:
    request = make_request("face", material_nodes(session.read()))
    return RelightDelivery(session.read(), session.opened, folder, request, one_setup(lights), leds=["L00+L01"])


def test_two_lights_are_as_bright_as_their_sum(face: lightstage.OpenSession, tmp_path: Path) -> None:
    """A plate that faces the camera, under lights at the camera of strength 0.25 and 0.5; a third as far as 60
    degrees to the side gives cos 60 of its strength."""
    answer = finished(face)
    values = {}
    for name, lights in {
        "both": [(0, 0, 0.25), (0, 0, 0.5)],
        "sum": [(0, 0, 0.75)],
        "side": [(60, 0, 1.5)],
    }.items():
        delivered = relight(face, tmp_path / name, *lights).deliver(answer)
        picture = Exr(tmp_path / name / "lights.exr")
        values[name] = picture["G"]
        assert [row.picture for row in delivered.rows] == ["lights", "L00+L01"]
        assert delivered.files[-1].name == "relight.json"
    assert values["sum"].shape == SHAPE
    np.testing.assert_allclose(values["both"], values["sum"], rtol=1e-5)
    np.testing.assert_allclose(
        values["side"], values["sum"], rtol=1e-4
    )  # a distant light is very far, not infinitely


def test_lights_and_an_environment_are_one_picture(tmp_path: Path) -> None:
    path = tmp_path / "sky.hdr"
    assert cv2.imwrite(str(path), np.full((8, 16, 3), 0.5, np.float32))
    (setup,) = one_setup([(30, 10, 2)], path, count=4, rotate_deg=90)
    assert setup.name == "environment_lights"
    assert setup.text == "sky.hdr turned by 90 + (30, 10, 2)"
    assert (setup.turning, len(setup.lamps.places)) == (4, 5)
    assert one_setup([]) == []
    with pytest.raises(lightstage.RequestError, match=r"^--environment .*no\.hdr"):
        one_setup([], tmp_path / "no.hdr")

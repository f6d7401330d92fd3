"""Results read for the products that are made of them: each by hand here, so that the values are known."""

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
import pytest
import xarray

import lightstage
from lightstage.api import subjects
from lightstage.api.requests import make_request
from lightstage.dag.answer import Answer, NodeAnswer
from tests.conftest import put_result
from tests.scenes import write_capture

SHAPE = (12, 16)
PICTURE = ("tracking", "y", "x")
CAMERA = {
    "item": "camera", "size_px": [SHAPE[1], SHAPE[0]], "K": [[100, 0, 7.5], [0, 100, 5.5], [0, 0, 1]],
    "distortion": [0] * 5, "world_to_camera": {"R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "t_mm": [0, 0, 900]},
}  # fmt: skip
BANDS = {"item": "bands", "bands": [{"centre_nm": nm, "width_nm": 15, "exposure": 1} for nm in (434, 576, 655)]}
LIGHTS = {
    "item": "lights", "drive": "ideal",
    "lights": [
        {"id": f"L{i:02d}", "position_mm": [790 * x for x in place], "power": 1.0 + i}
        for i, place in enumerate([(0, 0, 1), (1, 0, 0), (0, 1, 0), (0, 0, -1), (-1, 0, 0), (0, -1, 0)])
    ],
}  # fmt: skip
"""Six, one on each axis and side."""


@pytest.fixture
def face(store: lightstage.OpenStore, tmp_path: Path) -> lightstage.OpenSession:
    """A session in three bands with its rig's items, one camera."""
    pictures = {(i, nm, "cross"): np.full(SHAPE, 300, np.uint16) for i in range(4) for nm in (434, 576, 655)}
    items = {"camera": CAMERA, "bands": BANDS, "lights": LIGHTS}
    folder = write_capture(tmp_path / "face", pictures, illumination=["C", "X", "Y", "Z"], items=items)
    return store.import_capture(folder).session


def answer_of(session: lightstage.OpenSession, results: Mapping[str, xarray.Dataset | None]) -> Answer:
    nodes = {}
    for name, dataset in results.items():
        path = session.opened.results / session.name / name / "by-hand"
        if dataset is not None:
            put_result(dataset, session.opened.root, session.name, name)
        nodes[name] = NodeAnswer(None if dataset is None else path, 0, 1, 0.0, 0, {}, ())
    return Answer(session.name, nodes, 0.0)


def test_results_are_those_of_the_answer_and_of_no_other_run(face: lightstage.OpenSession) -> None:
    dataset = xarray.Dataset({"a": (("x",), np.arange(3))})
    answer = answer_of(face, {"stack": dataset, "shape": None})
    assert subjects.paths_of(answer, ["stack"]) == {"stack": answer.nodes["stack"].path}
    assert subjects.opened(answer, ["stack"])["stack"].a.values.tolist() == [0, 1, 2]
    with pytest.raises(lightstage.RequestError, match="session 'face': --frames leaves no tracking frame"):
        subjects.paths_of(answer, ["stack", "shape"])


def skin_results() -> dict[str, xarray.Dataset | None]:
    rho = np.broadcast_to(np.array([0.2, 0.35, 0.6], np.float32)[None, :, None, None], (1, 3, *SHAPE))
    maps = {name: (PICTURE, np.full((1, *SHAPE), 0.1, np.float32)) for name in ("melanin", "haemoglobin")}
    zero = {name: (PICTURE, np.zeros((1, *SHAPE), np.float32)) for name in ("baseline", "residual")}
    parameters = {"model": "kubelka_munk", "saturation": 0.5, "pass_band": "gaussian"}
    return {
        "reflectance": xarray.Dataset(
            {
                "reflectance": (("tracking", "band", "y", "x"), rho),
                "standard_error": (("tracking", "band", "y", "x"), 0.01 + 0 * rho),
            },
            {"tracking": [3], "band": [434.0, 576.0, 655.0]},
            {"scale": "absolute"},
        ),
        "chromophores": xarray.Dataset(
            {**maps, **zero},
            {"tracking": [3]},
            {"parameters": parameters, "melanin_unit": "1", "haemoglobin_unit": "1"},
        ),
    }


def test_skin_is_read_with_the_stage_s_fit_and_the_request_s_bands(face: lightstage.OpenSession) -> None:
    request = make_request("face", subjects.SKIN_NODES)
    answer = answer_of(face, skin_results())
    skin = subjects.skin_of(answer, request, face.opened)
    assert (skin.session, skin.tracking, skin.bands_nm) == ("face", 3, (434, 576, 655))
    assert skin.widths_nm == (15, 15, 15)
    assert (skin.model.saturation, skin.model.pass_band) == (0.5, "gaussian")
    # what the fit finds in a spectrum that it predicts is what the spectrum was predicted from
    amounts = [np.array([0.05]), np.array([0.04]), np.array([0.0])]
    spectrum = skin.model.predicted(*amounts, skin.passing)[0]
    maps = skin.model.fit(spectrum[:, None, None], np.full((3, 1, 1), 1e-4), skin.passing)
    for name, amount in zip(("melanin", "haemoglobin"), amounts[:2], strict=True):
        assert maps[name][0, 0] == pytest.approx(amount[0], rel=0.02)
    with pytest.raises(lightstage.RequestError, match="has no tracking frame 7; it has 3"):
        subjects.skin_of(answer, request, face.opened, tracking=7)


def material_results() -> dict[str, xarray.Dataset | None]:
    normal = np.zeros((1, 1, 3, *SHAPE), np.float32)
    normal[:, :, 2] = 1
    frame = {"tracking": [3]}
    return {
        "reflectance": skin_results()["reflectance"],
        "relief": xarray.Dataset({"normal": (("tracking", "band", "xyz", "y", "x"), normal)}, frame),
        "shape": xarray.Dataset(
            {
                "depth_mm": (PICTURE, np.full((1, *SHAPE), 900.0)),
                "edge": (PICTURE, np.zeros((1, *SHAPE), np.uint8)),
            },
            frame,
        ),
    }


def test_a_material_is_read_with_the_session_s_camera(face: lightstage.OpenSession) -> None:
    session = face.read()
    nodes = subjects.material_nodes(session)
    assert set(nodes) == {"reflectance", "relief", "shape"}  # one camera shows no gloss
    request = make_request("face", nodes)
    answer = answer_of(face, material_results())
    material = subjects.material_of(answer, request, session, face.opened)
    assert (material.session, material.tracking, material.absolute) == ("face", 3, True)
    assert material.known.all()
    assert material.gloss is None
    assert material.recipes == dict.fromkeys(nodes, "by-hand")
    assert material.camera.shape == SHAPE
    with pytest.raises(lightstage.RequestError, match="has no tracking frame 4"):
        subjects.material_of(answer, request, session, face.opened, tracking=4)


def test_both_polarisations_show_gloss(finished: lightstage.OpenSession) -> None:
    assert set(subjects.material_nodes(finished.read())) == {"reflectance", "relief", "shape", "gloss", "specular"}


def test_the_rig_s_own_lights_are_those_of_its_item(
    face: lightstage.OpenSession, finished: lightstage.OpenSession
) -> None:
    request = make_request("face")
    setups = subjects.own_lights(["all", "L01+L02"], request, face.opened)
    assert [setup.name for setup in setups] == ["L00", "L01", "L02", "L03", "L04", "L05", "L01+L02"]
    assert setups[1].lamps.places.tolist() == [[790, 0, 0]]
    assert setups[6].lamps.places.tolist() == [[790, 0, 0], [0, 790, 0]]
    assert subjects.own_lights([], request, face.opened) == []
    with pytest.raises(lightstage.RequestError, match=r"^--led L07: the rig has no light 'L07'"):
        subjects.own_lights(["L07"], request, face.opened)
    with pytest.raises(lightstage.RequestError, match="session 'ball' has no lights item"):
        subjects.own_lights(["L00"], make_request("ball"), finished.opened)


def test_an_environment_is_read_or_named(tmp_path: Path) -> None:
    path = tmp_path / "sky.hdr"
    assert cv2.imwrite(str(path), np.full((4, 8, 3), 0.5, np.float32))
    radiance = subjects.environment(path)
    assert radiance.shape == (4, 8, 3)
    np.testing.assert_allclose(radiance, 0.5, rtol=0.01)
    (tmp_path / "text.hdr").write_text("no picture")
    with pytest.raises(lightstage.RequestError, match=r"^--environment "):
        subjects.environment(tmp_path / "text.hdr")
    for place in (tmp_path / "none.hdr", tmp_path):
        with pytest.raises(lightstage.RequestError, match=r"^--environment .*give a .hdr or .exr map"):
            subjects.environment(place)


def test_a_recipe_s_digest_is_of_its_content() -> None:
    digest = subjects.recipe_digest({"a": 1, "b": [1, 2]})
    assert digest == subjects.recipe_digest({"b": [1, 2], "a": 1})
    assert digest != subjects.recipe_digest({"a": 1, "b": [2, 1]})
    assert len(digest) == 12


def test_a_face_s_normals_are_those_of_its_pictures(face: lightstage.OpenSession) -> None:
    pictures = xarray.Dataset({"shape": (PICTURE, np.ones((1, *SHAPE)))}, {"tracking": [5]})
    relief = xarray.Dataset({"normal": (("tracking",), np.array([2.0, 5.0]))}, {"tracking": [2, 5]})
    answer = answer_of(face, {"relief": relief, "stimulus": pictures})
    shown, normals, folder = subjects.face_of(answer, "stimulus", "relief")
    assert (shown.tracking.values.tolist(), normals.normal.values.tolist(), folder) == ([5], [5.0], "by-hand")
    with pytest.raises(lightstage.RequestError, match="leaves nothing to make stimuli of"):
        subjects.face_of(answer_of(face, {"relief": None, "stimulus": None}), "stimulus", "relief")

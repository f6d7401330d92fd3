"""Pages of results made by hand: where they go, and what they leave alone."""

from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
import xarray

import lightstage
from lightstage.api.pages import alignment_page, light_previews, skin_pages, skin_spectra
from tests.conftest import put_result
from tests.products.test_skin import skin
from tests.scenes import one_camera_capture, sphere_normals

SHAPE = (40, 60)
NAMES = ("X", "C", "Xc")


@pytest.fixture
def aligned(store: lightstage.OpenStore, tmp_path: Path) -> lightstage.OpenSession:
    """One tracking frame and its base pair, which adds up to the constant picture."""
    session = store.import_capture(
        one_camera_capture(tmp_path / "head", NAMES, shape=SHAPE, frame_rate_hz=60.0)
    ).session
    picture = np.random.default_rng(0).uniform(50, 100, SHAPE).astype(np.float32)
    levels = np.array([0.25, 1.0, 0.75], np.float32)
    captured = levels[:, None, None] * picture
    align = xarray.Dataset(
        {
            "flow": (("tracking", "member", "xy", "y", "x"), np.zeros((1, 3, 2, *SHAPE), np.float32)),
            "aligned": (("tracking", "member", "band", "component", "y", "x"), captured[None, :, None, None]),
            "confidence": (("tracking", "member", "y", "x"), np.ones((1, 3, *SHAPE), np.float32)),
            "residual": (("tracking", "y", "x"), np.zeros((1, *SHAPE), np.float32)),
        },
        {
            "tracking": [1],
            "frame": (("tracking", "member"), [[0, 1, 2]]),
            "illumination": (("tracking", "member"), [list(NAMES)]),
            "band": [0.0],
            "component": ["diffuse"],
        },
        {"engine": "none"},
    )
    stack = xarray.Dataset(
        {"radiance": (("frame", "band", "component", "y", "x"), captured[:, None, None])},
        {
            "frame": [0, 1, 2],
            "illumination": (("frame",), list(NAMES)),
            "time_s": (("frame",), [0.0, 1 / 60, 2 / 60]),
            "band": [0.0],
            "component": ["diffuse"],
        },
    )
    for node, dataset in (("align", align), ("stack", stack)):
        put_result(dataset, store.root, "head", node)
    return session


def test_an_alignment_is_drawn_beside_the_results_or_where_it_is_wanted(
    aligned: lightstage.OpenSession, tmp_path: Path
) -> None:
    page = alignment_page(aligned.read(), aligned.opened, points=[(3, 4)])
    assert page.path == aligned.opened.root / "pictures" / "head_alignment_1.png"
    assert (page.tracking, page.points) == (1, ((3, 4),))
    assert page.residual_before == page.residual_after == pytest.approx(0, abs=1e-6)  # they add up
    own = alignment_page(aligned.read(), aligned.opened, points=[(3, 4)], file=tmp_path / "new" / "a.png")
    assert own.path.read_bytes() == page.path.read_bytes()
    with pytest.raises(lightstage.RequestError, match=r"^--to .*a\.png is there already and holds something else"):
        alignment_page(aligned.read(), aligned.opened, points=[(5, 4)], file=own.path)
    other = alignment_page(aligned.read(), aligned.opened, points=[(5, 4)])
    assert other.path == page.path
    assert other.path.read_bytes() != own.path.read_bytes()


def test_a_point_outside_and_a_frame_that_is_not_there_are_refused(aligned: lightstage.OpenSession) -> None:
    for options, sentence in (
        ({"points": [(60, 0)]}, "--at 60,0 is outside the picture; X is 0 to 59 and Y is 0 to 39"),
        ({"points": [(0, -1)]}, "--at 0,-1 is outside"),
        ({"tracking": 2}, "has no tracking frame 2; it has 1"),
    ):
        chosen: dict[str, Any] = dict(options)
        with pytest.raises(lightstage.RequestError, match=sentence):
            alignment_page(aligned.read(), aligned.opened, **chosen)
    assert not (aligned.opened.root / "pictures").exists()


def test_pages_of_a_skin_are_two_pictures_and_a_table(aligned: lightstage.OpenSession) -> None:
    points = skin_spectra(skin(), [(20, 10)])
    assert [point.name for point in points] == ["average", "point 1"]
    files = skin_pages(skin(), points, aligned.opened)
    assert {what: file.name for what, file in files.items()} == {
        "picture": "a_skin.png",
        "spectra": "a_skin_spectra.png",
        "table": "a_skin_spectra.csv",
    }
    assert imageio.imread(files["picture"]).ndim == 3
    assert len(files["table"].read_text().splitlines()) == 1 + 2 * 3  # a row a point and band
    with pytest.raises(lightstage.RequestError, match=r"^--at 40,3 is outside"):
        skin_spectra(skin(), [(40, 3)])


def test_a_page_that_cannot_be_written_is_a_sentence(
    aligned: lightstage.OpenSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("lightstage.formats.whole_file.write_whole", full)
    with pytest.raises(lightstage.WorkError, match=r"pictures cannot be written \(No space left on device\)"):
        skin_pages(skin(), skin_spectra(skin(), []), aligned.opened)


def test_sheets_of_light_take_nobody_s_place(aligned: lightstage.OpenSession, tmp_path: Path) -> None:
    normal, mask = sphere_normals(24)
    relief = xarray.Dataset(
        {"normal": (("tracking", "band", "xyz", "y", "x"), np.where(mask, normal, np.nan)[None, None])}
    )
    (kept,) = light_previews({"head": relief}, aligned.opened)
    assert kept == aligned.opened.root / "pictures" / "head-lights.png"
    (own,) = light_previews({"head": relief}, aligned.opened, tmp_path / "new")
    assert own == tmp_path / "new" / "head-lights.png"
    assert own.read_bytes() == kept.read_bytes()
    own.write_bytes(b"somebody else's")
    with pytest.raises(lightstage.RequestError, match=r"^--to .*head-lights\.png is there already"):
        light_previews({"head": relief}, aligned.opened, own.parent)
    with pytest.raises(lightstage.RequestError, match="is a file; name a folder"):
        light_previews({"head": relief}, aligned.opened, own)
    assert own.read_bytes() == b"somebody else's"

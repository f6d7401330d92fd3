"""The page of a calibration, of evidence made by hand."""

import base64
import io
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from PIL import Image

from lightstage.products.calibration_report import Evidence, write_report
from lightstage.products.figures import pyplot

SHAPE = (24, 32)


class Page(HTMLParser):
    """What a browser would show: headings, list entries with their class, pictures, table cells."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.texts: list[tuple[str, str, str]] = []
        self.pictures: list[Any] = []
        self._open: list[tuple[str, str]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag == "img":
            kind, _, data = str(given["src"]).partition(",")
            assert kind == "data:image/png;base64"
            self.pictures.append(np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")))
        else:
            self._open.append((tag, given.get("class") or ""))

    def handle_endtag(self, tag: str) -> None:
        while self._open and self._open.pop()[0] != tag:
            pass

    def handle_data(self, data: str) -> None:
        if self._open and data.strip():
            self.texts.append((*self._open[-1], data.strip()))

    def all(self, tag: str) -> list[str]:
        return [text for name, _, text in self.texts if name == tag]


def picture(frame: int, polarisation: int) -> Any:
    """A ramp with a bright spot that is the frame's."""
    counts = np.arange(SHAPE[0] * SHAPE[1], dtype=np.uint16).reshape(SHAPE) % 60
    counts[10, 5 + 3 * frame] = 1000
    return counts


def evidence(result: xarray.Dataset, *, lights: list[str] | None = None, **facts: Any) -> Evidence:
    corners = np.stack(np.meshgrid(np.arange(4.0, 28, 6), np.arange(4.0, 20, 6)), axis=-1)
    board = xarray.Dataset(
        {"points": (("frame", "camera", "row", "column", "xy"), np.tile(corners, (2, 2, 1, 1, 1)))}
    )
    return Evidence(
        session="<boards & co>",
        facts={
            "rig": "york", "captured": None, "illumination": lights or ["C", "C"],
            "polarisation": ["parallel", "cross"], "cameras": {"parallel": "CAM0", "cross": "CAM1"}, **facts,
        },
        shape=SHAPE,
        recipe="abc123",
        result=result,
        verdict=[("good", "as it was"), ("bad", "a < b & c")],
        picture=picture,
        open_node=lambda node: board,
    )  # fmt: skip


def residuals() -> xarray.Dataset:
    generator = np.random.default_rng(0)
    return xarray.Dataset(
        {
            "points": (("corner", "xy"), generator.uniform(2, 22, (9, 2))),
            "residual": (("corner", "xy"), generator.normal(0, 0.1, (9, 2))),
        }
    )


def lights() -> xarray.Dataset:
    ring = np.array([[10.0, 4], [20, 4], [20, 18], [10, 18]])
    return xarray.Dataset(
        {
            "outline": (("part", "point", "xy"), ring[None]),
            "at_px": (("part", "light", "xy"), np.array([[[12.0, 8], [15, 12], [np.nan, np.nan]]])),
            "status": (("part", "light"), np.array([[0, 1, 2]]), {"meanings": "seen cut hidden"}),
            "residual_mm": (("light",), np.array([1.25, np.nan, np.nan])),
            "sigma_mm": (("light",), np.array([0.5, 2.0, np.nan])),
            "position_mm": (("light", "xyz"), np.array([[0, 0, 790.0], [790, 0, 0], [np.nan] * 3])),
            "direction": (("light", "xyz"), np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])),
        },
        {"light": ["L00", "L01", "L02"]},
    )


def maps(mask: str) -> xarray.Dataset:
    wrong = np.zeros((2, *SHAPE), bool)
    wrong[0, 3, 4] = True
    mean = np.random.default_rng(1).normal(64, 1, (2, *SHAPE))
    return xarray.Dataset(
        {"mean": (("polarisation", "y", "x"), mean), mask: (("polarisation", "y", "x"), wrong)},
        {"polarisation": ["parallel", "cross"]},
    )


RESULTS = {
    "homography": (residuals(), 2),
    "camera": (residuals(), 2),
    "dark": (maps("hot"), 2),
    "flat": (maps("dead"), 2),
    "bands": (
        xarray.Dataset(
            {"target": (("y", "x"), np.pad(np.ones((8, 8)), ((8, 8), (12, 12)))), "scale": (("band",), [1.0, 2.0])},
            {"band": [434.0, 576.0]},
        ),
        1,
    ),
    "synchronisation": (
        xarray.Dataset(
            {
                "drive": (("frame", "light"), np.eye(4)), "wrong": (("frame",), [False, True, False, False]),
                **{f"leak_{side}_percent": (("frame",), np.arange(4.0)) for side in ("before", "after")},
            }
        ),
        1,
    ),
    "polarisers": (
        xarray.Dataset(
            {name: (("light",), np.arange(3.0)) for name in ("residual", "least_deg", "theta0_se_deg")},
            {"light": ["L00", "L01", "L02"]},
        ),
        1,
    ),
}  # fmt: skip


@pytest.mark.parametrize("item", list(RESULTS))
def test_every_item_has_its_figures_and_the_verdict(tmp_path: Path, item: str) -> None:
    result, count = RESULTS[item]
    write_report(tmp_path / "new" / "page.html", item, evidence(result))
    text = (tmp_path / "new" / "page.html").read_text()
    page = Page(text)
    assert page.all("h1") == [f"{item}, measured from <boards & co>"]
    assert [entry[1:] for entry in page.texts if entry[0] == "li"] == [("good", "as it was"), ("bad", "a < b & c")]
    assert len(page.pictures) == count
    assert all(figure.shape[1] > 300 and figure.std() > 5 for figure in page.pictures)
    (about,) = page.all("p")
    assert about == "Rig york, captured at an unknown time; 2 frames of 32 x 24; stage recipe abc123."
    assert not re.search(r"(src|href)='(?!data:)", text)  # it needs no other file
    assert pyplot().get_fignums() == []


def test_lights_are_marked_and_listed(tmp_path: Path) -> None:
    write_report(tmp_path / "page.html", "lights", evidence(lights(), lights=["C", "L00", "L01", "L02"]))
    page = Page((tmp_path / "page.html").read_text())
    assert page.all("h2") == ["Verdict", "What was detected", "Residuals", "Numbers"]
    assert page.all("th") == ["light", "x", "y", "z", "sigma mm", "off its place mm"]
    # the third has no place, and stands with its direction
    assert page.all("td") == [
        *("L00", "0.00", "0.00", "790.00", "0.50", "1.25"),
        *("L01", "790.00", "0.00", "0.00", "2.00"),
        *("L02", "0.00", "1.00", "0.00"),
    ]  # fmt: skip
    shown = page.pictures[0].reshape(-1, 3)
    for colour in ((0, 255, 0), (255, 165, 0)):  # seen, and cut by the outline
        assert (np.abs(shown.astype(int) - colour).max(axis=1) < 40).any()


def test_two_places_of_a_ball_are_two_figures(tmp_path: Path) -> None:
    single = lights().drop_vars("residual_mm").assign(residual_mm=(("light",), np.full(3, np.nan)))
    two = single.isel(part=[0, 0])
    names = ["L00", "L01", "L02", "L00", "L01", "L02"]
    write_report(tmp_path / "p.html", "lights", evidence(two, lights=names, part=[0, 0, 0, 1, 1, 1]))
    headings = Page((tmp_path / "p.html").read_text()).all("h2")
    assert headings == ["Verdict", "What was detected, place 0", "What was detected, place 1", "Numbers"]


def test_the_reference_camera_is_the_cross_one_where_there_is_one() -> None:
    assert evidence(residuals()).reference == 1
    assert evidence(residuals(), polarisation=["unpolarised"]).reference == 0


def test_an_old_page_stays_where_a_new_one_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "page.html"
    path.write_text("old")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(OSError, match="No space"):
        write_report(path, "polarisers", evidence(RESULTS["polarisers"][0]))
    assert path.read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["page.html"]

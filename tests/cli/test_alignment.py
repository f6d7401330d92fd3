"""The figure of one tracking frame's alignment: what is where on the page, and what is refused."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
import xarray

from tests.conftest import Answer, put_result
from tests.scenes import one_camera_capture

Lightstage = Callable[..., Answer]
LIGHTS = ("X", "C", "Xc", "Y")
HEIGHT, WIDTH = 40, 60
SHIFT = 3
"""Pixels by which X and Xc are off, to the right."""
LEFT, TOP, PANEL = 12, 82, (300, 200)
"""Of the first picture; 60 x 40 is drawn five times as large. The next starts 312 to the right."""
NEXT_ROW = 26 + 20 + 200 + 4 + 97 + 12
UNKNOWN = [70, 30, 90]


def _scene() -> Any:
    """(y, x) constant light: spots on grey."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    scene = np.full((HEIGHT, WIDTH), 0.5)
    for row, column in ((12, 14), (26, 30), (14, 46)):
        scene += 0.5 * np.exp(-((x - column) ** 2 + (y - row) ** 2) / 8)
    return scene


@pytest.fixture
def session(lightstage: Lightstage, tmp_path: Path) -> str:
    """A session without results."""
    folder = one_camera_capture(tmp_path / "head", LIGHTS, frame_rate_hz=60, shape=(HEIGHT, WIDTH))
    assert lightstage("import", folder).code == 0
    return "head"


def results(store: Path, lights: tuple[str, ...] = LIGHTS) -> None:
    """A stack and its alignment, by hand: what moved by SHIFT is put back, and the upper left corner is lost."""
    scene = _scene()
    captured, aligned = [], []
    for name in lights:
        share = {"C": 1.0, "X": 0.75, "Xc": 0.25}.get(name, 0.5)
        captured.append(share * (np.roll(scene, SHIFT, axis=1) if name in ("X", "Xc") else scene))
        aligned.append(share * scene)
    aligned[0][:4, :4] = np.nan
    flow = np.zeros((1, 5, 2, HEIGHT, WIDTH), np.float32)
    flow[0, [lights.index(name) for name in ("X", "Xc") if name in lights], 0] = SHIFT
    flow[0, 4] = np.nan
    confidence = np.ones((1, 5, HEIGHT, WIDTH), np.float32)
    confidence[0, 0, :4, :4] = 0
    confidence[0, 0, :, 20:40] = 0.3  # the spot in the middle is not sure
    confidence[0, 4] = 0
    unfilled = np.full((1, HEIGHT, WIDTH), np.nan)
    labels = {"band": [0.0], "component": np.array(["diffuse"], object)}
    put_result(
        xarray.Dataset(
            {
                "radiance": (
                    ("frame", "band", "component", "y", "x"),
                    np.array(captured, np.float32)[:, None, None],
                )
            },
            {
                "frame": np.arange(4),
                "illumination": ("frame", np.array(lights, object)),
                "time_s": ("frame", np.arange(4) / 60),
                **labels,
            },
        ),
        store,
        "head",
        "stack",
    )
    put_result(
        xarray.Dataset(
            {
                "flow": (("tracking", "member", "xy", "y", "x"), flow),
                "aligned": (
                    ("tracking", "member", "band", "component", "y", "x"),
                    np.concatenate([aligned, unfilled]).astype(np.float32)[None, :, None, None],
                ),
                "confidence": (("tracking", "member", "y", "x"), confidence),
            },
            {
                "tracking": [1],
                "frame": (("tracking", "member"), [[0, 1, 2, 3, -1]]),
                "illumination": (("tracking", "member"), np.array([[*lights, ""]], object)),
                "time_s": ("tracking", [1 / 60]),
                **labels,
            },
            {"engine": "motion"},
        ),
        store,
        "head",
        "align",
    )


@pytest.fixture
def aligned(session: str, tmp_path: Path) -> str:
    results(tmp_path / "store")
    return session


def pixel(page: Any, column: int, row: int, x: int, y: int) -> list[int]:
    """The middle of a pixel of a picture on the page."""
    return [int(v) for v in page[TOP + row * NEXT_ROW + 5 * y + 2, LEFT + column * 312 + 5 * x + 2]]


def test_pictures_before_and_after_stand_below_each_other(
    lightstage: Lightstage, aligned: str, tmp_path: Path
) -> None:
    done = lightstage("alignment", "--session", aligned, "--json")
    assert done.code == 0, done.err
    path = Path(done.json["path"])
    assert path == tmp_path / "store" / "pictures" / "head_alignment_1.png"
    assert list(path.parent.iterdir()) == [path]
    page = imageio.imread(path)
    assert page.shape == (36 + 2 * NEXT_ROW + 26 + 20 + 200 + 60, 4 * 312 + 12, 3)
    # the spot at (14, 12): in X three pixels to the right as captured, at its place once aligned
    assert pixel(page, 0, 0, 14 + SHIFT, 12)[0] > pixel(page, 0, 0, 14 - SHIFT, 12)[0] + 20
    assert pixel(page, 0, 1, 14 - SHIFT, 12) == pixel(page, 0, 1, 14 + SHIFT, 12)
    assert pixel(page, 0, 1, 1, 1) == UNKNOWN
    assert pixel(page, 0, 0, 1, 1) != UNKNOWN
    # a scale of its own for each column: X and Xc look alike although X is three times as bright
    assert np.abs(np.subtract(pixel(page, 0, 1, 50, 35), pixel(page, 2, 1, 50, 35))).max() <= 1


def test_residual_is_that_of_the_pictures(lightstage: Lightstage, aligned: str) -> None:
    answer = lightstage("alignment", "--session", aligned, "--json").json
    scene = _scene()
    known = np.ones(scene.shape, bool)
    known[:4, :4] = False
    expected = np.abs(np.roll(scene, SHIFT, axis=1) - scene)[known].mean() / scene[known].mean()
    assert answer["residual_before"] == pytest.approx(expected, rel=1e-5)
    assert answer["residual_after"] == pytest.approx(0, abs=1e-6)


def test_points_are_where_texture_moves_and_the_flow_is_sure(lightstage: Lightstage, aligned: str) -> None:
    points = lightstage("alignment", "--session", aligned, "--json").json["points"]
    assert 2 <= len(points) <= 3
    for x, y in points:
        assert not 20 <= x < 40
        assert min(np.hypot(x - 14, y - 12), np.hypot(x - 46, y - 14)) < 8
    distance = [np.hypot(*np.subtract(a, b)) for i, a in enumerate(points) for b in points[:i]]
    assert min(distance) >= WIDTH / 8


def test_given_points_are_marked_in_every_picture(lightstage: Lightstage, aligned: str, tmp_path: Path) -> None:
    file = tmp_path / "out" / "figure.png"
    done = lightstage("alignment", "--session", aligned, "--at", "20,10", "--at", "0,39", "--to", file, "--json")
    assert done.code == 0, done.err
    assert done.json["points"] == [[20, 10], [0, 39]]
    page = imageio.imread(file)
    for row in (0, 1):
        for column in range(4):
            # the cross hair of the first is red right of the point, which itself is free
            assert pixel(page, column, row, 22, 10) == [255, 80, 70]
            assert len(set(pixel(page, column, row, 20, 10))) == 1
            assert pixel(page, column, row, 2, 39) == [90, 220, 90]
    again = lightstage("alignment", "--session", aligned, "--at", "20,10", "--at", "0,39", "--to", file)
    assert again.out.strip() == str(file)  # the same is there


@pytest.mark.parametrize("other", [b"another picture", None])
def test_a_file_of_somebody_else_stays(
    lightstage: Lightstage, aligned: str, tmp_path: Path, other: bytes | None
) -> None:
    file = tmp_path / "figure.png"
    if other is None:  # a page with other marks
        lightstage("alignment", "--session", aligned, "--at", "20,10", "--to", file)
    else:
        file.write_bytes(other)
    before = file.read_bytes()
    refused = lightstage("alignment", "--session", aligned, "--at", "5,5", "--to", file)
    assert refused.code == 2
    assert refused.err == (
        f"lightstage: --to {file} is there already and holds something else; remove it, or name another file\n"
    )
    assert file.read_bytes() == before
    assert lightstage("alignment", "--session", aligned, "--at", "5,5").code == 0  # the store's own is drawn anew


def test_flow_is_drawn_from_the_tracking_frame_to_the_picture(
    lightstage: Lightstage, aligned: str, tmp_path: Path
) -> None:
    page = imageio.imread(lightstage("alignment", "--session", aligned, "--json").json["path"]).astype(int)
    top, left = TOP + 2 * NEXT_ROW, LEFT + 3 * 312
    arrows = (page[top : top + 200, left : left + 300] == [255, 210, 60]).all(axis=-1)
    # to the right: from the first, at x = 1, nothing goes left; none where the flow is not sure (20 to 40),
    # beyond what those before it reach
    assert arrows[:, 7:100].any()
    assert not arrows[:, :5].any()
    assert not arrows[:, 5 * 26 : 5 * 39].any()
    assert arrows[:, 5 * 41 :].any()


def test_without_a_pair_there_is_no_residual(lightstage: Lightstage, session: str, tmp_path: Path) -> None:
    results(tmp_path / "store", ("X", "C", "Z", "Y"))
    done = lightstage("alignment", "--session", session, "--json")
    assert done.code == 0, done.err
    assert done.json["residual_before"] is None
    assert done.json["residual_after"] is None
    assert imageio.imread(done.json["path"]).shape[1] == 4 * 312 + 12


def test_a_session_without_alignment_is_told_how_to_get_one(lightstage: Lightstage, session: str) -> None:
    refused = lightstage("alignment", "--session", session)
    assert refused.code == 2
    assert "`lightstage run align --session head`" in refused.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--tracking", "2"), "has no tracking frame 2; it has 1"),
        (("--at", "60,3"), "--at 60,3 is outside the picture; X is 0 to 59 and Y is 0 to 39"),
        (("--at", "3"), "expected X,Y in whole pixels"),
        (("--at", "a,b"), "expected X,Y in whole pixels"),
        (("--at", "1,1", "--at", "1,2", "--at", "1,3", "--at", "1,4"), "at most 3 points"),
        (("--to", "figure.jpg"), "ends in .png"),
    ],
)
def test_wrong_requests_are_one_sentence(
    lightstage: Lightstage, aligned: str, tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    refused = lightstage("alignment", "--session", aligned, *words)
    assert refused.code == 2
    assert said in refused.err
    assert refused.err.count("\n") == 1
    assert not (tmp_path / "store" / "pictures").is_dir() or not any((tmp_path / "store" / "pictures").iterdir())

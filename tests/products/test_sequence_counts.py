"""A graph of images against tracking frames."""

import os
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lightstage.products import sequence_counts
from lightstage.products.figures import pyplot

ROWS = [(n, 4 * n + 3, 3 * n + 2, 3 * n + 2 + (n % 2 == 0)) for n in range(1, 7)]
SAME = [(n, 4 * n + 3, 3 * n + 2, 3 * n + 2) for n in range(1, 7)]


@pytest.mark.parametrize("form", sequence_counts.PICTURES)
def test_every_form_is_a_picture_of_its_kind(tmp_path: Path, form: str) -> None:
    path = tmp_path / "new" / f"count{form}"
    sequence_counts.draw(ROWS, path)
    assert path.read_bytes().startswith({".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}[form])
    assert os.listdir(path.parent) == [path.name]
    assert pyplot().get_fignums() == []


def marks(path: Path) -> int:
    """Marks in a drawing, those of the scale among them: each is one use of a path that is defined once."""
    return len(re.findall(r'<use xlink:href="#m', path.read_text()))


def test_every_row_is_marked_and_the_thesis_where_it_differs(tmp_path: Path) -> None:
    drawings = {}
    for name, rows in (("some", ROWS), ("none", SAME), ("fewer", SAME[:3])):
        sequence_counts.draw(rows, tmp_path / f"{name}.svg")
        drawings[name] = tmp_path / f"{name}.svg"
    # three of the thesis, and the mark of their entry in the legend
    assert marks(drawings["some"]) == marks(drawings["none"]) + 3 + 1
    assert drawings["none"].stat().st_size != drawings["fewer"].stat().st_size


def test_the_lines_are_in_the_picture(tmp_path: Path) -> None:
    sequence_counts.draw(ROWS, tmp_path / "count.png")
    with Image.open(tmp_path / "count.png") as picture:
        assert picture.size == (704, 440)  # 6.4 x 4 inches at 110 dots an inch
        colours = np.asarray(picture.convert("RGB")).reshape(-1, 3)
    for blue_or_orange in ((31, 119, 180), (255, 127, 14)):
        assert (np.abs(colours.astype(int) - blue_or_orange).max(axis=1) < 8).sum() > 100


def test_what_cannot_be_written_leaves_the_old_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "count.png"
    path.write_bytes(b"old")

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", full)
    with pytest.raises(OSError, match="No space"):
        sequence_counts.draw(ROWS, path)
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["count.png"]
    assert pyplot().get_fignums() == []

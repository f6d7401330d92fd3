"""Pictures that the store keeps are drawn when what they show has changed."""

from pathlib import Path

import pytest

from lightstage.api.pictures import keep_picture


def test_a_picture_is_drawn_when_what_it_shows_has_changed(tmp_path: Path) -> None:
    path, drawn = tmp_path / "pictures" / "a.png", []

    def draw(where: Path) -> None:
        drawn.append(where)
        where.write_bytes(b"%d" % len(drawn))

    for results, count in (([Path("r/1")], 1), ([Path("r/1")], 1), ([Path("r/2")], 2), ([Path("r/2")], 2)):
        assert keep_picture(path, results, draw) == path
        assert len(drawn) == count
    path.write_bytes(b"painted over")
    keep_picture(path, [Path("r/2")], draw)
    assert path.read_bytes() == b"3"


def test_a_picture_that_fails_is_drawn_again(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    keep_picture(path, [Path("r/1")], lambda where: where.write_bytes(b"1"))

    def fail(where: Path) -> None:
        raise OSError("full")

    with pytest.raises(OSError, match="full"):
        keep_picture(path, [Path("r/2")], fail)
    keep_picture(path, [Path("r/1")], lambda where: where.write_bytes(b"again"))
    assert path.read_bytes() == b"again"

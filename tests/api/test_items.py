"""Calibration items, and who uses them."""

from pathlib import Path

import pytest

import lightstage
from lightstage.api.items import bind, item_text, item_values, items_of
from lightstage.api.requests import make_request


def homography(folder: Path, shift: float, note: str = "") -> Path:
    path = folder / f"h{shift}{note}.yaml"
    path.write_text(
        f"item: homography\nfrom: CAM0\nto: CAM1\nmatrix: [[1, 0, {shift}], [0, 1, 0], [0, 0, 1]]\n"
        + (f"rig: {note}\n" if note else "")
    )
    return path


def test_binding_says_what_was_bound_before(ball: lightstage.OpenSession, tmp_path: Path) -> None:
    store = ball.opened
    (old,) = [item for item in items_of(store, "ball") if item.kind == "homography"]
    assert old.values["matrix"][0][2] == -1
    bound = bind(ball.read(), homography(tmp_path, 2.5), store)
    assert (bound.kind, bound.before, bound.changed) == ("homography", old.digest, True)
    (new,) = [item for item in items_of(store, "ball") if item.kind == "homography"]
    assert (new.name, new.values["matrix"][0][2], new.sessions) == (bound.item, 2.5, ("ball",))
    # the same numbers from another file are the same item
    again = bind(ball.read(), homography(tmp_path, 2.5, "york"), store)
    assert (again.item, again.before, again.changed) == (bound.item, new.digest, False)
    back = bind(ball.read(), old.name, store)
    assert (back.item, back.before) == (old.name, new.digest)
    assert {item.name for item in items_of(store)} >= {old.name, new.name}


def test_what_is_no_item_is_refused(ball: lightstage.OpenSession, tmp_path: Path) -> None:
    for item, sentence in (
        (tmp_path / "no.yaml", "no.yaml is missing: expected a calibration item"),
        ("homograpy", "no calibration item"),
    ):
        before = ball.items
        with pytest.raises(lightstage.RequestError, match=sentence):
            bind(ball.read(), item, ball.opened)
        assert ball.items == before


def test_an_item_is_found_by_the_beginning_of_its_name(finished: lightstage.OpenSession) -> None:
    item, text = item_text(finished.opened, "homography")
    assert "matrix" in text
    assert item.path.read_text() == text
    assert item_text(finished.opened, item.name[:15])[0] == item


def test_the_values_are_those_that_the_request_is_answered_with(
    ball: lightstage.OpenSession, tmp_path: Path
) -> None:
    values = item_values(make_request("ball"), ball.opened)
    assert values["homography"]["matrix"][0][2] == -1
    assert values["bands"]["bands"][0]["exposure"] == 3
    own = make_request("ball", items={"homography": homography(tmp_path, 7.0)})
    assert item_values(own, ball.opened)["homography"]["matrix"][0][2] == 7
    assert item_values(make_request("ball"), ball.opened) == values

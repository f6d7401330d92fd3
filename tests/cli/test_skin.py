"""lightstage skin: from a session to maps, a sheet and a table of spectra."""

import csv
from collections.abc import Callable
from typing import Any

import cv2


def test_skin_of_the_virtual_rig(lightstage: Callable[..., Any]) -> None:
    assert lightstage("demo", "--size", "96x72", "--session", "small").code == 0
    done = lightstage("skin", "small", "--at", "48,30", "--json")
    assert done.code == 0, done.err
    for name in ("picture", "spectra"):
        assert cv2.imread(done.json[name]).std() > 10
    with open(done.json["table"], newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    given = next(point for point in done.json["points"] if point["at"] == [48, 30])
    assert all(0 < value < 1 for value in given["reflectance"])
    assert given["reflectance"][-1] > 1.5 * given["reflectance"][0]  # skin is redder than it is blue
    assert {row["band_nm"] for row in rows} == {"407", "434", "445", "497", "576", "655"}
    outside = lightstage("skin", "small", "--at", "500,30")
    assert (outside.code, "--at 500,30 is outside the picture" in outside.err) == (2, True)
    assert "nothing is known of the reflectance there" in lightstage("skin", "small", "--at", "1,1").err


def test_one_band_has_no_pigments(lightstage: Callable[..., Any]) -> None:
    assert lightstage("demo", "--size", "96x72", "--bands", "576", "--session", "one").code == 0
    done = lightstage("skin", "one")
    assert done.code == 2
    assert "needs three or more filtered bands" in done.err

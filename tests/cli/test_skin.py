"""lightstage skin: from a session to maps, a sheet and a table of spectra."""

import csv
from collections.abc import Callable
from typing import Any

import cv2


def test_skin_of_the_virtual_rig(lightstage: Callable[..., Any]) -> None:
    assert lightstage("demo", "--size", "96x72", "--session", "small").code == 0
    done = lightstage("skin", "small", "--at", "48,30", "--json")
    assert done.code == 0, done.err
    picture = cv2.imread(done.json["picture"])
    assert picture is not None
    assert picture.std() > 10
    with open(done.json["spectra"], newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["band_nm"] for row in rows] == ["407", "434", "445", "497", "576", "655"]
    values = [float(row["reflectance"]) for row in rows]
    assert all(0 < value < 1 for value in values)
    assert values[-1] > 1.5 * values[0]  # skin is redder than it is blue
    assert all(0 < float(row["standard_error"]) < 0.05 for row in rows)
    outside = lightstage("skin", "small", "--at", "500,30")
    assert (outside.code, "--at 500,30 is outside the picture" in outside.err) == (2, True)
    assert "no reflectance is known there" in lightstage("skin", "small", "--at", "1,1").err


def test_one_band_has_no_pigments(lightstage: Callable[..., Any]) -> None:
    assert lightstage("demo", "--size", "96x72", "--bands", "576", "--session", "one").code == 0
    done = lightstage("skin", "one")
    assert done.code == 2
    assert "needs three or more filtered bands" in done.err

"""run, normals, performance: what is computed, said and shown."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import xarray

from tests.cli.conftest import Lightstage, check_refusal
from tests.scenes import one_camera_capture, write_capture


def test_the_main_job_ends_with_a_picture(lightstage: Lightstage, sphere: Path) -> None:
    done = lightstage("normals", sphere)
    assert done.code == 0, done.err
    path = Path(done.out.strip().splitlines()[-1].removeprefix("picture: "))
    sheet = cv2.imread(str(path))
    assert sheet is not None
    assert sheet.shape[1] > 3 * sheet.shape[0]
    before = path.stat().st_mtime_ns
    assert lightstage("normals", "ball", "--json").json["picture"] == str(path)
    assert path.stat().st_mtime_ns == before  # nothing to draw anew


def test_items_of_another_rig_or_of_later_are_refused(lightstage: Lightstage, tmp_path: Path) -> None:
    folder = one_camera_capture(tmp_path / "c", ["C", "X", "Y", "Z"], rig="york", captured="2010-03-12T14:05:00")
    lightstage("import", folder)
    bands = tmp_path / "bands.yaml"
    bands.write_text("item: bands\nrig: leeds\nbands: [{centre_nm: 0, exposure: 2}]\n")
    done = lightstage("run", "--session", "c", "--calibration", f"bands={bands}")
    assert done.code == 2
    assert "measured on the rig 'leeds', the session is of 'york'" in done.err
    bands.write_text("item: bands\nvalid_from: 2011-01-01\nbands: [{centre_nm: 0, exposure: 2}]\n")
    assert "valid from 2011-01-01" in lightstage("run", "--session", "c", "--calibration", f"bands={bands}").err


def test_one_camera_sessions_say_what_cannot_be_made(lightstage: Lightstage, tmp_path: Path) -> None:
    lightstage("import", one_camera_capture(tmp_path / "cross", ["C", "X", "Y", "Z"]))
    done = lightstage("run", "--session", "cross")
    assert "split: cannot be made: specular: needs the parallel camera" in done.out
    assert "normals: method: ratio" in done.out
    refused = lightstage("run", "--session", "cross", "--set", "normals.component=specular")
    assert refused.code == 2
    assert "needs the parallel camera" in refused.err
    lightstage("import", one_camera_capture(tmp_path / "plain", ["C", "X", "Y", "Z"], polarisation="unpolarised"))
    assert "normals are of the total light" in lightstage("run", "--session", "plain").out


def test_a_picture_of_odd_size_goes_all_the_way(lightstage: Lightstage, tmp_path: Path) -> None:
    """Element counts that are no multiple of 8 take another codec."""
    generator = np.random.default_rng(0)
    pictures = {(i, 0, "cross"): generator.integers(1, 255, (7, 9)).astype(np.uint8) for i in range(4)}
    folder = write_capture(tmp_path / "odd", pictures, illumination=["C", "X", "Y", "Z"], bits=8)
    lightstage("import", folder)
    assert lightstage("run", "--session", "odd").code == 0
    path = lightstage("path", "register", "--session", "odd").out.strip()
    raw = xarray.open_zarr(path, chunks=None).signal.values[2, 0, 0]
    np.testing.assert_array_equal(raw, pictures[2, 0, "cross"])


def test_a_dry_run_says_what_would_be_computed_and_computes_nothing(lightstage: Lightstage, standing: Path) -> None:
    before = sorted(path for path in standing.rglob("*"))
    done = lightstage(
        "run",
        "normals",
        "--session",
        "ball",
        "--set",
        "normals.method=ratio",
        "--dry-run",
        "--json",
        store=standing,
    )
    nodes = done.json["nodes"]
    assert nodes["stack"] == {"compute": 0, "check": 0, "reuse": 7}
    assert nodes["normals"] == {"compute": 1, "check": 0, "reuse": 0}
    assert sorted(path for path in standing.rglob("*")) == before


def test_a_run_says_its_nodes_once_and_remembers_them(lightstage: Lightstage, standing: Path) -> None:
    done = lightstage("run", "normals", "--session", "ball", "--json", store=standing)
    assert list(done.json["nodes"]) == ["register", "split", "stack", "align", "normals"]
    assert {node["computed"] for node in done.json["nodes"].values()} == {0}
    assert done.json["nodes"]["register"]["reused"] == 7
    plain = lightstage("run", "normals", "--session", "ball", store=standing).out.splitlines()
    assert plain[0].split() == ["node", "computed", "reused", "seconds", "size"]
    assert plain[-1].endswith(done.json["nodes"]["normals"]["path"])


def test_a_still_subject_performs_not(lightstage: Lightstage, standing: Path) -> None:
    check_refusal(lightstage("performance", "ball", store=standing), "session 'ball' is static")


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("run", "--session", "bal"), "no session 'bal' in the store"),
        (("run", "normal", "--session", "ball"), "no node 'normal'; did you mean 'normals'"),
        (("run", "--session", "ball", "--frames", "3:1"), "expected A:B"),
        (("run", "--session", "ball", "--frames", "0:9"), "session 'ball' has frames 0:7"),
        (("run", "--session", "ball", "--workers", "0"), "at least one process"),
        (("run", "--session", "ball", "--pipeline", "no.yaml"), "no.yaml is missing"),
        (
            ("run", "--session", "ball", "--set", "normals.method=least_squares"),
            "at least three one-light pictures",
        ),
        (("run", "--session", "ball", "--calibration", "homografy=x"), "did you mean 'homography'"),
        (("run", "--session", "ball", "--calibration", "dark=nothing.yaml"), "nothing.yaml is missing"),
        (("normals", "nowhere"), "neither a session"),
    ],
)
def test_a_wrong_request_is_one_sentence(
    lightstage: Lightstage, standing: Path, words: tuple[str, ...], part: str
) -> None:
    check_refusal(lightstage(*words, store=standing), part)

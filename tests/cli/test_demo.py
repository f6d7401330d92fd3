"""demo: a capture of the virtual rig, its session and its truth."""

from pathlib import Path

import numpy as np
import pytest
import xarray

from tests.cli.conftest import Lightstage, check_refusal


def test_the_demo_runs_and_keeps_its_truth(lightstage: Lightstage, tmp_path: Path) -> None:
    done = lightstage("demo", "--size", "64x48", "--bands", "576", "--session", "d", "--json")
    assert done.code == 0, done.err
    truth = Path(done.json["truth"]) / "ground_truth_cam1.npz"
    assert np.load(truth)["normal"].shape == (48, 64, 3)
    assert lightstage("run", "--session", "d").code == 0
    before = sorted(p.name for p in (tmp_path / "store" / "captures").iterdir())
    lightstage("demo", "--size", "64x48", "--bands", "576", "--session", "d")
    assert sorted(p.name for p in (tmp_path / "store" / "captures").iterdir()) == before


@pytest.mark.slow
def test_a_performance_runs_and_motion_spoils_normals_that_are_not_aligned(lightstage: Lightstage) -> None:
    """The same head, cycle and noise; what the motion adds is that the four gradients of a set show four poses."""
    errors = {}
    for motion in ("still", "fast"):
        made = lightstage(
            *("demo", "--sequence", "minimal", "--tracking", "1", "--size", "120x92"),
            *("--motion", motion, "--session", motion, "--json"),
        )
        assert made.code == 0, made.err
        assert lightstage("run", "--session", motion).code == 0
        path = lightstage("path", "normals", "--session", motion).out.strip()
        with xarray.open_zarr(path, chunks=None) as found:
            assert list(found.tracking.values) == [2]
            normal = np.moveaxis(found.normal.values[0, 0], 0, -1)
        with np.load(Path(made.json["truth"]) / "gt_t02.npz") as truth:
            cosine = np.sum(normal * truth["normal"], axis=-1)[truth["mask"]]
        errors[motion] = np.degrees(np.nanmean(np.arccos(np.clip(cosine, -1, 1))))
    assert errors["still"] < 15
    assert errors["fast"] > errors["still"] + 1


@pytest.mark.slow
def test_another_capture_takes_the_truth_of_the_one_before_away(lightstage: Lightstage) -> None:
    small = ("demo", "--size", "64x48", "--session", "d", "--json")
    made = lightstage(*small, "--bands", "576")
    again = lightstage(*small, "--sequence", "minimal", "--tracking", "1", "--motion", "still")
    assert made.json["truth"] == again.json["truth"]
    names = {path.name for path in Path(again.json["truth"]).iterdir()}
    assert names == {"meta.yaml", *(f"{kind}_t{t:02d}.npz" for kind in ("gt", "flow") for t in range(5))}


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("--size", "big"), "expected WIDTHxHEIGHT"),
        (("--bands", "20"), "390 to 760 nm"),
        (("--bands", "434,434"), "a wavelength stands twice"),
        (("--bands", "blue"), "expected wavelengths in nm"),
        (("--session", "../x"), "a name has"),
        (("--tracking", "3"), "only a performance has it"),
        (("--motion", "fast"), "only a performance has it"),
        (("--sequence", "wilson", "--tracking", "0"), "a performance has 1 to 5000"),
        (("--sequence", "wilson", "--bands", "434,576"), "a performance has one band"),
        (("--sequence", "wilson", "--target", "ball"), "does not perform"),
    ],
)
def test_a_wrong_request_is_one_sentence(lightstage: Lightstage, words: tuple[str, ...], part: str) -> None:
    check_refusal(lightstage("demo", *words), part)

"""lightstage stimuli: what is in the folder, read back by programs of others; and what is refused."""

import csv
import hashlib
import json
import os
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from lightstage.cli.main import main
from lightstage.products.stimulus_folder import COLUMNS
from tests.conftest import Answer
from tests.readers import chunks

pytestmark = pytest.mark.slow

Lightstage = Callable[..., Answer]
SUBJECTS = ("one", "two")
QUICK = ("--set", "relief.correct=lights")
"""Near lights and shadows take most of the time, and nothing here is about how good the normals are."""


@pytest.fixture(scope="module")
def heads(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store with two small heads of the virtual rig, their stimuli computed."""
    store = tmp_path_factory.mktemp("heads") / "store"
    for seed, name in enumerate(SUBJECTS, start=1):
        words = ["demo", "--session", name, "--seed", str(seed), "--size", "204x156", "--bands", "434,576,655"]
        assert main(["--store", str(store), *words]) == 0
    return store


@pytest.fixture
def made(heads: Path, lightstage: Lightstage, tmp_path: Path) -> Callable[..., tuple[Answer, Path]]:
    """The command on those heads, and the folder it was to write; eyes are given unless a test finds them."""
    eyes = tmp_path / "eyes.yaml"
    eyes.write_text("".join(f"{name}: {{left_eye: [84, 68], right_eye: [120, 68]}}\n" for name in SUBJECTS))

    def call(*words: str, folder: str = "set", find: bool = False) -> tuple[Answer, Path]:
        to = tmp_path / folder
        where = [] if find or "--points" in words else ["--points", eyes]
        return lightstage("stimuli", *SUBJECTS, "--to", to, *QUICK, *where, *words, "--json", store=heads), to

    return call


def linear(codes: Any) -> Any:
    """Luminance 0..255 of an sRGB picture (IEC 61966-2-1, written out here)."""
    c = codes.astype(float) / 255
    light = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    return 255 * (light @ [0.2126, 0.7152, 0.0722] if light.ndim == 3 else light)


def read(folder: Path) -> list[dict[str, str]]:
    with (folder / "stimuli.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_the_table_says_what_the_pictures_hold(made: Any) -> None:
    done, folder = made()
    assert done.code == 0, done.err
    rows = read(folder)
    assert tuple(rows[0]) == COLUMNS
    assert {(row["subject"], row["kind"]) for row in rows} == {
        (s, k) for s in SUBJECTS for k in ("shape", "texture", "both")
    }
    whole = []
    for row in rows:
        file = folder / row["file"]
        assert hashlib.sha256(file.read_bytes()).hexdigest() == row["digest"]
        picture = np.asarray(Image.open(file))
        assert picture.shape == (int(row["height_px"]), int(row["width_px"]), 3)
        whole.append(linear(picture))
        # 57 cm away a centimetre is one degree, nearly
        assert float(row["width_deg"]) == pytest.approx(int(row["width_px"]) / 37.8, rel=0.01)
        assert float(row["rms"]) == pytest.approx(
            float(row["contrast_linear"]) / float(row["mean_linear"]), rel=1e-3
        )
    # the oval is part of the picture, so what is equal over it is equal over the whole
    assert np.ptp([p.mean() for p in whole]) < 0.5
    assert np.ptp([p.std() for p in whole]) < 0.5
    assert json.loads((folder / "recipe.json").read_text())["digest"] == rows[0]["recipe"]


def test_pictures_say_their_colour(made: Any) -> None:
    """Read by Pillow and chunk by chunk; 16 bits hold the same picture, linear."""
    done, folder = made()
    assert done.code == 0, done.err
    for row in read(folder):
        with Image.open(folder / row["file"]) as opened:
            info, coarse = opened.info, np.asarray(opened)
        assert info["srgb"] == 1
        assert info["gamma"] == pytest.approx(1 / 2.2, abs=1e-5)
        fine = (folder / row["file_16bit"]).read_bytes()
        said = dict(chunks(fine))
        assert said[b"gAMA"] == struct.pack(">I", 100000)
        assert b"sRGB" not in said
        assert said[b"IHDR"][8] == 16
        deep = cv2.imread(str(folder / row["file_16bit"]), cv2.IMREAD_UNCHANGED)[..., ::-1]
        assert deep.dtype == np.uint16
        # a code value of sRGB is up to 2.3 grey levels of linear light wide, at white; rounding is half of it
        np.testing.assert_allclose(linear(coarse), deep / 257 @ [0.2126, 0.7152, 0.0722], atol=1.15)


def test_what_does_not_fit_is_named_with_its_part(made: Any) -> None:
    done, folder = made("--kinds", "shape", "--match", "spectrum", "--mean", "0.9", "--contrast", "0.3")
    assert done.code == 0, done.err
    for row in read(folder):
        part = float(row["clipped"])
        picture = np.asarray(Image.open(folder / row["file"]))
        assert part > 0.05
        assert np.count_nonzero((picture == 0) | (picture == 255)) / 3 > 0.02 * picture.shape[0] * picture.shape[1]
        assert f"{row['file']} ({100 * part:.2g} %)" in done.err
    assert "grey levels only, not to 0.5" in done.err


def test_conditions_for_experiments(made: Any) -> None:
    done, folder = made("--grey", "--match", "histogram")
    assert done.code == 0, done.err
    with (folder / "conditions.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert all(name.isidentifier() for name in rows[0])
    assert all((folder / row["file"]).is_file() for row in rows)
    script = (folder / "stimuli.js").read_text()
    told = json.loads(script.removeprefix("const stimuli = ").rstrip().removesuffix(";"))
    assert [{k: str(v) for k, v in one.items()} for one in told] == rows
    first, *others = (np.asarray(Image.open(folder / row["file"])) for row in rows)
    assert first.ndim == 2
    for other in others:
        np.testing.assert_array_equal(np.bincount(other.ravel()), np.bincount(first.ravel()))


READ_BY_PSYCHOPY = """
import json, sys
from psychopy import data
rows, names = data.importConditions(sys.argv[1], returnFieldNames=True)
trials = data.TrialHandler(rows, 1, "sequential")
print("FOUND", json.dumps([list(names), [str(trial["file"]) for trial in trials]]))
"""


def test_psychopy_reads_the_conditions(made: Any) -> None:
    """By its own reader, in this Python or the one that LIGHTSTAGE_PSYCHOPY names."""
    python = os.environ.get("LIGHTSTAGE_PSYCHOPY", sys.executable)
    if subprocess.run([python, "-c", "import psychopy.data"], capture_output=True, timeout=120).returncode:
        pytest.skip("PsychoPy is not installed; LIGHTSTAGE_PSYCHOPY may name a Python that has it")
    done, folder = made()
    assert done.code == 0, done.err
    command = [python, "-c", READ_BY_PSYCHOPY, str(folder / "conditions.csv")]
    said = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout
    names, files = json.loads(said.rpartition("FOUND ")[2])
    assert names[:3] == ["subject", "kind", "file"]
    assert files == [row["file"] for row in read(folder)]


def test_the_page_loads_in_a_browser(made: Any, tmp_path: Path) -> None:
    """Without jsPsych it shows every picture; with a local copy (LIGHTSTAGE_JSPSYCH) it runs to its end."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium is installed")
    local = os.environ.get("LIGHTSTAGE_JSPSYCH")
    done, folder = made(*(["--jspsych", local] if local else []))
    assert done.code == 0, done.err
    page = f"{(folder / 'experiment.html').as_uri()}?simulate"
    command = [browser, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'browser'}"]
    command += ["--allow-file-access-from-files", "--host-resolver-rules=MAP * ~NOTFOUND"]
    command += ["--virtual-time-budget=60000", "--dump-dom", page]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=120).stdout
    body = shown.rpartition("</script>")[2]
    assert ("jspsych-data-display" in shown) == bool(local)
    for row in read(folder):
        assert row["file"] in body


@pytest.mark.parametrize("layout", ["release", "npm"])
def test_jspsych_is_copied_from_its_release_or_from_npm(made: Any, tmp_path: Path, layout: str) -> None:
    source = tmp_path / layout
    modules = source / "node_modules"
    places = {
        "release": [source / name for name in ("jspsych.css", "jspsych.js", "plugin-image-keyboard-response.js")],
        "npm": [
            modules / "jspsych" / "css" / "jspsych.css",
            modules / "jspsych" / "dist" / "index.browser.min.js",
            modules / "@jspsych" / "plugin-image-keyboard-response" / "dist" / "index.browser.min.js",
        ],
    }[layout]
    for place in places:
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(place.name)
    done, folder = made("--kinds", "shape", "--jspsych", str(source))
    assert done.code == 0, done.err
    page = (folder / "experiment.html").read_text()
    assert "unpkg" not in page
    for name in ("jspsych.css", "jspsych.js", "plugin-image-keyboard-response.js"):
        assert (folder / "jspsych" / name).is_file()
        assert f"jspsych/{name}" in page


def test_a_morph_varies_one_and_keeps_the_other(made: Any) -> None:
    words = ("--morph", *SUBJECTS, "--levels", "0,0.5,1", "--match", "none", "--grey", "--encoding", "linear")
    done, folder = made(*words, "--vary", "texture")
    assert done.code == 0, done.err

    def picture(level: int, kind: str) -> Any:
        name = f"16bit/one-two-texture-{level:03d}_{kind}.png"
        return cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED).astype(float)

    np.testing.assert_array_equal(picture(0, "shape"), picture(100, "shape"))
    half = (picture(0, "texture") + picture(100, "texture")) / 2
    # without match textures mix linearly; a face alone, because the background is the mean of its own set
    inner = np.s_[half.shape[0] // 3 : half.shape[0] // 2, half.shape[1] // 3 : half.shape[1] // 2]
    np.testing.assert_allclose(picture(50, "texture")[inner], half[inner], atol=2)
    assert np.abs(picture(0, "texture") - picture(100, "texture"))[inner].max() > 500


def test_a_morph_of_shape_keeps_the_texture_and_starts_and_ends_at_the_faces(made: Any) -> None:
    words = ("--match", "none", "--grey", "--encoding", "linear", "--background", "0.4")
    morphed, folder = made(
        "--morph", *SUBJECTS, "--levels", "0,0.5,1", "--kinds", "shape,texture", *words, find=True
    )
    assert morphed.code == 0, morphed.err
    plain, own = made("--kinds", "shape,texture", *words, folder="own", find=True)
    assert plain.code == 0, plain.err

    def picture(at: Path, name: str) -> Any:
        return cv2.imread(str(at / "16bit" / f"{name}.png"), cv2.IMREAD_UNCHANGED).astype(float) / 65535

    inner = picture(own, "one_shape").shape[0] // 6
    inner = np.s_[inner:-inner, inner:-inner]
    ends = [picture(own, f"{name}_shape")[inner] for name in SUBJECTS]
    levels = [picture(folder, f"one-two-shape-{level:03d}_shape")[inner] for level in (0, 50, 100)]
    # a morph shades normals that were brought to the frame, a set brings shaded pictures: edges differ a little
    apart = np.abs(ends[0] - ends[1]).mean()
    assert np.abs(levels[0] - ends[0]).mean() < 0.03 * apart
    assert np.abs(levels[2] - ends[1]).mean() < 0.1 * apart
    assert 0.3 * apart < np.abs(levels[1] - ends[0]).mean() < 0.9 * apart
    # a bent texture has the values of the first one's, not those of the other's; bending shows other parts of it
    texture = [np.median(picture(own, f"{name}_texture")[inner]) for name in SUBJECTS]
    last = np.median(picture(folder, "one-two-shape-100_texture")[inner])
    assert abs(texture[0] - texture[1]) > 0.02
    assert last == pytest.approx(texture[0], abs=0.25 * abs(texture[0] - texture[1]))


def test_the_same_set_is_not_written_twice_and_nothing_is_overwritten(made: Any) -> None:
    first, folder = made("--kinds", "shape")
    assert first.code == 0, first.err
    stamp = (folder / "stimuli.csv").stat().st_mtime_ns
    again, _ = made("--kinds", "shape")
    assert again.code == 0
    assert (folder / "stimuli.csv").stat().st_mtime_ns == stamp
    other, _ = made("--kinds", "shape", "--grey")
    assert other.code == 2
    assert "something is there already" in other.err
    assert not list(folder.parent.glob(".set.part*"))


def test_points_by_hand_decide_the_frame(made: Any, tmp_path: Path) -> None:
    points = tmp_path / "points.yaml"
    points.write_text(
        "one: {left_eye: [84, 68], right_eye: [119, 68]}\ntwo: {left_eye: [83, 68], right_eye: [120, 69]}\n"
    )
    done, folder = made("--points", str(points), "--kinds", "shape")
    assert done.code == 0, done.err
    assert "mean head" not in done.err
    recipe = json.loads((folder / "recipe.json").read_text())
    assert recipe["eyes_px"] == 36
    assert {one["points"] for one in recipe["sessions"].values()} == {"given"}


def test_points_that_were_found_can_be_given_back(made: Any, heads: Path, lightstage: Lightstage) -> None:
    done, folder = made("--kinds", "shape", "--match", "none", find=True)
    assert done.code == 0, done.err
    assert "mean head" in done.err
    words = ("--kinds", "shape", "--match", "none", "--points", folder / "points.yaml", "--to", folder.parent / "2")
    again = lightstage("stimuli", *SUBJECTS, *QUICK, *words, store=heads)
    assert again.code == 0, again.err
    for row in read(folder):
        one, other = (np.asarray(Image.open(at / row["file"])).astype(int) for at in (folder, folder.parent / "2"))
        # points are written to a hundredth of a pixel
        assert np.abs(one - other).max() <= 2


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("one: {left_eye: [1, 2]}", "needs left_eye and right_eye"),
        ("one: {left_eye: [90, 2], right_eye: [10, 2]}", "at the left of the picture"),
        ("one: {left_eye: [a, 2], right_eye: [10, 2]}", "expected [x, y] in pixels"),
        ("one: {left_eye: [1, 2], right_eye: [210, 2]}", "outside the picture of 204 x 156"),
        ("- one", "expected sessions"),
        ("on: {left_eye: [1, 2], right_eye: [10, 2]}", "and of none of the sessions"),
        ("".join(f"{s}: {{left_eye: [80, 70], right_eye: [81, 70]}}\n" for s in SUBJECTS), "1.0 pixels apart"),
    ],
)
def test_wrong_points_are_named(made: Any, tmp_path: Path, text: str, says: str) -> None:
    points = tmp_path / "points.yaml"
    points.write_text(text + "\n")
    done, folder = made("--points", str(points))
    assert done.code == 2
    assert says in done.err
    assert not folder.exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--match", "mode"), "'mode' is not known"),
        (("--match", "none,histogram"), "none stands alone"),
        (("--kinds", "shapes"), "did you mean 'shape'"),
        (("--mean", "3"), "expected a number above 0"),
        (("--kinds", "shape,shape"), "stands twice"),
        (("--levels", "0,2"), "numbers from 0 to 1"),
        (("--levels", "0.501,0.502"), "differ by 0.01"),
        (("--morph", "one", "three"), "'three' is not among the sessions"),
        (("--morph", "one", "one"), "named twice"),
        (("--jspsych", "/nowhere"), "is no copy of jsPsych"),
        (("--set", "stimulus.lights=0,0"), "expected azimuth,elevation,strength"),
    ],
)
def test_wrong_requests_are_named(made: Any, words: tuple[str, ...], says: str) -> None:
    done, folder = made(*words)
    assert done.code == 2, done.err
    assert says in done.err
    assert not folder.exists()


def test_a_sheet_of_lights(heads: Path, lightstage: Lightstage, tmp_path: Path) -> None:
    done = lightstage(
        "stimuli", "one", *QUICK, "--preview-lights", "--to", tmp_path / "sheet", "--json", store=heads
    )
    assert done.code == 0, done.err
    (file,) = done.json["pictures"]
    assert np.asarray(Image.open(file)).std() > 20
    words = ("stimuli", "one", *QUICK, "--preview-lights", "--to", tmp_path / "sheet")
    assert lightstage(*words, store=heads).code == 0  # the same is there
    Path(file).write_bytes(b"somebody else's")
    refused = lightstage(*words, store=heads)
    assert refused.code == 2
    assert refused.err.endswith(
        f"--to {file} is there already and holds something else; remove it, or name another file\n"
    )
    assert Path(file).read_bytes() == b"somebody else's"

"""Hostile and odd input: each is one sentence and an exit code, at once, and nothing is left behind."""

import contextlib
import errno
import json
import os
import random
import re
import resource
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import yaml

from lightstage.api.face_points import read_points
from lightstage.cli.main import main
from lightstage.dag.stage import CalibrationPicture
from lightstage.hw.sequence import period
from lightstage.kernels.errors import KernelError
from lightstage.store import document
from lightstage.store.calibration import KINDS
from lightstage.store.capture import CaptureFile
from lightstage.store.errors import MOST_PROBLEMS, RequestError
from lightstage.store.root import Store
from tests.conftest import REPOSITORY, Answer
from tests.hostile import Ground, answered, spoil

Lightstage = Callable[..., Answer]
CAPTURE = """\
format: lightstage-capture/1
session: a
bits: 10
cameras: {cross: CAM1}
bands_nm: [0]
files: "{frame}.png"
frames: [{illumination: C}]
"""


def refused(text: str) -> str:
    with pytest.raises(RequestError) as caught:
        document.parse(text, name="f")
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 100_000, "f:1:65: lists and keys lie more than 64 deep in each other"),
        ("[\n" * 100_000, "f:65:1: lists and keys lie more than 64 deep"),
        ("- " * 100_000, "more than 64 deep"),
        ("{a: " * 900 + "1" + "}" * 900, "more than 64 deep"),
        ("{" * 100_000, "f:1:2: a key must be plain text"),
        ("? [1]\n: 2", "a key must be plain text"),
        ("&a [*a]", "f:1:1: the anchor &a is not read here; write out what it stands for"),
        ("a: *b", "f:1:4: the alias *b is not read here"),
        ("a: &x [1]\nb: [*x, *x]", "the anchor &x"),
        ("a: 1e999", "f:1:4: the number 1e999 is larger than 1e+15, which is the most"),
        ("a: [-1e16]", "the number -1e16 is larger"),
        ("a: " + "9" * 5000, "(5000 characters) is larger than 1e+15"),
        ("a: !!python/name:os.system x", "the tag tag:yaml.org,2002:python/name:os.system is not known"),
        (
            "a: !!python/object/apply:os.system [ls]",
            "the tag tag:yaml.org,2002:python/object/apply:os.system is not",
        ),
        ("!x {a: 1}", "f:1:1: the tag !x is not known"),
        ("!!seq [1]", "the tag tag:yaml.org,2002:seq is not known"),
        ('a: "b\\0c"', "f:1:4: text with a NUL character"),
        ("a: \0", "not valid YAML"),
        ("a: \udcff", "not valid YAML"),
        ("a: 1\n---\nb: 2", "f:2:1: a second document begins"),
        ("[" + "[]," * 600_000 + "]", "more than 500,000 values in one file"),
    ],
    ids=lambda value: value[:20] if isinstance(value, str) else None,
)
def test_a_document_is_refused_at_its_place(text: str, said: str) -> None:
    assert said in refused(text)


def test_a_problem_in_every_value_is_told_of_twenty_times() -> None:
    assert len(refused("{" + "k: 1," * 10_000 + "}").splitlines()) == MOST_PROBLEMS + 1
    source = document.parse(CAPTURE.replace("[{illumination: C}]", "[" + "1," * 10_000 + "]"), name="f")
    with pytest.raises(RequestError) as caught:
        document.check(source, CaptureFile)
    lines = str(caught.value).splitlines()
    assert len(lines) == MOST_PROBLEMS + 1
    assert lines[0] == "f:7:10: frames.0: keys with values are expected, found 1"
    assert lines[-1].endswith(f"... and {10_000 - MOST_PROBLEMS} more problems")


def test_what_is_large_and_right_is_read() -> None:
    text = "0" * 5000 + "17"
    assert document.scalar(text) == 17
    assert document.scalar("-" + text) == -17
    assert document.scalar("[1e15, -1e15, 1e-300]") == (1e15, -1e15, 1e-300)
    value = document.parse("[" * 64 + "]" * 64, name="f").value
    for _ in range(63):
        (value,) = value
    assert value == ()


def test_a_file_is_read_up_to_its_limit_and_only_if_it_is_one(tmp_path: Path) -> None:
    large = tmp_path / "large.yaml"
    with large.open("wb") as file:
        file.truncate(document.MOST_BYTES + 1)
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    around = tmp_path / "around.yaml"
    around.symlink_to(around)
    for path, said in (
        (large, "more than the 10000000 that it may have: expected a pipeline"),
        (pipe, "is a pipe, and no file: expected a pipeline"),
        (tmp_path, "is a folder, and no file"),
        (Path("/dev/zero"), "is a device, and no file"),
        (around, "cannot be read"),
        (tmp_path / ("x" * 5000), "cannot be read (File name too long)"),
        (tmp_path / "a\0b", "is no name that a file can have"),
        (large / "inside.yaml", "is missing: expected a pipeline"),
    ):
        with pytest.raises(RequestError) as caught:
            document.load(path, what="a pipeline")
        assert said in str(caught.value)


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ("{kind: dark, dark: 1}", "f:8:22: unknown key 'dark'; known are kind, reflectance"),
        ("{kind: flat, flat: {flat: 1}}", "f:8:22: unknown key 'flat'; known are kind, reflectance"),
        ("{kind: dark, str: 1}", "f:8:22: unknown key 'str'; known are kind, reflectance"),
        ("{kind: white, '[': 1}", "f:8:23: unknown key '['; known are kind, reflectance"),
        ("{kind: mirror_ball, radius: 1}", "f:8:29: unknown key 'radius'; did you mean 'radius_mm'?"),
        ("{kind: checkerboard, square: 1}", "unknown key 'square'; did you mean 'square_mm'?"),
        ("{kind: white, reflectance: [1, x]}", "f:8:40: target.reflectance.1: a number is expected, found 'x'"),
        ("{kind: dork}", "'dork'"),
        ("{}", "f:8:1: target: keys with values are expected, among them 'kind'"),
        ("3", "f:8:1: target: keys with values are expected, found 3"),
    ],
)
def test_a_key_may_have_the_name_of_a_branch(target: str, said: str) -> None:
    source = document.parse(CAPTURE + f"target: {target}", name="f")
    with pytest.raises(RequestError) as caught:
        document.check(source, CaptureFile)
    assert said in str(caught.value)


@pytest.mark.parametrize("key", ["dark", "flat", "str", "int", "float", "bool", "[", "a[b]", "", "mirror_ball"])
def test_an_unknown_key_is_named_whatever_it_is(key: str) -> None:
    for inside, at in (("", ""), ("mount: {CAM1: ", "}")):
        source = document.parse(
            CAPTURE + f"{inside}{{'{key}': 1}}{at}"[0 if inside else 1 : None if inside else -1], name="f"
        )
        with pytest.raises(RequestError) as caught:
            document.check(source, CaptureFile)
        (line,) = str(caught.value).splitlines()
        assert line.startswith("f:8:")
        assert f"unknown key '{key}'" in line
        assert f"did you mean '{key}'" not in line


@pytest.mark.parametrize("key", ["mask", "calibration"])
@pytest.mark.parametrize("place", ["../other", "/etc/passwd", "a/../../b"])
def test_a_capture_names_only_what_lies_in_its_folder(key: str, place: str) -> None:
    source = document.parse(CAPTURE + f"{key}: {place}", name="f")
    with pytest.raises(RequestError) as caught:
        document.check(source, CaptureFile)
    assert str(caught.value) == f"f:8:1: {key}: '{place}' leaves the capture folder"


CAMERA: dict[str, Any] = {
    "item": "camera",
    "size_px": [16, 12],
    "K": [[40, 0, 8], [0, 40, 6], [0, 0, 1]],
    "world_to_camera": {"R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "t_mm": [0, 0, 890]},
}
LIGHT = {"id": "L00", "position_mm": [0, 0, 790]}
BAND = {"centre_nm": 576, "exposure": 1}


@pytest.mark.parametrize(
    ("item", "said"),
    [
        (
            CAMERA | {"world_to_camera": {"R": [[2, 0, 0], [0, 1, 0], [0, 0, 1]], "t_mm": [0, 0, 890]}},
            "lengths 2, 1, 1",
        ),
        (
            CAMERA | {"world_to_camera": {"R": [[1, 0, 0], [0, 1, 0], [0, 0, -1]], "t_mm": [0, 0, 890]}},
            "it mirrors",
        ),
        (
            CAMERA | {"world_to_camera": {"R": [[1, 0, 0], [1, 0, 0], [0, 0, 1]], "t_mm": [0, 0, 890]}},
            "right angles",
        ),
        (CAMERA | {"world_to_camera": {"R": [[1e14] * 3] * 3, "t_mm": [0, 0, 890]}}, "R is no rotation"),
        (CAMERA | {"world_to_camera": {"R": [[0] * 3] * 3, "t_mm": [0, 0, 890]}}, "R is no rotation"),
        (
            CAMERA | {"world_to_camera": CAMERA["world_to_camera"] | {"t_mm": [0, 0, -890]}},
            "must lie before the camera",
        ),
        (
            CAMERA | {"world_to_camera": CAMERA["world_to_camera"] | {"t_mm": [0, 0, 0]}},
            "must lie before the camera",
        ),
        (CAMERA | {"K": [[40, 0, 8], [0, 40, 6], [0, 0, -1]]}, "K: the form is"),
        (CAMERA | {"K": [[40, 0, 8], [1, 40, 6], [0, 0, 1]]}, "K: the form is"),
        (CAMERA | {"K": [[0, 0, 8], [0, 40, 6], [0, 0, 1]]}, "the focal lengths 0 and 40"),
        (CAMERA | {"K": [[40, 0, 8], [0, -40, 6], [0, 0, 1]]}, "the focal lengths 40 and -40"),
        (CAMERA | {"K": [[1e308, 0, 8], [0, 40, 6], [0, 0, 1]]}, "is larger than 1e+15"),
        (CAMERA | {"size_px": [0, 12]}, "size_px.0: should be greater than or equal to 1"),
        ({"item": "homography", "from": "A", "to": "B", "matrix": [[0] * 3] * 3}, "cannot be inverted"),
        ({"item": "homography", "from": "A", "to": "B", "matrix": [[1e15] * 3] * 3}, "cannot be inverted"),
        ({"item": "lights", "lights": [LIGHT, LIGHT]}, "light L00 stands twice"),
        (
            {"item": "lights", "lights": [LIGHT | {"id": f"L{i}"} for i in range(41)]},
            "all 41 lights lie in one direction",
        ),
        ({"item": "lights", "lights": [{"id": "L0", "position_mm": [0, 0, 0]}]}, "is at the origin"),
        ({"item": "lights", "lights": [LIGHT | {"drive_position": [0, 0, 7]}]}, "must be a unit vector"),
        ({"item": "lights", "lights": [LIGHT | {"power": 1e-300}]}, "power"),
        ({"item": "bands", "bands": [BAND, BAND]}, "the band 576 nm stands twice"),
        ({"item": "bands", "bands": [BAND | {"centre_nm": -5}]}, "centre_nm"),
        ({"item": "bands", "bands": [BAND | {"exposure": 1e-300}]}, "exposure"),
        ({"item": "bands", "bands": [BAND | {"curve": [[570, -1]]}]}, "neither can be negative"),
        ({"item": "bands", "bands": [BAND | {"curve": [[570, 0]]}]}, "no wavelength passes"),
    ],
)
def test_an_item_that_cannot_be_is_refused(item: dict[str, Any], said: str) -> None:
    source = document.Document("f", None, {})
    with pytest.raises(RequestError) as caught:  # noqa: PT012  1e308 is refused as it is read
        source = document.parse(json.dumps(item), name="f")
        document.check(source, KINDS[item["item"]])
    assert said in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_the_items_of_a_real_rig_are_not_refused() -> None:
    turn = np.radians(3.0)
    tilted = [[np.cos(turn), 0, np.sin(turn)], [0, -1, 0], [np.sin(turn), 0, -np.cos(turn)]]
    rounded = [[round(float(v), 4) for v in row] for row in tilted]
    camera = CAMERA | {"world_to_camera": {"R": rounded, "t_mm": [-40.0, 12.0, 890.0]}}
    for item in (camera, {"item": "lights", "lights": [LIGHT]}, {"item": "bands", "bands": [BAND]}):
        document.check(document.parse(json.dumps(item), name="f"), KINDS[str(item["item"])])


@pytest.fixture(scope="module")
def ground(tmp_path_factory: pytest.TempPathFactory) -> Ground:
    return Ground(tmp_path_factory.mktemp("hostile"))


def spoilt(ground: Ground, tmp_path: Path, kind: str, change: Callable[[dict[str, Any]], None]) -> Path:
    """A copy of one of the good items, changed, beside its pictures."""
    for picture in (ground.good / "calibration").glob("*.png"):
        (tmp_path / picture.name).write_bytes(picture.read_bytes())
    item = yaml.safe_load((ground.good / "calibration" / f"{kind}.yaml").read_text())
    change(item)
    path = tmp_path / f"{kind}.yaml"
    path.write_text(yaml.safe_dump(item))
    return path


@pytest.mark.parametrize(
    ("kind", "change", "said"),
    [
        (
            "dark",
            lambda d: d.update(hot_px={"CAM0": [[1, 2], [16, 0]]}),
            "hot_px: (16, 0) is outside the picture of 16 x 16",
        ),
        ("dark", lambda d: d.update(hot_px={"CAM0": [[-1, 0]]}), "(-1, 0) is outside"),
        (
            "dark",
            lambda d: d.update(hot_px={"CAM7": [[1, 1]]}),
            "there is no picture of CAM7; did you mean 'CAM1'?",
        ),
        ("flat", lambda d: d.update(dead_px={"CAM1": [[0, 16]]}), "dead_px: (0, 16) is outside"),
        ("dark", lambda d: d.update(images={"CAM0": "a\0b.png", "CAM1": "dark_CAM1.png"}), "text with a NUL"),
    ],
)
def test_pixels_lie_in_their_picture(
    ground: Ground,
    tmp_path: Path,
    lightstage: Lightstage,
    kind: str,
    change: Callable[[dict[str, Any]], None],
    said: str,
) -> None:
    path = spoilt(ground, tmp_path, kind, change)
    done = lightstage("calibration", "use", path, "--session", "good", store=ground.store)
    assert done.code == 2
    assert said in done.err


def test_a_dark_that_is_bright_is_refused(ground: Ground, tmp_path: Path, lightstage: Lightstage) -> None:
    import cv2

    path = spoilt(ground, tmp_path, "dark", lambda d: None)
    assert cv2.imwrite(str(tmp_path / "dark_CAM0.png"), np.full((16, 16), 65000, np.uint16))
    done = lightstage("calibration", "use", path, "--session", "good", store=ground.store)
    assert done.code == 2
    assert "dark.yaml:6:3: dark_CAM0.png is bright (65000 of 65535), which no dark is" in done.err


def test_a_dark_that_leaves_no_room_for_light_is_refused() -> None:
    from lightstage.kernels.pictures.registration import prepare

    def prepared(level: int) -> object:
        picture = CalibrationPicture("", lambda: np.full((4, 4), level, np.uint16))
        return prepare(
            cameras=["CAM1"],
            reference="CAM1",
            mounts={"CAM1": {"rotate": 0, "mirror": False}},
            shape=(4, 4),
            white_level=1023,
            dark={"scale": 10.0, "pictures": {"CAM1": picture}},
            flat=None,
            homography=None,
            flat_smoothing_percent=2.0,
        )

    prepared(640)
    with pytest.raises(
        KernelError, match="the dark of CAM1 is at 1000 of 1023 counts, so it leaves no room for light"
    ):
        prepared(10_000)


def pipeline(tmp_path: Path, lines: Iterator[str]) -> Path:
    path = tmp_path / "p.yaml"
    path.write_text("stages:\n" + "".join(f"  {line}\n" for line in lines))
    return path


def test_a_long_chain_in_reverse_is_ordered(
    tmp_path: Path, lightstage: Lightstage, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = 10_000
    # a stage that reads its own kind can stand in a chain of any length
    monkeypatch.setattr("lightstage.dag.graph._misfits", lambda *_: [])
    nodes = [f"n{i}: {{uses: split, from: n{i - 1}}}" for i in range(1, count)]
    path = pipeline(tmp_path, reversed(["n0: {uses: capture}", *nodes]))
    done = lightstage("graph", "--pipeline", path)
    assert done.code == 0
    assert [line.split()[-0].strip("└─ ").split(":")[0] for line in done.out.splitlines()[:2]] == ["n0", ""]
    assert len(done.out.splitlines()) == count


def test_a_long_circle_is_told_in_a_line(tmp_path: Path, lightstage: Lightstage) -> None:
    path = pipeline(tmp_path, (f"n{i}: {{uses: split, from: n{(i + 1) % 5000}}}" for i in range(5000)))
    done = lightstage("graph", "--pipeline", path)
    assert done.code == 2
    (line,) = done.err.splitlines()
    assert "in a circle: n0 -> n1 -> n2 -> n3 -> n4 -> n5 -> ... (4989 more) -> n4995" in line


def test_a_pipeline_of_unknown_names_is_told_of_in_part(tmp_path: Path, lightstage: Lightstage) -> None:
    path = pipeline(tmp_path, (f"n{i}: {{uses: norm{i}, from: m{i}}}" for i in range(5000)))
    done = lightstage("graph", "--pipeline", path)
    assert done.code == 2
    assert len(done.err.splitlines()) == MOST_PROBLEMS + 1


def test_the_period_of_a_sequence_is_found_in_one_pass() -> None:
    def slowly(sequence: tuple[str, ...]) -> int:
        steps = range(1, len(sequence) - 1)
        return next((s for s in steps if sequence[s:] == sequence[:-s]), len(sequence))

    chance = random.Random(0)
    for _ in range(500):
        part = [chance.choice("CX") for _ in range(chance.randint(1, 5))]
        sequence = tuple((part * 6)[: chance.randint(0, 20)])
        assert period(sequence) == slowly(sequence)
    assert period(("X",) * 19_999 + ("C",)) == 20_000


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("sequence", "wilson", "--tracking", "9" * 5000), "a whole number is expected"),
        (("sequence", "wilson", "--tracking", "999999"), "a performance has 1 to 5000"),
        (("sequence", "wilson", "--exposure-ms", "1e-322"), "exposure_ms 9.88131e-323: a number of milliseconds"),
        (("sequence", "wilson", "--exposure-ms", "nan"), "a finite number is expected, found 'nan'"),
        (("sequence", "multispectral", "--bands", "9" * 400), "expected wavelengths"),
        (("sequence", "check", "L" + "9" * 4000), "the illumination"),
        (("sequence", "check", "~nobody/x.yaml"), "is missing"),
        (("import", "~nobody/x"), "is not a folder"),
        (("run", "--session", "x", "--frames", "0:" + "9" * 5000), "expected A:B"),
        (("sessions", "show", "x" * 5000), "no session"),
        (("run", "--session", "x", "--pipeline=--"), "'--' is no value"),
        (("gc", "--grace", "9" * 400 + "d"), "expected a time"),
        (("demo", "--size", "99999x99999"), "32 to 8192 pixels"),
        (("demo", "--seed", "1e9"), "a whole number is expected"),
        (("demo", "--session", "x" * 101), "a name has up to 100 letters"),
        (("relight", "x", "--to", "/x", "--light", "0,0,1e308"), "a strength above 0 and up to 1e+06"),
        (
            ("export", "normals", "--session", "x", "--to", "x", "--format", "mp4", "--fps", "inf"),
            "a finite number",
        ),
        (("graph", "--pipeline", "x" * 5000), "cannot be read (File name too long)"),
        (("calibrate", "dark", "--from", "/dev/null"), "is not a folder"),
    ],
)
def test_odd_options_are_one_short_sentence(
    ground: Ground, lightstage: Lightstage, words: tuple[str, ...], said: str
) -> None:
    done = lightstage(*words, store=ground.store)
    assert done.code == 2
    assert said in done.err
    assert len(done.err) < 1000


def test_a_refusal_of_the_operating_system_is_a_sentence(
    ground: Ground, lightstage: Lightstage, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number, said in (
        (errno.EACCES, "lightstage: /x/y: Permission denied\n"),
        (errno.EMFILE, "lightstage: /x/y: Too many open files; raise the limit with `ulimit -n`, and run again\n"),
        (errno.ENOSPC, "lightstage: /x/y: No space left on device; free some space and run again\n"),
        (errno.EIO, "lightstage: /x/y: Input/output error\n"),
    ):

        def refuse(*_: object, number: int = number) -> None:
            raise OSError(number, os.strerror(number), "/x/y")

        monkeypatch.setattr("lightstage.store.sessions.session_names", refuse)
        done = lightstage("sessions", "list", store=ground.store)
        assert (done.code, done.err) == (1, said)


def test_memory_that_runs_out_is_a_sentence(
    ground: Ground, lightstage: Lightstage, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fill(*_: object) -> None:
        np.empty(1 << 60, np.uint8)

    monkeypatch.setattr("lightstage.store.sessions.session_names", fill)
    done = lightstage("sessions", "list", store=ground.store)
    assert done.code == 1
    assert "there is not enough memory for this (Unable to allocate" in done.err


def process(script: str, folder: Path, **variables: str) -> "subprocess.CompletedProcess[bytes]":
    return subprocess.run(
        ["sh", "-c", script, sys.executable],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY / "src"), **variables},
        capture_output=True,
        timeout=120,
    )


def test_places_that_a_shell_can_put_a_command_in(tmp_path: Path) -> None:
    """A full stdout, one without letters, a folder that is gone; and libyaml's stack, which ends a process."""
    static = '"$0" -m lightstage.cli.main sequence static'
    script = f"""
    {static} > /dev/full; echo full $?
    "$0" -m lightstage.cli.main --help > /dev/full; echo help $?
    PYTHONIOENCODING=ascii {static} --to ä.yaml; echo letters $?
    head -c 100000 /dev/zero | tr '\\0' '[' > deep.yaml; {static[:-7]} check deep.yaml; echo deep $?
    mkdir gone; cd gone; rmdir ../gone; "$0" -m lightstage.cli.main sessions list; echo gone $?
    """
    done = process(script, tmp_path, LC_ALL="C.UTF-8")
    said, answers = done.stderr.decode(), done.stdout.decode("ascii")
    codes = re.findall(r"^(?:full|help|letters|deep|gone) \d+$", answers, re.MULTILINE)
    assert codes == ["full 1", "help 1", "letters 0", "deep 2", "gone 1"]
    assert "written: \\xe4.yaml" in answers
    assert said.count("the answer cannot be written to stdout (No space left on device)") == 2
    assert "deep.yaml:1:65: lists and keys lie more than 64 deep" in said
    assert "the working folder is gone" in said
    assert "unexpected" not in said
    assert "Traceback" not in said


def test_a_file_of_another_user(tmp_path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root can become another user")
    secret = tmp_path / "secret.yaml"
    secret.write_text("stages: {}")
    secret.chmod(0)
    locked = tmp_path / "locked"
    Store(locked)
    locked.chmod(0)
    said = []
    for words in (["graph", "--pipeline", str(secret)], ["--store", str(locked), "sessions", "list"]):
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            sys.stderr = os.fdopen(write, "w")
            for parent in [tmp_path, *tmp_path.parents][:4]:
                with contextlib.suppress(OSError):
                    parent.chmod(0o755)
            os.setuid(65534)
            main(words)
            sys.stderr.flush()
            os._exit(0)
        os.close(write)
        with os.fdopen(read) as text:
            said.append(text.read())
        os.waitpid(child, 0)
    assert all("Permission denied" in text and "unexpected" not in text for text in said), said


def test_odd_requests_are_answered_as_they_should_be(ground: Ground) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    found = [answered(ground.trial(seed), limit_s=float("inf")) for seed in range(30)]
    assert [one for one in found if one is not None] == []
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1_000_000


def test_a_spoilt_file_of_points_is_read_or_refused(tmp_path: Path) -> None:
    chance, read = random.Random(0), 0
    for _ in range(200):
        path = tmp_path / "points.yaml"
        path.write_text("good: {left_eye: [3, 4], right_eye: [9, 4], nose: [5, 6.5]}\nother: {}\n")
        spoil(path, chance)
        with contextlib.suppress(RequestError):
            read += all(at.shape == (2,) for at in read_points(path, ["good"])["good"].values())
    assert 0 < read < 200


def test_a_figure_that_no_block_tells_is_not_said_of_the_result(store: Store) -> None:
    from lightstage.dag.task import BlockTask, _write

    task = SimpleNamespace(arrays={"a": ("float32", (1, 2), (1, 2), None)}, node="n", block="b")
    outputs = {"a": np.zeros((1, 2), np.float32), "stats": {"error": float("nan"), "part": 0.5}}
    _, stats, _ = _write(cast(BlockTask, task), outputs, store)
    assert stats == {"part": 0.5}

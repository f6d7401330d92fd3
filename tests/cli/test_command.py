"""The command: what it prints, exit codes, JSON, bad requests."""

import argparse
import json
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import imageio.v3 as imageio
import numpy as np
import OpenEXR
import pytest
import xarray

from lightstage.cli.main import COMMANDS, build_parser
from tests.conftest import REPOSITORY, Answer, run_process
from tests.scenes import one_camera_capture, sphere_normals, write_capture

Lightstage = Callable[..., Answer]


@pytest.fixture
def ball(lightstage: Lightstage, sphere: Path) -> Path:
    assert lightstage("import", sphere).code == 0
    assert lightstage("run", "--session", "ball").code == 0
    return sphere


def names(parser: argparse.ArgumentParser) -> set[str]:
    (commands,) = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return set(commands.choices)


def test_the_table_of_commands_is_what_the_modules_have() -> None:
    assert names(build_parser()) == set(COMMANDS)
    for command, module in COMMANDS.items():
        assert names(build_parser([command])) == {name for name, home in COMMANDS.items() if home == module}


@pytest.mark.parametrize(
    ("words", "parsed"),
    [
        (["--store", "status", "run"], {"run", "normals", "performance"}),
        (["--store=x", "--json", "verify", "-h"], {"verify", "gc", "upgrade"}),
        (["--help", "run"], set(COMMANDS)),
        (["runn"], set(COMMANDS)),
        ([], set(COMMANDS)),
    ],
)
def test_only_the_module_of_the_command_is_asked(words: list[str], parsed: set[str]) -> None:
    assert names(build_parser(words)) == parsed


def test_a_node_that_brings_in_the_session_may_have_any_name(lightstage: Lightstage, tmp_path: Path) -> None:
    lightstage("import", one_camera_capture(tmp_path / "c", ["C", "X", "Y", "Z"], session="ball"))
    pipeline = tmp_path / "p.yaml"
    pipeline.write_text("stages:\n  pictures: {uses: capture}\n  clean: {uses: register, from: pictures}\n")
    found = lightstage("path", "pictures", "--session", "ball", "--pipeline", pipeline)
    assert found.out.strip() == str(tmp_path / "store" / "sessions" / "ball" / "raw.zarr")
    where = ("--session", "ball", "--pipeline", pipeline)
    assert lightstage("export", "pictures", *where, "--format", "png16", "--to", tmp_path / "out").code == 0
    assert len(list((tmp_path / "out").glob("*.png"))) == 4


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


@pytest.mark.parametrize(
    "words",
    [
        ("sessions", "list"),
        ("sessions", "show", "ball"),
        ("calibration", "list"),
        ("calibration", "show", "homography"),
        ("run", "--session", "ball"),
        ("run", "--session", "ball", "--dry-run"),
        ("status",),
        ("status", "--session", "ball"),
        ("why", "normals", "--session", "ball"),
        ("graph",),
        ("path", "normals", "--session", "ball"),
        ("path", "capture", "--session", "ball"),
        ("verify",),
        ("gc", "--dry-run"),
        ("run", "--session", "nobody"),
        ("path", "nothing", "--session", "ball"),
    ],
)
def test_json_is_one_document_and_nothing_else(lightstage: Lightstage, ball: Path, words: tuple[str, ...]) -> None:
    done = lightstage(*words, "--json")
    assert isinstance(json.loads(done.out), dict)
    assert ("error" in json.loads(done.out)) == (done.code != 0)
    plain = lightstage(*words)
    assert plain.code == done.code
    assert plain.out.strip() or plain.code


def test_path_prints_the_path_and_nothing_else(lightstage: Lightstage, ball: Path) -> None:
    (line,) = lightstage("path", "normals", "--session", "ball").out.splitlines()
    assert Path(line).is_dir()
    assert Path(line).parent.joinpath("current").read_text().strip() == Path(line).name


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("runn",), "'runn' is not known; did you mean 'run'?"),
        (("run",), "--session"),
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
        (("import", "nowhere"), "nowhere is not a folder"),
        (("normals", "nowhere"), "neither a session"),
        (("path", "nrmals", "--session", "ball"), "no result of 'nrmals'"),
        (("why", "nrmals", "--session", "ball"), "did you mean 'normals'"),
        (("gc", "--grace", "soon"), "expected a time"),
        (("calibration", "show", "homograpy"), "no calibration item"),
        (("calibration", "use", "no.yaml", "--session", "ball"), "no.yaml is missing"),
        (("demo", "--size", "big"), "expected WIDTHxHEIGHT"),
        (("demo", "--bands", "20"), "390 to 760 nm"),
        (("demo", "--tracking", "3"), "only a performance has it"),
        (("demo", "--motion", "fast"), "only a performance has it"),
        (("demo", "--sequence", "wilson", "--tracking", "0"), "a performance has 1 to 5000"),
        (("demo", "--sequence", "wilson", "--bands", "434,576"), "a performance has one band"),
        (("demo", "--sequence", "wilson", "--target", "ball"), "does not perform"),
    ],
)
def test_a_wrong_request_is_one_sentence_and_exit_code_2(
    lightstage: Lightstage, ball: Path, words: tuple[str, ...], part: str
) -> None:
    done = lightstage(*words)
    assert done.code == 2
    assert part in done.err
    assert len(done.err.strip().splitlines()) == 1
    assert done.err.startswith("lightstage: ")


def test_version_and_help(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["--version"], ["--help"], ["run", "--help"]):
        with pytest.raises(SystemExit) as stop:
            build_parser().parse_args(words)
        assert stop.value.code == 0
    assert "lightstage 0.1" in capsys.readouterr().out


def test_the_store_comes_from_the_environment_or_is_data(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("LIGHTSTAGE_STORE", raising=False)
    assert build_parser().parse_args(["status"]).store == "data"
    monkeypatch.setenv("LIGHTSTAGE_STORE", "elsewhere")
    assert build_parser().parse_args(["status"]).store == "elsewhere"


def test_a_store_must_be_a_folder_of_its_own(lightstage: Lightstage, sphere: Path, tmp_path: Path) -> None:
    assert "holds other files" in lightstage("import", sphere, store=sphere).err
    (tmp_path / "file").write_text("x")
    assert "is a file" in lightstage("status", store=tmp_path / "file").err
    assert "only a local folder" in lightstage("status", store="s3://bucket/x").err
    new = tmp_path / "newer"
    new.mkdir()
    (new / "store.json").write_text('{"format": "lightstage-store/9"}')
    assert "made by a newer lightstage (format 9); this program reads 2" in lightstage("status", store=new).err


def test_binding_another_item_is_what_later_runs_use(lightstage: Lightstage, ball: Path, tmp_path: Path) -> None:
    item = tmp_path / "new.yaml"
    item.write_text("item: homography\nfrom: CAM0\nto: CAM1\nmatrix: [[1, 0, -1.5], [0, 1, 0], [0, 0, 1]]\n")
    assert lightstage("calibration", "use", item, "--session", "ball", "--json").json["changed"]
    assert not lightstage("calibration", "use", item, "--session", "ball", "--json").json["changed"]
    assert lightstage("run", "--session", "ball", "--json").json["nodes"]["register"]["computed"] == 7
    listed = lightstage("calibration", "list", "--session", "ball", "--json").json["items"]
    assert {entry["kind"] for entry in listed} == {"homography", "bands"}


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


@pytest.fixture
def exported(lightstage: Lightstage, ball: Path, tmp_path: Path) -> Callable[..., Path]:
    def export(form: str, *more: str) -> Path:
        to = tmp_path / f"{form}{len(more)}"
        done = lightstage("export", "normals", "--session", "ball", "--to", to, "--format", form, *more)
        assert done.code == 0, done.err
        return to / f"normal_tracking0000_576nm.{form.rstrip('0123456789')}"

    return export


def read_png(path: Path) -> Any:
    """8 bits by imageio; 16-bit colour is beyond Pillow, so by the format's own rules (type 2, filters 0 to 4)."""
    data = path.read_bytes()
    width, height, depth, kind = struct.unpack(">IIBB", data[16:26])
    assert kind == 2
    if depth == 8:
        return imageio.imread(path)
    parts, offset = b"", 8
    while offset < len(data):
        length, name = struct.unpack_from(">I4s", data, offset)
        parts += data[offset + 8 : offset + 8 + length] if name == b"IDAT" else b""
        offset += 12 + length
    rows = np.frombuffer(zlib.decompress(parts), np.uint8).reshape(height, 1 + width * 6)
    out = np.zeros((height, width * 6), np.uint8)
    for y in range(height):
        up = out[y - 1] if y else np.zeros(width * 6, np.uint8)
        for i in range(width * 6):
            left = int(out[y, i - 6]) if i >= 6 else 0
            corner = int(up[i - 6]) if i >= 6 else 0
            guess = left + int(up[i]) - corner
            nearest = min((left, int(up[i]), corner), key=lambda value: abs(guess - value))
            base = (0, left, int(up[i]), (left + int(up[i])) // 2, nearest)[rows[y, 0]]
            out[y, i] = (int(rows[y, 1 + i]) + base) & 255
    return out.reshape(height, width, 6).view(">u2")


def test_png_normals_are_green_up_or_down(exported: Callable[..., Path]) -> None:
    """On the sphere's upper half the normal points up: green above a half in OpenGL, below in DirectX."""
    for form, top in (("png8", 255), ("png16", 65535)):
        opengl = read_png(exported(form))
        directx = read_png(exported(form, "--convention", "directx"))
        assert opengl.dtype.itemsize == (1 if top == 255 else 2)
        assert opengl[8, 24, 1] > 0.7 * top > 0.3 * top > directx[8, 24, 1]
        assert opengl[24, 8, 0] < 0.3 * top < 0.7 * top < opengl[24, 40, 0]
        assert abs(int(opengl[24, 24, 2]) - top) < 0.02 * top


def test_exr_has_named_float_channels_and_says_its_frame(exported: Callable[..., Path]) -> None:
    path = exported("exr")
    with OpenEXR.File(str(path), separate_channels=True) as exr:
        channels = exr.channels()
        header = exr.header()
        assert set(channels) == {"normal.X", "normal.Y", "normal.Z"}
        normal = np.stack([channels[f"normal.{a}"].pixels for a in "XYZ"])
        assert header["lightstage.convention"] == "green = up (OpenGL)"
        assert "z towards the camera" in header["lightstage.frame"]
        assert header["lightstage.units"] == "unit vector"
        assert header["lightstage.method"] == "difference"
    assert normal.dtype == np.float32
    truth, mask = sphere_normals()
    assert np.median(np.abs(normal - truth)[:, mask]) < 0.02


def test_npy_is_the_decoded_result(exported: Callable[..., Path], lightstage: Lightstage) -> None:
    values = np.load(exported("npy"))
    result = xarray.open_zarr(lightstage("path", "normals", "--session", "ball").out.strip(), chunks=None)
    assert values.dtype == np.float32
    np.testing.assert_array_equal(values, result.normal.values[0, 0].transpose(1, 2, 0).astype(np.float32))


def test_a_full_disk_is_a_sentence_and_nothing_is_lost(tmp_path: Path, sphere: Path) -> None:
    """The disk says "no space left" when it is asked to flush for the sixth time; all else is the real code."""
    store = tmp_path / "store"
    assert run_process("import", sphere, store=store).returncode == 0
    code = (
        "import errno, os, sys\nimport lightstage.store.files\n"
        "real, left = os.fsync, [5]\n"
        "def fsync(fd):\n"
        "    left[0] -= 1\n"
        "    if left[0] < 0: raise OSError(errno.ENOSPC, 'No space left on device')\n"
        "    return real(fd)\n"
        "os.fsync = fsync\n"
        "from lightstage.cli.main import main\n"
        f"sys.exit(main(['--store', {str(store)!r}, 'run', '--session', 'ball']))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, timeout=120)
    assert done.returncode == 1
    assert "is full: nothing was lost" in done.stderr
    assert "Traceback" not in done.stderr
    assert run_process("verify", store=store).returncode == 0
    assert run_process("run", "--session", "ball", store=store).returncode == 0
    assert not list((store / "tmp").glob("*"))


def test_the_demo_runs_and_keeps_its_truth(lightstage: Lightstage, tmp_path: Path) -> None:
    done = lightstage("demo", "--size", "64x48", "--bands", "576", "--session", "d", "--json")
    assert done.code == 0, done.err
    truth = Path(done.json["truth"]) / "ground_truth_cam1.npz"
    assert np.load(truth)["normal"].shape == (48, 64, 3)
    assert lightstage("run", "--session", "d").code == 0
    before = sorted(p.name for p in (tmp_path / "store" / "captures").iterdir())
    lightstage("demo", "--size", "64x48", "--bands", "576", "--session", "d")
    assert sorted(p.name for p in (tmp_path / "store" / "captures").iterdir()) == before


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


def test_another_capture_takes_the_truth_of_the_one_before_away(lightstage: Lightstage) -> None:
    small = ("demo", "--size", "64x48", "--session", "d", "--json")
    made = lightstage(*small, "--bands", "576")
    again = lightstage(*small, "--sequence", "minimal", "--tracking", "1", "--motion", "still")
    assert made.json["truth"] == again.json["truth"]
    names = {path.name for path in Path(again.json["truth"]).iterdir()}
    assert names == {"meta.yaml", *(f"{kind}_t{t:02d}.npz" for kind in ("gt", "flow") for t in range(5))}


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


def test_a_truncated_picture_is_one_clear_sentence(lightstage: Lightstage, sphere: Path) -> None:
    victim = sphere / "0003_Z_576nm_CAM1.png"
    victim.write_bytes(victim.read_bytes()[:200])
    done = lightstage("import", sphere)
    assert done.code == 2
    assert (
        done.err.strip() == f"lightstage: {victim} is truncated: the PNG ends after 200 bytes without an end mark"
    )

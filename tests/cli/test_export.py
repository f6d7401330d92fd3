"""export: pictures of a node for tools that do not read zarr."""

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import OpenEXR
import pytest
import xarray

from tests.cli.conftest import Lightstage, check_refusal
from tests.scenes import one_camera_capture, sphere_normals


@pytest.fixture
def exported(lightstage: Lightstage, standing: Path, tmp_path: Path) -> Callable[..., Path]:
    def export(form: str, *more: str) -> Path:
        to = tmp_path / f"{form}{len(more)}"
        done = lightstage(
            "export", "normals", "--session", "ball", "--to", to, "--format", form, *more, store=standing
        )
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


def test_npy_is_the_decoded_result(exported: Callable[..., Path], lightstage: Lightstage, standing: Path) -> None:
    values = np.load(exported("npy"))
    path = lightstage("path", "normals", "--session", "ball", store=standing).out.strip()
    result = xarray.open_zarr(path, chunks=None)
    assert values.dtype == np.float32
    np.testing.assert_array_equal(values, result.normal.values[0, 0].transpose(1, 2, 0).astype(np.float32))


def test_a_node_that_brings_in_the_session_may_have_any_name(lightstage: Lightstage, tmp_path: Path) -> None:
    lightstage("import", one_camera_capture(tmp_path / "c", ["C", "X", "Y", "Z"], session="ball"))
    pipeline = tmp_path / "p.yaml"
    pipeline.write_text("stages:\n  pictures: {uses: capture}\n  clean: {uses: register, from: pictures}\n")
    where = ("--session", "ball", "--pipeline", pipeline)
    assert lightstage("export", "pictures", *where, "--format", "png16", "--to", tmp_path / "out").code == 0
    assert len(list((tmp_path / "out").glob("*.png"))) == 4


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("--format", "png8", "--fps", "3"), "only a film has it"),
        (("--format", "png8", "--every", "2"), "a step of 1 or more for a mesh"),
        (("--format", "glb", "--every", "0"), "a step of 1 or more for a mesh"),
        (("--format", "exr", "--normal-map", "tangent"), "only a mesh has it"),
        (("--format", "glb"), "node 'normals' has no depth"),
        (("--format", "tiff"), "'tiff' is not known"),
    ],
)
def test_a_wrong_request_is_one_sentence(
    lightstage: Lightstage, standing: Path, tmp_path: Path, words: tuple[str, ...], part: str
) -> None:
    done = lightstage("export", "normals", "--session", "ball", "--to", tmp_path / "out", *words, store=standing)
    check_refusal(done, part)
    assert not (tmp_path / "out").exists()

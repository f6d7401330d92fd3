"""OpenEXR read back by OpenImageIO."""

from pathlib import Path

import numpy as np
import pytest

from lightstage.formats.exr import COLOUR, DATA, REC709, is_whole, rgb, spectral, write_exr
from tests.readers import Exr


def test_numbers_and_what_they_are(tmp_path: Path) -> None:
    values = np.random.default_rng(0).normal(size=(3, 5, 4)).astype(np.float32)
    write_exr(tmp_path / "a.exr", {**rgb(values), **rgb(values, "diffuse")}, colour=COLOUR, units="1", scale=2.5)
    read = Exr(tmp_path / "a.exr")
    for i, name in enumerate("RGBA"):
        np.testing.assert_array_equal(read[name], values[..., i])
        np.testing.assert_array_equal(read[f"diffuse.{name}"], values[..., i])
    assert read.attributes["colorInteropID"] == "lin_rec709_scene"
    np.testing.assert_allclose(read.attributes["chromaticities"], REC709, rtol=1e-6)
    assert read.attributes["lightstage.units"] == "1"
    assert read.attributes["lightstage.scale"] == 2.5


def test_data_have_no_colour_and_bands_have_their_wavelength(tmp_path: Path) -> None:
    write_exr(tmp_path / "b.exr", spectral(np.zeros((2, 3, 3)), (407, 434.5)), colour=DATA)
    read = Exr(tmp_path / "b.exr")
    assert set(read.channels) == {"T.407,0nm", "T.434,5nm"}
    assert read.attributes["spectralLayoutVersion"] == "1.0"
    assert read.attributes["colorInteropID"] == "data"
    assert "chromaticities" not in read.attributes


def test_a_full_disk_is_an_error_of_the_operating_system() -> None:
    noise = np.random.default_rng(0).random((64, 64))
    with pytest.raises(OSError, match="No space left on device"):
        write_exr(Path("/dev/full"), {"Y": noise}, colour=DATA)


@pytest.mark.parametrize("rows", [1, 16, 40])
def test_a_file_that_lacks_its_last_byte_is_not_whole(tmp_path: Path, rows: int) -> None:
    write_exr(tmp_path / "a.exr", {"Y": np.random.default_rng(0).random((rows, 9))}, colour=DATA, units="mm")
    data = (tmp_path / "a.exr").read_bytes()
    assert is_whole(data, rows)
    for length in (len(data) - 1, len(data) // 2, 100, 8, 0):
        assert not is_whole(data[:length], rows)


def test_what_the_library_loses_in_silence_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: whole(path)[:-1])
    with pytest.raises(OSError, match="was not written to its end"):
        write_exr(tmp_path / "a.exr", {"Y": np.zeros((4, 4))}, colour=DATA)

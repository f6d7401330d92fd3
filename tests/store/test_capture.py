"""The capture folder: what is refused, and how it is said."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
import yaml

from lightstage.store.capture import read_capture
from lightstage.store.errors import RequestError
from lightstage.store.importer import import_capture
from lightstage.store.picture import PictureError, decode, linear_from_srgb
from lightstage.store.root import Store
from tests.scenes import one_camera_capture, write_capture


def edit(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    path = folder / "capture.yaml"
    description = yaml.safe_load(path.read_text())
    change(description)
    path.write_text(yaml.safe_dump(description, sort_keys=False))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("bits"), "'bits' is missing"),
        (lambda d: d.update(bitz=10), "unknown key 'bitz'; did you mean 'bits'"),
        (lambda d: d.update(format="lightstage-capture/2"), "lightstage-capture/1"),
        (lambda d: d["frames"][2].update(illumination="W"), "the illumination 'W' is not known"),
        (lambda d: d.update(cameras={"cross": "A", "unpolarised": "B"}), "an unpolarised camera stands alone"),
        (lambda d: d.update(colour="rgb"), "rgb needs three bands_nm"),
        (lambda d: d.update(files="{frame}_{light}.png"), "unknown part {light}"),
        (lambda d: d.update(files="../{frame}.png"), "leaves the capture folder"),
        (lambda d: d.update(files="{frame:0999999999d}.png"), "a width of up to two digits may stand there"),
        (lambda d: d.update(files="{frame:0{band}d}.png"), "a single '{'"),
        (lambda d: d.update(files="{frame!r:>9}.png"), "has {frame!r:>9}"),
        (lambda d: d.update(files="{frame.__class__}.png"), "has {frame.__class__}"),
        (lambda d: d.update(files="{camera[0]}.png"), "{camera} stands alone"),
        (lambda d: d.update(files="{}.png"), "has an empty {}"),
        (lambda d: d.update(files="{frame.png"), "a single '{'"),
        (lambda d: d.update(files="{frame:04d}" + "a" * 252), "has 256 bytes; a file's name has at most 255"),
        (lambda d: d.update(files="{frame}{camera}", cameras={"cross": "/../../x"}), "leaves the capture folder"),
        (lambda d: d.update(files="{frame}{band:03d}", bands_nm=[407.5]), "writes bands as whole numbers; 407.5"),
        (lambda d: d.update(files="same.png"), "would be both"),
        (lambda d: d.update(intensities={"L09": 2.0}), "L09 is no illumination of this capture"),
        (lambda d: d.update(intensities={"C": [1.0, 2.0]}), "C has 2 numbers for 1 bands"),
        (lambda d: d.update(mount={"CAM1": {"rotate": 45}}), "rotate"),
        (lambda d: d.update(session="a/b"), "is no name for a session: up to 100 letters"),
        (lambda d: d.update(bits=17), "less than or equal to 16"),
    ],
)
def test_a_wrong_description_is_one_line_with_a_place(
    tmp_path: Path, change: Callable[[dict[str, Any]], None], message: str
) -> None:
    folder = one_camera_capture(tmp_path / "c", ["C", "X", "Y"])
    edit(folder, change)
    with pytest.raises(RequestError) as caught:
        read_capture(folder).pictures()
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) <= 3


def break_missing(path: Path) -> str:
    path.unlink()
    return "is missing"


def break_truncated(path: Path) -> str:
    path.write_bytes(path.read_bytes()[:-40])
    return "is truncated"


def break_empty(path: Path) -> str:
    path.write_bytes(b"")
    return "is empty"


def break_flipped(path: Path) -> str:
    data = bytearray(path.read_bytes())
    data[60] ^= 255
    path.write_bytes(bytes(data))
    return "is damaged"


def break_not_a_picture(path: Path) -> str:
    path.write_text("hello")
    return "is not a PNG or TIFF picture"


def break_size(path: Path) -> str:
    cv2.imwrite(str(path), np.zeros((9, 9), np.uint16))
    return "is 9 x 9; the other pictures are 16 x 12"


def break_depth(path: Path) -> str:
    cv2.imwrite(str(path), np.zeros((12, 16), np.uint8))
    return "has 8 bits a value; bits: 10 needs a 16-bit file"


def break_range(path: Path) -> str:
    cv2.imwrite(str(path), np.full((12, 16), 1024, np.uint16))
    return "holds the value 1024, more than bits: 10 can (1023)"


def break_colour(path: Path) -> str:
    cv2.imwrite(str(path), np.zeros((12, 16, 3), np.uint16))
    return "has 3 channel(s); colour: mono means 1"


@pytest.mark.parametrize(
    "harm",
    [
        break_missing,
        break_truncated,
        break_empty,
        break_flipped,
        break_not_a_picture,
        break_size,
        break_depth,
        break_range,
        break_colour,
    ],
)
def test_a_bad_picture_is_named_and_nothing_is_written(
    tmp_path: Path, store: Store, harm: Callable[[Path], str]
) -> None:
    folder = one_camera_capture(tmp_path / "c", ["C", "X", "Y", "Z"])
    victim = folder / "0002_Y_0nm_CAM1.png"
    message = harm(victim)
    with pytest.raises(RequestError) as caught:
        import_capture(folder, store)
    assert str(victim) in str(caught.value)
    assert message in str(caught.value)
    assert not list(store.sessions.glob("*"))


def test_all_bad_pictures_come_at_once(tmp_path: Path, store: Store) -> None:
    folder = one_camera_capture(tmp_path / "c", ["C", "X", "Y", "Z"])
    (folder / "0001_X_0nm_CAM1.png").unlink()
    break_truncated(folder / "0003_Z_0nm_CAM1.png")
    with pytest.raises(RequestError) as caught:
        import_capture(folder, store)
    assert len(str(caught.value).splitlines()) == 2


def test_colour_files_hold_bands_in_r_g_b_order(tmp_path: Path, store: Store) -> None:
    folder = tmp_path / "c"
    folder.mkdir()
    rgb = np.zeros((4, 5, 3), np.uint8)
    rgb[..., 0], rgb[..., 1], rgb[..., 2] = 10, 20, 30
    cv2.imwrite(str(folder / "one.png"), rgb[..., ::-1])
    (folder / "capture.yaml").write_text(
        "format: lightstage-capture/1\nsession: c\nbits: 8\ncolour: rgb\ncameras: {unpolarised: CAM}\n"
        "bands_nm: [610, 540, 465]\nframes: [{illumination: L00, file: one.png}]\n"
    )
    session = import_capture(folder, store).session
    planes = [store.chunks.get(session.images[0][b][0], dtype="<u2", shape=(4, 5))[0, 0] for b in range(3)]
    assert planes == [10, 20, 30]
    assert session.facts["bands_nm"] == [610.0, 540.0, 465.0]


def test_tiff_reads_like_png_and_a_truncated_one_is_refused(tmp_path: Path) -> None:
    picture = np.arange(60, dtype=np.uint16).reshape(6, 10)
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, picture)
    np.testing.assert_array_equal(decode(path.read_bytes()), picture)
    with pytest.raises(PictureError, match=r"truncated|cannot be decoded"):
        decode(path.read_bytes()[:-30])
    tifffile.imwrite(path, picture.astype(np.float32))
    with pytest.raises(PictureError, match="float32"):
        decode(path.read_bytes())


def test_srgb_is_decoded_by_the_standard_curve() -> None:
    # IEC 61966-2-1: code 188 of 255 is 0.5029 of full scale, 10 lies on the straight part
    linear = linear_from_srgb(np.array([[0, 10, 188, 255]], np.uint8))
    np.testing.assert_allclose(linear / 65535, [[0, 10 / 255 / 12.92, 0.5029, 1]], atol=1e-4)


@pytest.mark.parametrize(
    ("template", "name"),
    [
        ("{frame:04d}_{illumination}_{band}nm_{camera}.png", "0000_C_576nm_CAM1.png"),
        ("{frame:03}-{band:04d}.png", "000-0576.png"),
        ("{{{frame}}}/{band:.1f}{band:g}.tif", "{0}/576.0576.tif"),
    ],
)
def test_a_template_holds_its_parts_with_widths(tmp_path: Path, template: str, name: str) -> None:
    folder = one_camera_capture(tmp_path / "c", ["C"])
    edit(folder, lambda d: d.update(files=template, bands_nm=[576]))
    capture = read_capture(folder)
    assert [picture.path for picture in capture.pictures()] == [capture.folder / name]


def test_a_picture_of_another_size_is_refused_before_it_is_decoded(tmp_path: Path, store: Store) -> None:
    folder = one_camera_capture(tmp_path / "c", ["C", "X", "Y"])
    victim = folder / "0001_X_0nm_CAM1.png"
    cv2.imwrite(str(victim), np.zeros((9000, 9), np.uint16))
    victim.write_bytes(victim.read_bytes()[:-40])  # what decoding would complain of
    with pytest.raises(RequestError) as caught:
        import_capture(folder, store)
    assert str(caught.value) == f"{victim} is 9 x 9000; the other pictures are 16 x 12"


def test_extra_pictures_are_a_warning_and_other_files_nobodys_business(tmp_path: Path, store: Store) -> None:
    folder = one_camera_capture(tmp_path / "c", ["C"])
    (folder / "notes.txt").write_text("a")
    (folder / "old").mkdir()
    cv2.imwrite(str(folder / "snap.png"), np.zeros((2, 2), np.uint8))
    done = import_capture(folder, store)
    assert len(done.warnings) == 1
    assert "snap.png" in done.warnings[0]


def test_mask_of_another_size_is_refused(tmp_path: Path, store: Store) -> None:
    folder = one_camera_capture(tmp_path / "c", ["C"], mask="mask.png")
    cv2.imwrite(str(folder / "mask.png"), np.zeros((3, 3), np.uint8))
    with pytest.raises(RequestError, match="the mask must be as large as the pictures, 16 x 12"):
        import_capture(folder, store)


def test_frames_may_name_their_own_pictures(tmp_path: Path, store: Store) -> None:
    folder = write_capture(
        tmp_path / "c", {(0, 0, "cross"): np.zeros((4, 4), np.uint16)}, illumination=["C"], files="{frame}.png"
    )
    edit(folder, lambda d: d.update(frames=[{"illumination": "C", "file": "own.png"}]))
    (folder / "0000_C_0nm_CAM1.png").rename(folder / "own.png")
    assert import_capture(folder, store).session.sizes["frame"] == 1

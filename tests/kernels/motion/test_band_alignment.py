"""Bands of a multispectral capture brought to one: features, exact flows, what cannot be aligned, the command."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import xarray
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from lightstage.kernels.motion.band_alignment import KINDS, BandFlow, Kind, Light, band_flow, gathered
from tests.conftest import Answer
from tests.scenes import MINIMAL, STATIC, Performer, ideal_gradient, write_capture

pytestmark = pytest.mark.slow

Array = NDArray[Any]
ACTOR = Performer()
TIMES = {407: 1.5, 497: 0.0, 655: -2.0}
"""When each band was taken: the subject of 655 nm is some 2 px away from that of 497 nm."""
HOMOGRAPHY = {"item": "homography", "from": "CAM0", "to": "CAM1", "matrix": np.eye(3).tolist()}
CONTRAST = {407: 1.5, 497: 0.7, 655: -0.7}
"""Of the albedo's texture: what is dark in one band may be bright in another."""


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    cv2.setNumThreads(1)


def _texture(seed: int) -> Array:
    return Performer(seed=seed)._texture()


def pictures(
    time: float,
    *,
    contrast: float = 1.0,
    gloss: float = 0.35,
    own_texture: int | None = None,
    names: tuple[str, ...] = STATIC,
    noise: int | None = 0,
    member_time: Callable[[int], float] = lambda i: 0.0,
    shift: tuple[float, float] = (0.0, 0.0),
) -> dict[str, Array]:
    """Counts (polarisation, y, x) by illumination: parallel and cross, 10 bits; noise None: exact.

    What is fixed to the skin is a function of where it was at time 0, so flows are exact. `own_texture` gives the
    albedo a texture that no other band has.
    """
    out = {}
    for i, name in enumerate(names):
        x, y = ACTOR.origin(time + member_time(i))
        height, width = ACTOR.shape
        at = [y - shift[1], x - shift[0]] if any(shift) else [y, x]
        px, py = (at[1] - width / 2) / (0.38 * width), (at[0] - height / 2) / (0.42 * height)
        rim = np.clip((1 - np.sqrt(px**2 + py**2)) * 0.38 * width + 0.5, 0, 1)
        skin = _texture(ACTOR.seed if own_texture is None else own_texture)
        fine, pores = (map_coordinates(t, at, order=3, mode="grid-wrap") for t in (skin, _texture(77)))
        slopes = [0.1 * map_coordinates(_texture(k), at, order=3, mode="grid-wrap") for k in (78, 79)]
        normal = np.stack([0.8 * px + slopes[0], -0.8 * py + slopes[1], np.ones_like(px)])
        normal /= np.linalg.norm(normal, axis=0)
        half = 380 * ideal_gradient(normal, name, (0.7 + 0.08 * contrast * fine) * rim)
        shine = gloss * 380 * ideal_gradient(normal, name, np.clip(1 + 0.25 * pores, 0.2, None) * rim)
        counts = np.stack([half + shine, half])
        if noise is None:
            out[name] = counts
            continue
        generator = np.random.default_rng([noise, i, round(1000 * (time + 10))])
        electrons = generator.poisson(10 * counts) + 10 * generator.standard_normal(counts.shape)
        out[name] = np.clip(np.round(electrons / 10), 0, 1023)
    return out


def light(
    time: float, *, names: tuple[str, ...] = STATIC, components: int = 2, scale: float = 1.0, **more: Any
) -> Light:
    """What `align` gathers of such a band."""
    counts = pictures(time, names=names, **more)
    parts = {
        name: scale * np.stack([2 * cross, parallel - cross]).astype(np.float32)[:components]
        for name, (parallel, cross) in counts.items()
    }
    return gathered(parts, ("diffuse", "specular")[:components], still=True)


def error(found: BandFlow, time: float, reference: float = 0.0) -> Array:
    """Endpoint error inside, pixels."""
    inner = ACTOR.surface(reference)[2]
    return np.asarray(np.hypot(*(found.flow - ACTOR.flow(reference, time)))[inner])


def test_what_a_band_shows_worked_out_by_hand() -> None:
    def both(diffuse: list[float], specular: list[float]) -> Array:
        return np.array([[diffuse], [specular]], np.float32)

    parts = {
        "C": both([4, 8], [1, 3]),
        "X": both([3, 2], [1, 1]),
        "Xc": both([1, 6], [0, 2]),
    }
    found = gathered(parts, ("diffuse", "specular"), still=True)
    np.testing.assert_array_equal(found.diffuse, [[8, 16]])
    assert found.specular is not None
    np.testing.assert_array_equal(found.specular, [[2, 6]])
    (share,) = found.shares
    np.testing.assert_allclose(share, [[1 + 2 / 4, 1 - 4 / 8]])
    # r_a + r_a' - r_c is 0 everywhere: nothing here is noise
    np.testing.assert_array_equal(found.diffuse_noise, 0)
    moved = gathered(parts, ("diffuse", "specular"), still=False)
    np.testing.assert_array_equal(moved.diffuse, [[4, 8]])
    assert moved.shares == ()


@pytest.mark.parametrize(
    ("kinds", "gloss", "most"),
    [
        # measured 0.03 to 0.05; the albedo has nothing in common here, so a flow on albedo is wrong by pixels
        (("specular",), 0.35, 0.1),
        (("relief",), 0.0, 0.1),
        (KINDS, 0.35, 0.1),
        (KINDS, 0.0, 0.1),
    ],
)
def test_bands_whose_albedo_has_nothing_in_common(kinds: tuple[Kind, ...], gloss: float, most: float) -> None:
    here = light(0, own_texture=5, gloss=gloss)
    for time in (-2.0, 1.5):
        found = band_flow(here, light(time, own_texture=6, gloss=gloss), kinds=kinds)
        assert np.hypot(*ACTOR.flow(0, time))[ACTOR.surface(0)[2]].mean() > 1.2
        assert error(found, time).mean() < most


def test_edges_match_where_an_albedo_changes_its_sign() -> None:
    here = light(0, contrast=0.7, gloss=0, names=("C",))
    found = band_flow(here, light(-2, contrast=-0.7, gloss=0, names=("C",)), kinds=("gradient",))
    # what is asked of this fallback; on brightness itself the opposite sign leads flows astray by pixels
    assert error(found, -2).mean() < 0.3
    assert found.parts == {"gradient": 1.0}


@pytest.mark.parametrize("kinds", [("specular",), KINDS])
def test_a_subject_that_held_still_stays(kinds: tuple[Kind, ...]) -> None:
    found = band_flow(light(0, own_texture=5), light(0, own_texture=6, noise=1), kinds=kinds)
    assert np.hypot(*found.flow)[ACTOR.surface(0)[2]].mean() < 0.05


def test_without_specular_light_its_noise_decides_nothing() -> None:
    found = band_flow(light(0, gloss=0), light(-2, gloss=0, noise=1))
    assert found.parts["specular"] < 0.05
    bright = band_flow(light(0), light(-2, noise=1))
    assert bright.parts["specular"] > 0.2
    assert sum(bright.parts.values()) == pytest.approx(1)


@pytest.mark.parametrize("scale", [2.0**-7, 2.0**8])
def test_the_power_of_a_band_does_not_matter(scale: float) -> None:
    here, there = light(0), light(-2, noise=1)
    found = band_flow(here, light(-2, noise=1, scale=scale))
    # powers of two, so that nothing is rounded elsewhere
    np.testing.assert_allclose(found.flow, band_flow(here, there).flow, atol=1e-5)


def test_doubt_is_larger_where_the_flow_is_wrong() -> None:
    found = band_flow(light(0, own_texture=5), light(-2, own_texture=6))
    off = error(found, -2)
    doubt = found.doubt_px[ACTOR.surface(0)[2]]
    worst = off > np.percentile(off, 90)
    assert doubt[worst].mean() > 1.2 * doubt[~worst].mean()


@pytest.mark.parametrize("what", ["black", "unknown", "noise", "smooth"])
def test_what_shows_nothing_has_no_flow(what: str) -> None:
    shape = ACTOR.shape
    generator = np.random.default_rng(3)
    other = {
        "black": np.zeros(shape),
        "unknown": np.full(shape, np.nan),
        "noise": generator.normal(100, 10, shape),
        "smooth": np.full(shape, 100.0) + generator.normal(0, 0.1, shape),
    }[what]
    there = gathered({"C": np.stack([other, 0 * other]).astype(np.float32)}, ("diffuse", "specular"), still=True)
    found = band_flow(light(0), there)
    assert not found.flow.any()
    assert not found.parts


def test_unknown_pixels_and_read_only_pictures_are_taken() -> None:
    counts = pictures(-2)
    parts = {n: np.stack([2 * c, p - c]).astype(np.float32) for n, (p, c) in counts.items()}
    for picture in parts.values():
        picture[:, 50:60, 70:80] = np.nan
        picture.flags.writeable = False
    there = gathered(parts, ("diffuse", "specular"), still=True)
    here = light(0)
    for array in (*here[:4], *here.shares, here.share_noise):
        array.flags.writeable = False  # type: ignore[union-attr]
    found = band_flow(here, there)
    assert np.isfinite(found.flow).all()
    assert error(found, -2).mean() < 0.1


def capture(folder: Path, *, one_camera: bool = False, times: dict[int, float] = TIMES, **more: Any) -> Path:
    """A capture of three bands, each taken at its own time."""
    polarisations = ("cross",) if one_camera else ("parallel", "cross")
    given = {}
    names = more.get("names", STATIC)
    for band, time in times.items():
        counts = pictures(time, contrast=CONTRAST[band], **more)
        for i, name in enumerate(names):
            for k, polarisation in ((0, "parallel"), (1, "cross")):
                if polarisation in polarisations:
                    given[i, float(band), polarisation] = counts[name][k].astype(np.uint16)
    items = {} if one_camera else {"homography": HOMOGRAPHY}
    return write_capture(folder, given, illumination=names, items=items)


Lightstage = Callable[..., Answer]


def run(lightstage: Lightstage, *words: str) -> Answer:
    return lightstage("run", "align", "--session", "p", "--json", *words)


def opened(done: Answer) -> xarray.Dataset:
    assert done.code == 0, done.err
    return xarray.open_zarr(done.json["nodes"]["align"]["path"], chunks=None)


def test_the_command_brings_bands_together(lightstage: Lightstage, tmp_path: Path) -> None:
    assert lightstage("import", capture(tmp_path / "p")).code == 0
    plain, align = opened(run(lightstage)), opened(run(lightstage, "--set", "align.bands=auto"))
    assert "band_flow" not in plain
    assert align.band_flow.dims == ("tracking", "band", "xy", "y", "x")
    assert align.band_confidence.dims == ("tracking", "band", "y", "x")
    assert align.attrs["bands"] == "auto"
    assert align.attrs["bands_aligned_to_nm"] == 497
    assert 0 < align.attrs["aligned_on_specular_655nm"] < 1
    assert not align.flow.values.any()
    # the band that the others come to is passed through, bit by bit
    np.testing.assert_array_equal(align.aligned.sel(band=497).values, plain.aligned.sel(band=497).values)
    inner = ACTOR.surface(0)[2]
    for b, (band, time) in enumerate(TIMES.items()):
        off = np.hypot(*(align.band_flow.values[0, b] - ACTOR.flow(0, time)))[inner]
        assert off.mean() < 0.1
        assert (align.band_confidence.values[0, b][inner] > 0.5).mean() > 0.9
        still = pictures(0, contrast=CONTRAST[band], noise=None)["C"]
        truth = np.stack([2 * still[1], still[0] - still[1]])
        for k in range(2):  # both components
            after, before = (d.aligned.sel(band=band).values[0, 0, k] for d in (align, plain))
            # noise is 6 to 9 counts; as captured, the moved bands are 18 to 47 off
            assert np.abs(after - truth[k])[inner].mean() < 10
            assert not time or np.abs(before - truth[k])[inner].mean() > 15


def test_a_point_that_leaves_the_picture_is_not_known(lightstage: Lightstage, tmp_path: Path) -> None:
    assert lightstage("import", capture(tmp_path / "p")).code == 0
    align = opened(run(lightstage, "--set", "align.bands=auto"))
    y, x = np.mgrid[0 : ACTOR.shape[0], 0 : ACTOR.shape[1]]
    for b in (0, 2):
        u = align.band_flow.values[0, b]
        outside = (x + u[0] > ACTOR.shape[1]) | (x + u[0] < -1) | (y + u[1] > ACTOR.shape[0]) | (y + u[1] < -1)
        assert outside.any()
        assert np.isnan(align.aligned.values[0, :, b][:, :, outside]).all()


@pytest.mark.parametrize("engine", ["motion", "joint"])
def test_bands_and_members_move(lightstage: Lightstage, tmp_path: Path, engine: str) -> None:
    """Between pictures the subject moves as ACTOR does, between bands it is shifted as a whole."""
    shifts = {407: (2.0, -1.0), 497: (0.0, 0.0), 655: (-1.5, 1.5)}
    given = {}
    for band, shift in shifts.items():
        counts = pictures(
            0, contrast=CONTRAST[band], names=STATIC, noise=band, member_time=lambda i: 0.5 * i, shift=shift
        )
        for i, name in enumerate(STATIC):
            given[i, float(band), "parallel"], given[i, float(band), "cross"] = counts[name].astype(np.uint16)
    folder = write_capture(tmp_path / "p", given, illumination=STATIC, items={"homography": HOMOGRAPHY})
    assert lightstage("import", folder).code == 0
    align = opened(run(lightstage, "--set", f"align.engine={engine}", "--set", "align.bands=auto"))
    captured = opened(run(lightstage))
    inner = ACTOR.surface(0)[2]
    for m in range(1, len(STATIC)):
        off = np.hypot(*(align.flow.values[0, m] - ACTOR.flow(0, 0.5 * m)))[inner]
        # what the engines do with one band: up to 0.09 and 0.18
        assert off.mean() < {"motion": 0.15, "joint": 0.25}[engine]
    for m in range(len(STATIC)):
        truth = 2 * pictures(0, contrast=CONTRAST[655], noise=None)[STATIC[m]][1]
        after, before = (d.aligned.sel(band=655).values[0, m, 0] for d in (align, captured))
        left = np.nanmean(np.abs(after - truth)[inner])
        # noise, resampled, is 4 to 6 counts; as captured the pictures are 7 (the dimmest) to 36 off
        assert left < 7
        assert np.abs(before - truth)[inner].mean() > 1.5 * left


def test_a_band_that_shows_nothing_is_named_and_stays(lightstage: Lightstage, tmp_path: Path) -> None:
    folder = capture(tmp_path / "p")
    for path in folder.glob("*_655nm_*.png"):
        cv2.imwrite(str(path), np.full(ACTOR.shape, 300, np.uint16))
    assert lightstage("import", folder).code == 0
    done = run(lightstage, "--set", "align.bands=auto")
    align = opened(done)
    assert "655 nm shows nothing by which it could be aligned to 497 nm" in done.err
    assert not align.band_flow.values[0, 2].any()
    assert (align.band_confidence.values[0, 2] < 0.5).all()
    assert (align.aligned.sel(band=655, component="diffuse").values == 600).all()


@pytest.mark.parametrize(
    ("bands", "names", "said"),
    [
        ("specular", STATIC, "bands: specular needs the specular component; this capture has diffuse"),
        ("relief", ("C", "X", "Y", "Z"), "bands: relief needs a gradient and its complement"),
    ],
)
def test_what_a_capture_lacks_is_said_in_a_sentence(
    lightstage: Lightstage, tmp_path: Path, bands: str, names: tuple[str, ...], said: str
) -> None:
    assert lightstage("import", capture(tmp_path / "p", one_camera=True, names=names)).code == 0
    done = run(lightstage, "--set", f"align.bands={bands}")
    assert done.code == 2
    assert said in done.err
    assert len(done.err.strip().splitlines()) == 1


def test_one_camera_and_one_light_at_a_time_are_aligned_too(lightstage: Lightstage, tmp_path: Path) -> None:
    names = ("L00", "L01", "L02", "L03")
    given = {}
    for band, time in TIMES.items():
        counts = pictures(time, contrast=CONTRAST[band], names=("X", "Xc", "Y", "Yc"))
        for i, picture in enumerate(counts.values()):
            given[i, float(band), "cross"] = picture[1].astype(np.uint16)
    folder = write_capture(tmp_path / "p", given, illumination=names)
    assert lightstage("import", folder).code == 0
    align = opened(run(lightstage, "--set", "align.bands=auto"))
    inner = ACTOR.surface(0)[2]
    for b, time in ((0, 1.5), (2, -2.0)):
        off = np.hypot(*(align.band_flow.values[0, b] - ACTOR.flow(0, time)))[inner]
        assert off.mean() < 0.3  # of edges alone


def test_a_performance_in_two_bands(lightstage: Lightstage, tmp_path: Path) -> None:
    given = {}
    for band, shift in ((497, (0.0, 0.0)), (655, (1.5, -1.0))):
        for i, name in enumerate(MINIMAL):
            one = pictures(
                0, contrast=CONTRAST[band], names=(name,), noise=i, member_time=lambda _, i=i: float(i), shift=shift
            )
            given[i, float(band), "cross"] = one[name][1].astype(np.uint16)
    frames = [{"illumination": name, "time_s": i / 60} for i, name in enumerate(MINIMAL)]
    folder = write_capture(tmp_path / "p", given, illumination=MINIMAL, frames=frames, frame_rate_hz=60.0)
    assert lightstage("import", folder).code == 0
    align = opened(run(lightstage, "--set", "align.bands=auto"))
    assert align.sizes["tracking"] == 3
    assert align.attrs["bands_aligned_to_nm"] == 655
    inner = ACTOR.surface(2)[2]
    off = np.hypot(*(align.band_flow.values[0, 0] - np.array([-1.5, 1.0])[:, None, None]))[inner]
    assert off.mean() < 0.5


def test_a_capture_of_one_band_has_none_to_align(lightstage: Lightstage, sphere: Path) -> None:
    assert lightstage("import", sphere).code == 0
    done = lightstage("run", "align", "--session", "ball", "--set", "align.bands=auto", "--json")
    assert "band_flow" not in opened(done)

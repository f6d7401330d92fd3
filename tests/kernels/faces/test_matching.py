"""Matched sets: figures by hand, what is promised of stored pictures, and what must not change."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.hw.head import pigments
from lightstage.kernels.appearance.colour import decode_srgb, encode_srgb
from lightstage.kernels.appearance.distant_lights import parse_lights
from lightstage.kernels.appearance.shading import shade
from lightstage.kernels.errors import KernelError
from lightstage.kernels.faces.face_frame import Frame, bring
from lightstage.kernels.faces.matching import Encoding, apart, figures, grey_setting, match, rings, spectrum
from tests.face_scenes import framed, view

SRGB = Encoding(encode_srgb, decode_srgb)
LINEAR = Encoding(np.asarray, np.asarray)
FRAME = Frame(32)


def faces(count: int) -> list[Any]:
    """Smooth random pictures of different mean, contrast and fineness, as unlike as shape and texture are."""
    generator = np.random.default_rng(5)
    rows, columns = FRAME.shape
    frequency = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.fftfreq(columns)[None, :])
    made = []
    for i in range(count):
        noise = np.fft.fft2(generator.standard_normal(FRAME.shape))
        field = np.real(np.fft.ifft2(noise / (0.02 + frequency) ** (1.0 + 0.2 * i)))
        field = field / field.std()
        made.append(0.35 + 0.06 * i + (0.06 + 0.01 * i) * (field + 0.1 * i * (field**2 - 1)))
    return made


def setting(encoding: Encoding = SRGB, background: float = float("nan")) -> Any:
    return grey_setting(FRAME.oval().astype(float), background, encoding)


def test_figures_by_hand() -> None:
    codes = np.array([[0, 255], [255, 255]], np.uint8)
    found = figures(codes, grey_setting(np.array([[1.0, 1.0], [1.0, 0.0]]), 0.5, LINEAR))
    # 0, 255, 255 are inside: mean 170, standard deviation 255 sqrt(2) / 3
    assert found.mean_linear == pytest.approx(170)
    assert found.contrast_code == pytest.approx(255 * np.sqrt(2) / 3)
    assert found.rms == pytest.approx(np.sqrt(2) / 2)


def test_spectrum_of_a_grating_by_hand() -> None:
    """0.2 cos over 5 cycles of the shorter side: two of its ring's frequencies hold 0.1 each, no other does."""
    rows, columns = 48, 40
    picture = 0.5 + 0.2 * np.cos(2 * np.pi * 5 * np.arange(columns) / columns) * np.ones((rows, 1))
    found = spectrum(picture)
    assert found[0] == pytest.approx(0.5)
    assert found[5] == pytest.approx(0.2 / np.count_nonzero(rings((rows, columns)) == 5))
    assert np.delete(found, [0, 5]).max() < 1e-12


@pytest.mark.parametrize("encoding", [SRGB, LINEAR], ids=["srgb", "linear"])
@pytest.mark.parametrize("methods", [["mean-contrast"], ["histogram"], ["spectrum"], ["histogram", "spectrum"]])
def test_a_set_is_equal_within_half_a_grey_level_as_stored(methods: list[str], encoding: Encoding) -> None:
    """What is promised: any two pictures within 0.5 grey level in mean and contrast, spectra within 1 %."""
    what = setting(encoding)
    matched = match(faces(4), what, methods)
    stored = [what.store(i, one.luminance) for i, one in enumerate(matched)]
    inside = what.oval > 0
    luminance = [255 * encoding.decode(codes / 255)[inside] for codes in stored]
    for values in (luminance, [codes[inside].astype(float) for codes in stored]):
        assert np.ptp([v.mean() for v in values]) < 0.5
        assert np.ptp([v.std() for v in values]) < 0.5
    if "spectrum" in methods:
        spectra = np.stack([spectrum(encoding.decode(codes / 255)) for codes in stored])[:, 1:]
        assert np.abs(spectra / spectra.mean(axis=0) - 1).max() < 0.01
    if methods == ["histogram"]:
        first = np.bincount(stored[0].ravel(), minlength=256)
        for codes in stored[1:]:
            np.testing.assert_array_equal(np.bincount(codes.ravel(), minlength=256), first)
    corner = {int(codes[0, 0]) for codes in stored}
    assert len(corner) == 1, "one background"


@pytest.fixture(scope="module")
def heads() -> list[Any]:
    """Luminance of six heads of different shape and skin, in the frame: shape, texture and both of each."""
    shapes, textures = [], []
    for seed in range(1, 7):
        seen = view(seed)
        placed = framed(seen, FRAME)
        shapes.append(shade(placed.normal, parse_lights("-30,15,0.5 30,15,0.5")).astype(float))
        skin = 0.8 * np.exp(-sum(pigments(seen.points, seed)))
        textures.append(bring(skin[None].astype(np.float32), placed.matrix, FRAME.shape)[0][0].astype(float))
    return [*shapes, *textures, *(s * t for s, t in zip(shapes, textures, strict=True))]


@pytest.mark.slow
@pytest.mark.parametrize("methods", [["mean-contrast"], ["spectrum"]])
def test_six_heads_are_equal_as_promised_and_hardly_clipped(heads: list[Any], methods: list[str]) -> None:
    matched = match(heads, setting(), methods, mean=0.4, contrast=0.08)
    off = apart(matched)
    before = apart(match(heads, setting(), []))
    assert before["mean_linear"] > 50
    assert before["spectrum"] > 0.5
    for name in ("mean_linear", "contrast_linear", "mean_code", "contrast_code"):
        assert off[name] < 0.5, name
    if "spectrum" in methods:
        assert off["spectrum"] < 0.01
    # the contrast of a dark hole in an even skin does not fit; a pixel in two hundred at most
    assert max(one.clipped for one in matched) < 0.005


def test_before_matching_the_set_is_far_apart() -> None:
    """Else the tests above would show nothing: grey levels, and parts of a ring."""
    off = apart(match(faces(4), setting(), []))
    assert off["mean_linear"] > 10
    assert off["contrast_linear"] > 2
    assert off["spectrum"] > 0.3


def test_an_exact_histogram_keeps_the_order_of_luminance() -> None:
    given_faces = faces(3)
    what = setting()
    inner = what.oval == 1
    for face, one in zip(given_faces, match(given_faces, what, ["histogram"]), strict=True):
        order = np.argsort(face[inner], kind="stable")
        assert (np.diff(one.luminance[inner][order]) >= 0).all()


def test_curves_keep_the_order_of_luminance() -> None:
    given_faces = faces(4)
    what = setting()
    inner = what.oval == 1
    for face, one in zip(given_faces, match(given_faces, what, ["mean-contrast"]), strict=True):
        order = np.argsort(face[inner], kind="stable")
        assert (np.diff(one.luminance[inner][order]) >= 0).all()


def test_ties_are_broken_the_same_way_each_time() -> None:
    flat = [np.round(face, 1) for face in faces(3)]  # a few levels only: nearly all pixels are tied
    what = setting()
    one, other = (match(flat, what, ["histogram", "spectrum"]) for _ in range(2))
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(what.store(0, a.luminance), what.store(0, b.luminance))


def test_mean_and_contrast_that_are_asked_for_are_met() -> None:
    what = setting()
    for one in match(faces(3), what, ["mean-contrast"], mean=0.4, contrast=0.08):
        assert one.figures.mean_linear == pytest.approx(255 * 0.4, abs=0.5)
        assert one.figures.contrast_linear == pytest.approx(255 * 0.08, abs=0.5)
        assert one.clipped == 0


def test_clipping_is_counted() -> None:
    matched = match(faces(2), setting(), ["mean-contrast"], mean=0.9, contrast=0.2)
    assert all(one.clipped > 0.05 for one in matched)


@settings(max_examples=8, deadline=None)
@given(st.floats(0.5, 2.0), st.floats(-0.1, 0.1))
def test_a_face_in_other_light_comes_out_the_same(gain: float, shift: float) -> None:
    """The set's targets move with it, so it is held against a set that has them given."""
    face, other = faces(2)
    asked: dict[str, float] = {"mean": 0.5, "contrast": 0.08}
    plain = match([face, other], setting(), ["mean-contrast"], **asked)[0]
    changed = match([gain * face + shift, other], setting(), ["mean-contrast"], **asked)[0]
    np.testing.assert_allclose(changed.luminance, plain.luminance, atol=1 / 255)


def test_inputs_may_be_read_only_and_stay() -> None:
    given_faces = faces(2)
    kept = [face.copy() for face in given_faces]
    for face in given_faces:
        face.flags.writeable = False
    match(given_faces, setting(), ["histogram", "spectrum"])
    for face, before in zip(given_faces, kept, strict=True):
        np.testing.assert_array_equal(face, before)


def test_wrong_requests_are_named() -> None:
    with pytest.raises(KernelError, match="no way of matching"):
        match(faces(1), setting(), ["mode"])
    with pytest.raises(KernelError, match="no contrast"):
        match([np.full(FRAME.shape, 0.5)], setting(), ["mean-contrast"])

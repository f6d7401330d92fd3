"""The pages of skin: maps and spectra are drawn."""

import io

import numpy as np
from PIL import Image

from lightstage.products.skin import spectra
from lightstage.products.skin_pages import maps_page, spectra_page
from tests.products.test_skin import skin


def opened(data: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))


def test_points_are_marked_in_the_maps() -> None:
    made = skin()
    with_points, without = (opened(maps_page(made, spectra(made, [(20, 10)])[:count])) for count in (2, 1))
    assert with_points.shape == without.shape == (opened(maps_page(made, [])).shape)
    changed = np.argwhere((with_points != without).any(axis=2))
    assert 10 < len(changed) < 1000
    assert changed[:, 1].max() < with_points.shape[1] / 2  # in the picture in colour, upper left


def test_spectra_are_drawn_in_their_colours() -> None:
    made = skin()
    page = opened(spectra_page(made, spectra(made, [(20, 10)])))
    for colour in ((31, 119, 180), (255, 127, 14)):  # C0 and C1 of matplotlib
        assert (np.abs(page.astype(int) - colour).max(axis=2) <= 2).sum() > 50

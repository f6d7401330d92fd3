"""matplotlib for files, its font, and the colour scale."""

import io

import numpy as np
from PIL import Image

from lightstage.products.figures import colours, font, png_of, pyplot


def test_a_figure_is_a_png_and_is_closed() -> None:
    plt = pyplot()
    assert plt.get_backend().lower() == "agg"
    figure, axis = plt.subplots(figsize=(2, 1))
    axis.plot([0, 1])
    with Image.open(io.BytesIO(png_of(figure))) as picture:
        assert picture.size == (220, 110)
        assert np.asarray(picture).std() > 5
    assert figure.number not in plt.get_fignums()


def test_the_font_has_the_degree_sign() -> None:
    sizes = [font(size).getlength("12°") for size in (13, 26)]
    assert sizes[1] > 1.8 * sizes[0]
    assert font(13) is font(13)
    assert font(20).getmask("°").getbbox() is not None


def test_the_scale_is_viridis_and_never_black() -> None:
    assert colours()[[0, 255]].tolist() == [[68, 1, 84], [253, 231, 37]]
    assert colours().max(axis=1).min() > 80

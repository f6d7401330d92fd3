"""The page of an alignment: where things are, and in which colours."""

import numpy as np

from lightstage.products.alignment import AlignedSet, residual_of
from lightstage.products.alignment_page import (
    POINT_RGB,
    UNKNOWN_RGB,
    UNKNOWN_VALUE_RGB,
    Page,
    as_colours,
    as_grey,
    box,
    draw,
)
from tests.products.test_alignment import SHAPE, read


def test_greys_and_colours_by_hand() -> None:
    values = np.array([[0, 1, 2, np.nan]], np.float32)
    grey = as_grey(values, 2.0)[0].tolist()
    assert grey == [[0] * 3, [round(255 * 0.5 ** (1 / 2.2))] * 3, [255] * 3, list(UNKNOWN_RGB)]
    assert as_colours(values, 2.0)[0, [0, 2, 3]].tolist() == [[68, 1, 84], [253, 231, 37], list(UNKNOWN_VALUE_RGB)]


def test_boxes_are_odd_and_have_a_least_size() -> None:
    assert box(28) == (3, 7)
    assert box(406) == (14, 29)


def test_the_page_has_a_column_a_picture_and_the_points_in_each() -> None:
    made = read()
    page = draw(made, [(14, 12)], residual_of(made))
    layout = Page(SHAPE, 3)
    assert page.shape == (layout.size[1], layout.size[0], 3)
    for column in range(3):
        for row in (0, 1):
            x, y = (int(v) for v in layout.at(column, row, (16, 12)))
            assert page[y, x].tolist() == list(POINT_RGB[0])  # the cross hair, right of the point
    # as captured X is two pixels to the right of where it is once aligned
    left, top = layout.left(0), layout.top(0)
    first = page[top : top + layout.panel[1], left : left + layout.panel[0], 0].astype(int)
    second = page[layout.top(1) : layout.top(1) + layout.panel[1], left : left + layout.panel[0], 0].astype(int)
    assert np.abs(first - second).max() > 20


def test_what_is_left_out_and_what_lacks_a_pair_are_drawn_too() -> None:
    made = read()
    made.columns[0].confidence[:] = 0
    page = draw(AlignedSet("a", 1, "motion", made.columns[:2]), [], None)
    assert page.std() > 10

"""A frame of the film: its colours by hand, and where they are."""

import numpy as np
import pytest

from lightstage.products.film_page import NO_CHANGE_RGB, Layout, angle_deg, as_colour, as_map, relit


def test_by_hand() -> None:
    up, front = np.array([[[0, 1, 0]]], np.float32), np.array([[[0, 0, 1]]], np.float32)
    assert angle_deg(up, front)[0, 0] == pytest.approx(90)
    assert angle_deg(up, up)[0, 0] == 0
    assert as_colour(up, "opengl").tolist() == [[[128, 255, 128]]]
    assert as_colour(up, "directx").tolist() == [[[128, 0, 128]]]
    assert relit(up).tolist() == [[[76, 76, 76]]]  # 0.3 x 255
    assert relit(-up).tolist() == [[[0, 0, 0]]]


def test_the_scale_of_the_change() -> None:
    change = np.array([[0, 5, 10, 20, np.nan]], np.float32)
    colour = as_map(change, 10, (1, 5))[0].tolist()
    assert colour[0] == [68, 1, 84]  # the ends of viridis
    assert colour[2] == colour[3] == [253, 231, 37]
    assert colour[4] == [0, 0, 0]
    assert (as_map(None, 10, (1, 2)) == NO_CHANGE_RGB).all()


@pytest.mark.parametrize(("shape", "panel"), [((12, 16), (368, 276)), ((900, 1280), (640, 450))])
def test_panels_are_as_large_as_they_need_to_be(shape: tuple[int, int], panel: tuple[int, int]) -> None:
    layout = Layout(shape, convention="opengl", top_deg=10)
    assert layout.panel == panel
    assert not any(size % 2 for size in layout.size)
    normal = np.zeros((*shape, 3), np.float32)
    normal[..., 2] = 1
    first, second = layout.draw("one", normal, None), layout.draw("two", normal, normal)
    assert first.shape == (layout.size[1], layout.size[0], 3)
    middle = layout.top + panel[1] // 2
    assert first[middle, layout.left(0) + panel[0] // 2].tolist() == [128, 128, 255]
    assert first[middle, layout.left(2) + panel[0] // 2].tolist() == list(NO_CHANGE_RGB)
    assert second[middle, layout.left(2) + panel[0] // 2].tolist() == [68, 1, 84]

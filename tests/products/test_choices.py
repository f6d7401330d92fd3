"""What can be chosen agrees with what can be made."""

from lightstage.formats import meshes, video
from lightstage.products import choices
from lightstage.products.alignment_page import POINT_RGB
from lightstage.products.film_page import Layout


def test_every_format_has_a_writer() -> None:
    assert choices.MESH_FORMATS == meshes.FORMATS
    assert choices.FILMS == video.FORMATS
    every = [*choices.PLANE_FORMATS, *choices.FILM_FORMATS, *choices.MESH_FORMATS]
    assert len(every) == len(set(every))  # `export --format` takes them all


def test_every_marked_point_has_a_colour_of_its_own() -> None:
    assert len(set(POINT_RGB)) == choices.ALIGNMENT_POINTS


def test_every_convention_can_be_drawn() -> None:
    for convention in choices.CONVENTIONS:
        assert Layout((12, 16), convention=convention, top_deg=1).panel == (368, 276)

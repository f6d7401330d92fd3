"""What two cameras, or one, can be split into."""

import pytest

from lightstage.dag.stage import Grid
from lightstage.stages.split import STAGE, components

REGISTERED = Grid(
    {"frame": 3, "band": 2, "polarisation": 2, "y": 4, "x": 6},
    {
        "illumination": (("frame",), ["C", "X", "Xc"]),
        "band": (("band",), [434.0, 576.0]),
        "polarisation": (("polarisation",), ["parallel", "cross"]),
    },
)


@pytest.mark.parametrize(
    ("polarisations", "parts", "lacks"),
    [
        (["parallel", "cross"], ("diffuse", "specular"), None),
        (["cross"], ("diffuse",), "specular: needs the parallel camera"),
        (
            ["parallel"],
            ("total",),
            "diffuse and specular: need the cross camera; total = diffuse / 2 + specular",
        ),
        (["unpolarised"], ("total",), "diffuse and specular: need both polarisations; total = diffuse + specular"),
    ],
)
def test_what_can_be_made_and_what_is_said_of_the_rest(
    polarisations: list[str], parts: tuple[str, ...], lacks: str | None
) -> None:
    assert components(polarisations) == parts
    grid = STAGE.arrange([REGISTERED], {"polarisation": polarisations}, STAGE.params()).grid
    assert grid.labels["component"] == (("component",), list(parts))
    assert dict(grid.sizes) == {"frame": 3, "band": 2, "component": len(parts), "y": 4, "x": 6}
    assert grid.attrs.get("cannot_be_made") == lacks


def test_other_labels_pass_through() -> None:
    arranged = STAGE.arrange([REGISTERED], {"polarisation": ["parallel", "cross"]}, STAGE.params())
    assert set(arranged.grid.labels) == {"illumination", "band", "component"}
    assert arranged.grid.labels["band"] == REGISTERED.labels["band"]
    assert arranged.groups == ()  # each block from the one of its index


def test_a_block_is_told_which_cameras_there_are_and_nothing_else() -> None:
    assert STAGE.context is not None
    facts = {"polarisation": ["cross"], "mount": {"CAM0": {"rotate": 180}}, "illumination": ["C"]}
    assert STAGE.context({}, facts, {"bands": {}}, STAGE.params()) == {"polarisations": ["cross"]}

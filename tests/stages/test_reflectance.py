"""Which pictures tell constant light, what scale the albedo has, and what is refused."""

import pytest

from lightstage.dag.stage import Grid, StageError
from lightstage.stages.reflectance import STAGE


def grids(members: list[str], arrays: frozenset[str] = frozenset({"normal"})) -> list[Grid]:
    frames = list(range(len(members)))
    aligned = Grid(
        {"tracking": 1, "member": len(members), "band": 1, "component": 1, "y": 8, "x": 8},
        {
            "tracking": (("tracking",), [members.index("C") if "C" in members else 0]),
            "illumination": (("tracking", "member"), [members]),
            "frame": (("tracking", "member"), [frames]),
            "band": (("band",), [576.0]),
            "component": (("component",), ["diffuse"]),
        },
    )
    relief = Grid({"tracking": 1}, {"tracking": aligned.labels["tracking"]}, arrays=arrays)
    return [aligned, relief]


FACTS = {
    "frame_rate_hz": None,
    "items": {"bands": {}, "lights": {}},
    "polarisation": ["parallel", "cross"],
}


def test_of_a_moving_subject_only_the_tracking_frame_counts() -> None:
    members = ["X", "C", "Xc", "C"]
    still = STAGE.arrange(grids(members), FACTS, STAGE.params())
    moving = STAGE.arrange(grids(members), {**FACTS, "frame_rate_hz": 60.0}, STAGE.params())
    assert list(still.groups[0].reads["radiance"]) == [(576.0, "X"), (576.0, "C"), (576.0, "Xc")]
    assert list(moving.groups[0].reads["radiance"]) == [(576.0, "C")]
    assert moving.groups[0].reads["irradiance"] == {1: {"tracking": 0}}
    assert still.grid.attrs == {"shading": "smooth", "scale": "absolute", "component": "diffuse"}


def test_what_cannot_be_done_is_refused() -> None:
    with pytest.raises(StageError, match="shading: geometry needs a surface"):
        STAGE.arrange(grids(["C"]), FACTS, STAGE.params(shading="geometry"))
    with pytest.raises(StageError, match=r"reflectance needs constant light.* the session has L00 L01"):
        STAGE.arrange(grids(["L00", "L01"]), FACTS, STAGE.params())
    without = STAGE.arrange(grids(["C"]), {**FACTS, "items": {}}, STAGE.params())
    assert without.grid.attrs["scale"] == "relative"
    alone = STAGE.arrange(grids(["C"]), {**FACTS, "polarisation": ["parallel"]}, STAGE.params())
    assert alone.grid.attrs["scale"] == "relative"  # half of the diffuse light, all of the gloss

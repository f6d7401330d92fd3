"""What gloss reads, which model of the rig it has, and what is refused."""

from typing import Any

import pytest

from lightstage.dag.stage import Grid, StageError
from lightstage.stages.gloss import STAGE, GlossParams
from tests.scenes import STATIC


def grids(names: tuple[str, ...], component: str = "specular") -> list[Grid]:
    labels: dict[str, Any] = {
        "band": (("band",), [576.0]),
        "component": (("component",), ["diffuse", "specular"]),
        "tracking": (("tracking",), [0]),
        "illumination": (("tracking", "member"), [list(names)]),
        "frame": (("tracking", "member"), [list(range(len(names)))]),
    }
    sizes = {"tracking": 1, "member": len(names), "band": 1, "component": 2, "y": 4, "x": 4}
    normals = Grid({"tracking": 1}, {"tracking": (("tracking",), [0])}, {"component": component})
    return [Grid(sizes, labels), normals, normals]


LIGHTS = {"lights": [{"id": "L00", "position_mm": [0, 0, 790]}]}
FACTS = {"items": {"camera": {}, "lights": LIGHTS}, "frame_rate_hz": None}


def test_a_diffuse_node_is_refused() -> None:
    with pytest.raises(StageError, match="in this order"):
        STAGE.arrange(grids(STATIC, "diffuse"), FACTS, GlossParams())


def test_constant_light_alone_is_refused() -> None:
    with pytest.raises(StageError, match="a gradient of every axis"):
        STAGE.arrange(grids(("C",)), FACTS, GlossParams())


def test_without_bands_the_intensity_is_relative() -> None:
    arranged = STAGE.arrange(grids(STATIC), FACTS, GlossParams())
    assert arranged.grid.attrs["scale"] == "relative"
    assert arranged.grid.attrs["model"] == "sphere"  # this surface has no depth


def test_a_surface_under_placed_lights_is_compared_with_the_rig() -> None:
    aligned, specular, relief = grids(STATIC)
    deep = Grid(relief.sizes, relief.labels, relief.attrs, frozenset({"normal", "depth_mm"}))
    arranged = STAGE.arrange([aligned, specular, deep], FACTS, GlossParams())
    assert arranged.grid.attrs["model"] == "rig"
    assert list(arranged.groups[0].reads["radiance"]) == [(576.0, name) for name in STATIC]
    directions = {"lights": [{"id": "L00", "position_mm": None}]}
    distant = {**FACTS, "items": {"camera": {}, "lights": directions}}
    assert STAGE.arrange([aligned, specular, deep], distant, GlossParams()).grid.attrs["model"] == "sphere"

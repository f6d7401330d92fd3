"""Which pictures the normals of a tracking frame are made from, and what is refused."""

from typing import Any

import pytest

from lightstage.dag.stage import Grid, StageError
from lightstage.stages.normals import STAGE, NormalsParams
from tests.scenes import STATIC


def test_the_qp_correction_is_for_diffuse_light() -> None:
    """Its 1/3 and 2/3 are the diffuse lobe's; a specular lobe has up to 1/2 and 1, by its roughness."""
    sizes = {"tracking": 1, "member": len(STATIC), "band": 1, "component": 2, "y": 4, "x": 4}
    labels: dict[str, Any] = {
        "tracking": (("tracking",), [0]),
        "illumination": (("tracking", "member"), [list(STATIC)]),
        "frame": (("tracking", "member"), [list(range(len(STATIC)))]),
        "band": (("band",), [0.0]),
        "component": (("component",), ["diffuse", "specular"]),
    }
    aligned = Grid(sizes, labels, arrays=frozenset({"aligned"}))
    facts = {"frame_rate_hz": None, "illumination": list(STATIC), "time_s": [None] * len(STATIC), "items": {}}
    with pytest.raises(StageError, match="constants of the diffuse lobe"):
        STAGE.arrange([aligned], facts, NormalsParams(correct="qp", component="specular"))
    assert STAGE.arrange([aligned], facts, NormalsParams(correct="qp")).groups

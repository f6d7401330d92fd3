"""Which frames make an illumination, and what counts are divided by."""

from typing import Any

import pytest

from lightstage.dag.stage import Grid, StageError
from lightstage.stages.stack import STAGE


def parts(illumination: list[str], bands: list[float], **attrs: Any) -> Grid:
    return Grid(
        {"frame": len(illumination), "band": len(bands), "component": 1, "y": 2, "x": 2},
        {
            "illumination": (("frame",), illumination),
            "time_s": (("frame",), [float(i) for i in range(len(illumination))]),
            "band": (("band",), bands),
            "component": (("component",), ["diffuse"]),
        },
        attrs,
    )


STILL: dict[str, Any] = {"frame_rate_hz": None}


def test_a_static_capture_is_by_illumination_in_the_order_they_came() -> None:
    arranged = STAGE.arrange([parts(["X", "C", "X"], [434.0, 576.0])], STILL, STAGE.params())
    assert dict(arranged.grid.sizes) == {"illumination": 2, "band": 2, "component": 1, "y": 2, "x": 2}
    assert arranged.grid.along("illumination") == ["X", "C"]
    assert arranged.grid.along("frame") == [0, 1]  # the first of each
    assert "time_s" not in arranged.grid.labels  # of several pictures there is no one time
    assert arranged.dims == {"illumination|frame": "illumination"}
    # groups in C order: illumination, then band; pieces by frame
    assert [dict(group.labels) for group in arranged.groups] == [
        {"illumination": name, "band": nm, "members": members}
        for name, members in (("X", [0, 2]), ("C", [1]))
        for nm in (434.0, 576.0)
    ]
    assert arranged.groups[1].reads == {"signal": {0: {"frame": 0, "band": 1}, 2: {"frame": 2, "band": 1}}}
    assert arranged.groups[2].reads == {"signal": {1: {"frame": 1, "band": 0}}}


def test_a_performance_keeps_its_frames_and_their_times() -> None:
    arranged = STAGE.arrange([parts(["C", "X", "C"], [0.0])], {"frame_rate_hz": 60.0}, STAGE.params())
    assert arranged.grid.sizes["frame"] == 3
    assert arranged.grid.labels["time_s"] == (("frame",), [0.0, 1.0, 2.0])
    assert arranged.dims == {"illumination|frame": "frame"}
    assert arranged.groups[2].reads == {"signal": {2: {"frame": 2, "band": 0}}}


def test_what_cannot_be_made_is_passed_on_and_units_are_not() -> None:
    grid = parts(["C"], [0.0], cannot_be_made="specular: needs the parallel camera", units="counts")
    attrs = STAGE.arrange([grid], STILL, STAGE.params()).grid.attrs
    assert attrs == {"cannot_be_made": "specular: needs the parallel camera"}


FACTS: dict[str, Any] = {"intensities": {"L00": [1.0, 4.0]}, "bands_nm": [434.0, 576.0]}
BANDS = {"bands": {"bands": [{"centre_nm": 576.0, "exposure": 10.0, "transmission": 0.5, "source": 2.0}]}}


@pytest.mark.parametrize(
    ("name", "items", "scale"),
    [
        ("L00", BANDS, 10 * 0.5 * 2 * 4),
        ("C", BANDS, 10 * 0.5 * 2),
        ("L00", {}, 4),
        ("C", {}, 1),  # counts, as the result says
    ],
)
def test_bands_and_intensities_divide_out(name: str, items: dict[str, Any], scale: float) -> None:
    assert STAGE.context is not None
    labels = {"illumination": name, "band": 576.0, "members": [3]}
    assert STAGE.context(labels, FACTS, items, STAGE.params()) == {"counts_per_radiance": scale, "exposure": None}


@pytest.mark.parametrize(
    ("named", "shares"),
    [
        ([0.1, 0.1, 0.1], None),  # all the same: as if they had not been named
        ([0.1, 0.4, 0.1], [1.0, 4.0]),
        ([0.1, 0.4, 0.2], [0.25, 1.0]),  # of equally frequent ones the longest
    ],
)
def test_exposures_count_in_units_of_the_usual_one(named: list[float], shares: list[float] | None) -> None:
    assert STAGE.context is not None
    labels = {"illumination": "C", "band": 576.0, "members": [0, 1]}
    context = STAGE.context(labels, {**FACTS, "exposure_s": named}, {}, STAGE.params())
    assert context["exposure"] == (None if shares is None else pytest.approx(shares))


def test_exposures_are_named_for_all_frames_or_for_none() -> None:
    assert STAGE.context is not None
    labels = {"illumination": "C", "band": 576.0, "members": [0, 1]}
    with pytest.raises(StageError, match="frame 1 names no exposure_s, and others do"):
        STAGE.context(labels, {**FACTS, "exposure_s": [0.1, None]}, {}, STAGE.params())


def test_a_band_that_the_item_lacks_is_named() -> None:
    assert STAGE.context is not None
    with pytest.raises(StageError, match=r"the bands item has no band at 434 nm \(it has 576\)"):
        STAGE.context({"illumination": "C", "band": 434.0, "members": [0]}, FACTS, BANDS, STAGE.params())

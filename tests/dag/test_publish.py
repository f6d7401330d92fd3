"""What a result says of itself: figures averaged over its blocks, each warning once, and how it was made."""

from dataclasses import replace
from typing import Any

import pytest

from lightstage.dag.plan import State
from lightstage.dag.publish import plain_parts, publish_results, result_attrs
from lightstage.store.errors import WorkError
from lightstage.store.grid import open_dataset
from lightstage.store.results import current, provenance
from tests.dag.conftest import Tiny


def computed(tiny: Tiny, *changes: dict[str, Any], **more: Any) -> State:
    """All blocks, known; those of `scaled` with changes to their records."""
    tiny.run(*more.pop("nodes", ()))
    state = tiny.state(**more)
    node = state.nodes["scaled"]
    node.records = [
        replace(record, **change)
        for record, change in zip(node.records, changes or ({}, {}, {}), strict=True)
        if record is not None
    ]
    return state


def test_figures_are_averaged_over_the_blocks_that_tell_them(tiny: Tiny) -> None:
    state = computed(
        tiny,
        {"stats": {"error": 1.0, "part": 0.5}},
        {"stats": {"error": 3.0}},
        {"stats": {"error": 5.0, "part": 1.0}},
    )
    attrs = result_attrs(state, state.nodes["scaled"])
    assert (attrs["error"], attrs["part"]) == (3.0, 0.75)


def test_a_warning_is_said_once_and_in_the_order_of_the_blocks(tiny: Tiny) -> None:
    state = computed(tiny, {"warnings": ("b", "a")}, {}, {"warnings": ("a", "c")})
    assert result_attrs(state, state.nodes["scaled"])["warnings"] == ["b", "a", "c"]
    assert "warnings" not in result_attrs(state, state.nodes["summed"])


def test_a_result_names_its_node_parameters_and_what_was_absent(tiny: Tiny) -> None:
    state = computed(tiny)
    attrs = result_attrs(state, state.nodes["scaled"])
    assert {name: attrs[name] for name in ("session", "node", "stage", "parameters", "calibration_items")} == {
        "session": "c",
        "node": "scaled",
        "stage": "scaled",
        "parameters": {"gain": 1.0},
        "calibration_items": {},
    }
    assert attrs["recipe"] == state.nodes["scaled"].plan.recipe
    assert attrs["calibration_absent"] == "bands: exposures"
    assert "partial" not in attrs
    assert "calibration_absent" not in result_attrs(state, state.nodes["summed"])


def test_a_part_of_a_result_says_so(tiny: Tiny) -> None:
    state = computed(tiny, frames=(1, 3))
    assert result_attrs(state, state.nodes["scaled"])["partial"] == "2 of 3 blocks"


def test_a_published_result_is_current_and_says_how_it_was_made(tiny: Tiny) -> None:
    state = computed(tiny)
    before = current("c", "summed", tiny.store)
    keys = {str(state.nodes["scaled"].keys[0])}
    results = publish_results(state, tiny.store, {"python": "3"}, keys)
    assert set(results) == {"scaled", "summed"}  # a session is no result
    assert (results["scaled"].computed, results["scaled"].reused) == (1, 2)
    assert results["scaled"].seconds == state.nodes["scaled"].records[0].seconds  # type: ignore[union-attr]
    path = results["summed"].path
    assert path is not None
    assert current("c", "summed", tiny.store) == path.name == before
    record = provenance("c", "summed", path.name, tiny.store)
    assert record is not None
    assert record["above"] == {"scaled": current("c", "scaled", tiny.store)}
    (values,) = record["inputs"].values()
    assert values == [r.outputs["value"][0].value for r in state.nodes["scaled"].records if r is not None]
    assert record["parts"] == plain_parts(state.nodes["summed"].plan)
    assert results["summed"].files.keys() == {"total/c.0.0.0.0"}


def test_what_differs_from_run_to_run_is_not_in_the_group(tiny: Tiny) -> None:
    state = computed(tiny)
    path = publish_results(state, tiny.store, {}, set())["scaled"].path
    assert path is not None
    assert set(open_dataset(path).attrs) == {
        "session",
        "node",
        "stage",
        "recipe",
        "parameters",
        "calibration_items",
        "calibration_absent",
    }
    again = publish_results(state, tiny.store, {"python": "another"}, set())["scaled"].path
    assert again == path


def test_a_result_that_is_removed_again_and_again_is_said(tiny: Tiny, monkeypatch: pytest.MonkeyPatch) -> None:
    state = computed(tiny)
    monkeypatch.setattr("lightstage.dag.publish.set_current", lambda *_: False)
    with pytest.raises(WorkError, match="was removed while it was published"):
        publish_results(state, tiny.store, {}, set())


def test_contexts_stand_by_block_for_people(tiny: Tiny) -> None:
    plan = tiny.state().plan.nodes["scaled"]
    assert plain_parts(plan)["context"] == {
        "frame 0 (C)": {"exposure": 1.0},
        "frame 1 (X)": {"exposure": 1.0},
        "frame 2 (Y)": {"exposure": 1.0},
    }

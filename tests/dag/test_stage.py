"""What a stage says of itself: names of functions, what each of them gets, and refusals."""

import pytest
from pydantic import Field, ValidationError

from lightstage.dag.stage import (
    Arrangement,
    Finding,
    Grid,
    Input,
    Params,
    Result,
    Stage,
    StageError,
    evaluate,
    function,
    refusal,
)
from tests.store.tiny import kernels
from tests.store.tiny.scaled import STAGE as SCALED

RESULT = Result(arrays={"a": [2.0, 4.0]}, labels={"x": [0]}, attrs={"gain": 3.0}, facts={"bits": 10}, items={})


class Knobs(Params):
    sigma_px: float = Field(1.5, gt=0, description="width")
    count: int = Field(3, description="how many")


def verdict(*, arrays: dict[str, list[float]], attrs: dict[str, float]) -> list[tuple[str, str]]:
    """Gets two of the five fields, because it names two."""
    return [("good", f"{sum(arrays['a']) * attrs['gain']:g}")]


def stage(**more: object) -> Stage:
    return Stage(
        name="s",
        version=1,
        summary="",
        params=Knobs,
        outputs={},
        blocks=(),
        arrange=lambda grids, facts, params: Arrangement(grids[0]),
        **more,  # type: ignore[arg-type]
    )


def test_a_name_leads_to_its_function() -> None:
    assert function("tests.store.tiny.kernels:scaled") is kernels.scaled
    with pytest.raises(AttributeError):
        function("tests.store.tiny.kernels:nothing")
    with pytest.raises(ModuleNotFoundError):
        function("tests.store.nothing:scaled")


def test_a_judge_gets_the_fields_that_it_names() -> None:
    assert evaluate(f"{__name__}:verdict", RESULT) == [("good", "18")]
    assert Finding("good", "18") == ("good", "18")


def test_only_what_was_meant_as_a_refusal_is_one() -> None:
    class KernelError(ValueError):
        sentence = "the pictures are dark"

    assert refusal(StageError("no light")) == "no light"
    assert refusal(KernelError("internal")) == "the pictures are dark"
    assert refusal(ValueError("operands could not be broadcast")) is None
    nameless = ValueError()
    nameless.sentence = 3  # type: ignore[attr-defined]
    assert refusal(nameless) is None


@pytest.mark.parametrize(
    "given", [{"sigma": 1.0}, {"sigma_px": -1.0}, {"sigma_px": float("nan")}, {"sigma_px": "2"}, {"count": 2.5}]
)
def test_parameters_are_what_they_were_declared(given: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        Knobs.model_validate(given)


def test_parameters_never_change() -> None:
    knobs = Knobs(count=4)
    assert (knobs.sigma_px, knobs.count) == (1.5, 4)
    with pytest.raises(ValidationError, match="frozen"):
        knobs.count = 5  # type: ignore[misc]


def test_a_stage_reads_as_many_nodes_as_its_inputs_name() -> None:
    assert stage().sources == 0
    assert stage(inputs={"a": Input("a", ("x",)), "b": Input("b", ("x",), source=2)}).sources == 3


def test_a_stage_without_a_kernel_brings_in_a_session() -> None:
    assert stage().is_source
    assert not SCALED.is_source


def test_the_modules_of_what_it_names_each_once() -> None:
    assert stage().modules == []
    assert SCALED.modules == ["tests.store.tiny.kernels"]
    names = {"kernel": "a.b:k", "prepare": "a.c:p", "item": "a.b:i", "verdict": "a.d:v"}
    assert stage(**names).modules == ["a.b", "a.c", "a.d"]


def test_a_grid_tells_what_stands_along_a_dimension() -> None:
    grid = Grid({"frame": 2}, {"illumination": (("frame",), ["C", "X"])})
    assert grid.along("illumination") == ["C", "X"]
    with pytest.raises(KeyError):
        grid.along("band")

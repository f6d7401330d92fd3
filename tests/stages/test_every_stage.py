"""What holds for every stage in the table."""

import inspect
from importlib import import_module

import pytest

from lightstage.dag.stage import Params, Stage, function
from lightstage.stages import TABLE


@pytest.fixture(params=sorted(TABLE))
def stage(request: pytest.FixtureRequest) -> Stage:
    found: Stage = import_module(TABLE[request.param]).STAGE
    assert found.name == request.param
    return found


def test_the_kernels_signature_is_inputs_and_what_is_prepared_and_parameters(stage: Stage) -> None:
    if stage.is_source:
        return
    assert stage.kernel is not None
    names = list(inspect.signature(function(stage.kernel)).parameters)
    required = [*stage.inputs, *stage.prepared]
    assert names[: len(stage.inputs)] == list(stage.inputs)
    assert set(required) <= set(names)
    assert set(names) - set(required) <= set(stage.params.model_fields)


def test_every_parameter_reaches_something_and_says_what_it_is(stage: Stage) -> None:
    source = inspect.getsource(inspect.getmodule(stage.arrange))  # type: ignore[arg-type]
    named = [function(name) for name in (stage.kernel, stage.prepare) if name is not None]
    taken = {name for each in named for name in inspect.signature(each).parameters}
    for name, field in stage.params.model_fields.items():
        assert field.description, name
        assert not field.is_required(), f"{name} has no default"
        assert name in taken or source.count(name) >= 2, f"{name} is declared and never used"
    assert issubclass(stage.params, Params)


def test_whole_dimensions_come_last_and_block_dimensions_are_not_among_them(stage: Stage) -> None:
    for name, output in stage.outputs.items():
        whole = [dim for dim in output.dims if dim in output.whole]
        assert list(output.dims[len(output.dims) - len(whole) :]) == whole, name
        # what lacks a block dimension is made only where an arrangement names fewer
        assert stage.blocks[0] in output.dims, name
        assert not set(stage.blocks) & set(whole), name


def test_the_docstring_states_its_source(stage: Stage) -> None:
    module = inspect.getmodule(stage.arrange)
    assert module is not None
    assert module.__doc__ is not None
    assert module.__doc__.startswith(f"{stage.name}: ")
    assert stage.is_source or "ource" in module.__doc__

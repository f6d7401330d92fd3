"""What holds for every stage in the table."""

import inspect
import subprocess
import sys
from importlib import import_module

import pytest

from lightstage.dag.stage import Params, Stage, function
from lightstage.stages import TABLE

HEAVY = ("numpy", "cv2", "numba", "scipy", "skimage", "colour", "pyamg", "dask", "zarr", "xarray", "matplotlib")


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
    modules = [inspect.getmodule(stage.arrange), *map(import_module, stage.modules)]
    source = "".join(inspect.getsource(module) for module in modules if module is not None)
    for name, field in stage.params.model_fields.items():
        assert field.description, name
        assert not field.is_required(), f"{name} has no default"
        assert source.count(name) >= 2, f"{name} is declared and never used"
    assert issubclass(stage.params, Params)


def test_what_it_names_is_there(stage: Stage) -> None:
    for name in (stage.kernel, stage.prepare, stage.item, stage.verdict):
        assert name is None or callable(function(name)), name
    if stage.prepare is not None and stage.context is None:
        pytest.fail("what prepares gets a context")


def test_no_declaration_loads_numerics() -> None:
    """A plan, `status` and `why` import every stage of a pipeline, and compute nothing."""
    code = (
        "import sys\nfrom importlib import import_module\n"
        f"for module in {sorted(TABLE.values())!r}: import_module(module)\n"
        "print(*sorted({name.partition('.')[0] for name in sys.modules} & set(sys.argv[1:])))\n"
    )
    done = subprocess.run([sys.executable, "-c", code, *HEAVY], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


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

"""One block, wherever it is computed: who is not fit to compute it refuses, and rounding is no difference."""

import functools
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from lightstage.dag import run as dag_run
from lightstage.dag.task import BlockTask, equal_to_rounding, execute
from lightstage.kernels.normals import methods
from lightstage.store.records import BlockRecord
from tests.conftest import Answer

Lightstage = Callable[..., Answer]
RATIO = ("run", "normals", "--session", "ball", "--set", "normals.method=ratio")


@pytest.fixture
def ball(lightstage: Lightstage, sphere: Path) -> Path:
    """The sphere, imported and run."""
    assert lightstage("import", sphere).code == 0
    assert lightstage("run", "--session", "ball").code == 0
    return sphere


def every_task(monkeypatch: pytest.MonkeyPatch, change: Callable[[BlockTask], None]) -> None:
    """Change every task on its way to whoever computes it."""

    def changed(task: BlockTask, *above: BlockRecord) -> BlockRecord:
        change(task)
        return execute(task, *above)

    monkeypatch.setattr(dag_run, "execute", changed)


def normals_kernel(monkeypatch: pytest.MonkeyPatch, around: Callable[..., Any]) -> None:
    """Let `around(kernel, **what it gets)` stand in the place of the kernel of `normals`."""
    kernel = functools.wraps(methods.normals)(functools.partial(around, methods.normals))
    monkeypatch.setattr(methods, "normals", kernel)


def test_another_engine_is_refused(lightstage: Lightstage, ball: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def from_another(task: BlockTask) -> None:
        task.engine, task.elsewhere = "of another dag/ or store/", True

    every_task(monkeypatch, from_another)
    done = lightstage(*RATIO)
    assert done.code == 1
    assert "has another engine (dag/ or store/) than the command had; restart the cluster" in done.err


def test_numbers_without_numbas_compiler_are_refused(
    lightstage: Lightstage, ball: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
    done = lightstage(*RATIO)
    assert done.code == 1
    assert "numba's compiler turned off (NUMBA_DISABLE_JIT" in done.err
    assert lightstage("run", "--session", "ball").code == 0  # what is known needs no compiler


def test_a_worker_that_sees_a_copy_or_nothing_says_so(
    lightstage: Lightstage, ball: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(tmp_path / "store", copy, symlinks=True)
    before = sorted(copy.rglob("*"))
    for root, words in ((copy, "sees another store, a copy perhaps,"), (tmp_path / "nowhere", "sees no store")):
        with monkeypatch.context() as patch:

            def there(task: BlockTask, root: Path = root) -> None:
                task.store_root, task.elsewhere = root, True

            every_task(patch, there)
            done = lightstage(*RATIO)
        assert done.code == 1
        assert f"{words} at {root}" in done.err
        assert len(done.err.splitlines()) == 1
    assert sorted(copy.rglob("*")) == before
    assert not (tmp_path / "nowhere").exists()


def test_a_store_that_is_moved_while_a_kernel_computes_is_not_made_anew(
    lightstage: Lightstage, ball: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def move(kernel: Callable[..., Any], **inputs: Any) -> Any:
        made = kernel(**inputs)
        shutil.move(tmp_path / "store", tmp_path / "moved")
        return made

    with monkeypatch.context() as patch:
        normals_kernel(patch, move)
        done = lightstage(*RATIO)
    assert done.code == 1
    assert f"there is no store at {tmp_path / 'store'} now: it was moved" in done.err
    assert not (tmp_path / "store").exists()
    assert lightstage(*RATIO, store=tmp_path / "moved").code == 0


@pytest.mark.parametrize(("steps", "warned"), [(1, False), (2, True)])
def test_another_result_under_the_same_key_is_told_unless_it_is_rounding(
    lightstage: Lightstage, ball: Path, monkeypatch: pytest.MonkeyPatch, steps: int, warned: bool
) -> None:
    """Another run computes the block and is first, on a processor that rounds one value otherwise."""
    calls = []

    def second(kernel: Callable[..., Any], **inputs: Any) -> Any:
        made = dict(kernel(**inputs))
        calls.append(1)
        if len(calls) == 1:
            assert lightstage(*RATIO).code == 0
            made["normal"] = made["normal"].copy()
            made["normal"][..., 24, 24] += steps
        return made

    normals_kernel(monkeypatch, second)
    done = lightstage(*RATIO)
    assert done.code == 0
    assert len(calls) == 2
    assert ("computed again, it came out different" in done.err) == warned


FLOATS = np.linspace(0, 1, 2000, dtype=np.float32)
STEPS = np.arange(2000, dtype=np.int16)


def at(array: np.ndarray[Any, Any], places: slice, by: float) -> np.ndarray[Any, Any]:
    other = array.copy()
    other[places] += other.dtype.type(by)
    return other


@pytest.mark.parametrize(
    ("first", "second", "quantised", "equal"),
    [
        (FLOATS, at(FLOATS, slice(None), 0.9e-5), False, True),
        (FLOATS, at(FLOATS, slice(5, 6), 1.2e-5), False, False),
        (1000 * FLOATS, at(1000 * FLOATS, slice(None), 0.9e-2), False, True),
        (FLOATS, at(FLOATS, slice(5, 6), np.nan), False, False),
        (at(FLOATS, slice(0, 9), np.nan), at(FLOATS, slice(0, 9), np.nan), False, True),
        (at(FLOATS, slice(0, 9), np.inf), at(FLOATS, slice(0, 9), -np.inf), False, False),
        (STEPS, at(STEPS, slice(0, 1), 1), True, True),
        (STEPS, at(STEPS, slice(0, 2), 1), True, False),
        (STEPS, at(STEPS, slice(0, 1), 2), True, False),
        (STEPS, at(STEPS, slice(0, 1), 1), False, False),
        (STEPS > 5, STEPS > 6, False, False),
        (FLOATS[:0], FLOATS[:0], False, True),
    ],
)
def test_what_counts_as_rounding(
    first: np.ndarray[Any, Any], second: np.ndarray[Any, Any], quantised: bool, equal: bool
) -> None:
    assert equal_to_rounding(first, second, quantised=quantised) is equal

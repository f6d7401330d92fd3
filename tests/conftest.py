"""Fixtures, the captures in ../shared/data, and the option that accepts new pinned digests."""

import json
import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hypothesis
import pytest

from lightstage.store.notes import write_note
from lightstage.store.root import Store
from tests.scenes import sphere_capture

REPOSITORY = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("LIGHTSTAGE_TEST_DATA", REPOSITORY.parent / "shared" / "data"))

# a busy machine is no fault of what is tested
hypothesis.settings.register_profile(
    "lightstage", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("lightstage")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--golden", action="store_true", help="write the pinned digests anew")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if DATA.is_dir():
        return
    for item in items:
        if "data" in item.keywords:
            item.add_marker(
                pytest.mark.skip(reason=f"the captures are not here ({DATA}); set LIGHTSTAGE_TEST_DATA")
            )


@pytest.fixture(scope="session")
def data() -> Path:
    return DATA


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store")


@pytest.fixture
def sphere(tmp_path: Path) -> Path:
    """A small capture folder of a sphere, two cameras."""
    return sphere_capture(tmp_path / "ball")


@pytest.fixture(scope="session")
def standing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store with a session that was run, for tests that only look."""
    from lightstage.cli.main import main

    folder = tmp_path_factory.mktemp("standing")
    store = folder / "store"
    assert main(["--store", str(store), "import", str(sphere_capture(folder / "ball"))]) == 0
    assert main(["--store", str(store), "run", "--session", "ball"]) == 0
    return store


@dataclass(frozen=True)
class Answer:
    """What a command said."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)


@pytest.fixture
def lightstage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., Answer]:
    """The command, in this process, on a store of the test's own."""
    from lightstage.cli.main import main

    def call(*words: str | Path, store: str | Path = tmp_path / "store") -> Answer:
        capsys.readouterr()
        code = main(["--store", str(store), *map(str, words)])
        said = capsys.readouterr()
        return Answer(code, said.out, said.err)

    return call


def put_result(dataset: Any, root: Path, session: str, node: str) -> None:
    """A result made by hand, with the note that says what its files are."""
    group = root / "results" / session / node / "by-hand"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # zarr: consolidated metadata is not in the specification yet
        dataset.to_zarr(group, consolidated=True)
    write_note(Store(root).scratch, group, group, {}, {})
    (group.parent / "current").write_text("by-hand\n")


def run_process(*words: str | Path, store: Path, **options: Any) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own."""
    command = [sys.executable, "-m", "lightstage.cli.main", "--store", str(store), *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, **{"cwd": REPOSITORY, **options})

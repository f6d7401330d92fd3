"""What the tests of the Python API begin with."""

from collections.abc import Callable
from pathlib import Path

import pytest

import lightstage
from tests.conftest import Answer

Command = Callable[..., Answer]


@pytest.fixture
def command(request: pytest.FixtureRequest) -> Command:
    """The fixture of the package's name, under another."""
    called: Command = request.getfixturevalue("lightstage")
    return called


@pytest.fixture
def store(tmp_path: Path) -> lightstage.OpenStore:
    return lightstage.open_store(tmp_path / "store")


@pytest.fixture
def ball(store: lightstage.OpenStore, sphere: Path) -> lightstage.OpenSession:
    return store.import_capture(sphere).session


@pytest.fixture
def finished(standing: Path) -> lightstage.OpenSession:
    """A session that was run, for tests that only look."""
    return lightstage.open_store(standing).session("ball")

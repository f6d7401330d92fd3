"""What several commands' tests begin with."""

from collections.abc import Callable
from pathlib import Path

import pytest

from lightstage.cli.main import main
from tests.conftest import Answer
from tests.scenes import sphere_capture

Lightstage = Callable[..., Answer]


@pytest.fixture
def ball(lightstage: Lightstage, sphere: Path) -> Path:
    """The store of `lightstage` with a session that was run."""
    assert lightstage("import", sphere).code == 0
    assert lightstage("run", "--session", "ball").code == 0
    return sphere


@pytest.fixture(scope="session")
def standing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store with the same session, for tests that only look."""
    folder = tmp_path_factory.mktemp("standing")
    store = folder / "store"
    assert main(["--store", str(store), "import", str(sphere_capture(folder / "ball"))]) == 0
    assert main(["--store", str(store), "run", "--session", "ball"]) == 0
    return store


def check_refusal(answer: Answer, part: str) -> None:
    """One sentence on stderr, and the exit code of a wrong request."""
    assert answer.code == 2
    assert part in answer.err
    assert len(answer.err.strip().splitlines()) == 1
    assert answer.err.startswith("lightstage: ")

"""What several commands' tests begin with."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import Answer

Lightstage = Callable[..., Answer]


@pytest.fixture
def ball(lightstage: Lightstage, sphere: Path) -> Path:
    """The store of `lightstage` with a session that was run."""
    assert lightstage("import", sphere).code == 0
    assert lightstage("run", "--session", "ball").code == 0
    return sphere


def check_refusal(answer: Answer, part: str) -> None:
    """One sentence on stderr, and the exit code of a wrong request."""
    assert answer.code == 2
    assert part in answer.err
    assert len(answer.err.strip().splitlines()) == 1
    assert answer.err.startswith("lightstage: ")

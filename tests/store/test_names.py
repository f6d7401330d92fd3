"""Names of sessions and nodes are names of folders, on any system, and of nothing else."""

import pytest

from lightstage.store.names import SESSION_NAME


@pytest.mark.parametrize("name", ["a", "7", "subject-a", "2010.03.12_b", "A" * 100])
def test_what_may_be_a_name(name: str) -> None:
    assert SESSION_NAME.fullmatch(name)


@pytest.mark.parametrize(
    "name",
    ["", ".", "..", ".hidden", "-rf", "_a", "a/b", "../a", "a b", "a\n", "a\0", "ä", "a:b", "٣", "A" * 101],
)
def test_what_may_not(name: str) -> None:
    assert not SESSION_NAME.fullmatch(name)

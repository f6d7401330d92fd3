"""Who is told how a run goes on."""

from collections.abc import Mapping
from typing import Protocol


class Watcher(Protocol):
    """Is told how a run goes on."""

    def begin(self, totals: Mapping[str, int], frames: int) -> None:
        """Blocks to do, by node, and the session's frames that they stand for."""

    def done(self, node: str, computed: bool) -> None:
        """One block of a node is there."""

    def warn(self, text: str) -> None:
        """Something that the user should know."""


class Notes:
    """A watcher that shows nothing, and keeps what should be known."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def begin(self, totals: Mapping[str, int], frames: int) -> None:
        """Nothing is shown."""

    def done(self, node: str, computed: bool) -> None:
        """Nothing is shown."""

    def warn(self, text: str) -> None:
        """Keep it."""
        self.texts.append(text)
